"""A cloud as a surface over the pixels: which points its faces join, and how far they lie from it."""

from itertools import product

import numpy as np
import pytest

from fpplab.clouds import Cloud, local_quadric_distance

WIDTH, HEIGHT = 14, 11


@pytest.mark.parametrize("missing", [0.0, 0.2, 0.6])
def test_faces_join_three_or_four_neighbours_along_the_flatter_diagonal(missing: float) -> None:
    random = np.random.default_rng(7)
    there = random.random((HEIGHT, WIDTH)) >= missing
    v, u = np.nonzero(there)
    depth = 300.0 + random.normal(0.0, 0.05, len(u))
    rays = np.stack([(u - 6.5) / 500, (v - 5.0) / 500, np.ones(len(u))], axis=1)
    points = (depth[:, None] * rays).astype(np.float32)
    vertices, faces = Cloud(points, np.stack([u, v], axis=1).astype(np.int32), (WIDTH, HEIGHT)).grid_mesh()
    number = np.full((HEIGHT, WIDTH), -1)
    number[v, u] = np.arange(len(u))
    expected = set()
    for row, column in product(range(HEIGHT - 1), range(WIDTH - 1)):
        a, b, c, d = number[row : row + 2, column : column + 2].ravel().tolist()
        present = [k for k in (a, b, c, d) if k >= 0]
        if len(present) == 3:
            expected.add(frozenset(present))
        elif len(present) == 4:
            inverse = {k: 1.0 / points[k, 2] for k in present}
            falling = abs(inverse[a] - inverse[d]) < abs(inverse[b] - inverse[c])
            cut = ((a, c, d), (a, d, b)) if falling else ((a, c, b), (b, c, d))
            expected.update(frozenset(one) for one in cut)
    assert {frozenset(face) for face in faces.tolist()} == expected
    assert len(faces) == len(expected)
    first, second, third = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(second - first, third - first)
    assert (np.einsum("ij,ij->i", normals, first) < 0).all(), "front sides face the camera"


@pytest.mark.parametrize("tilt_deg", [0.0, 45.0, -50.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_distance_from_a_quadric_is_along_the_normal(axis: int, tilt_deg: float) -> None:
    """Of a displaced point it is the displacement, less the share by which the fit follows its own point."""
    window, size, random = 9, (120, 90), np.random.default_rng(3)
    u, v = (each.ravel() for each in np.meshgrid(np.arange(size[0]), np.arange(size[1])))
    rays = np.stack([(u - 59.5) / 3000, (v - 44.5) / 3000, np.ones(len(u))], axis=1)
    normal = np.zeros(3)
    normal[axis], normal[2] = np.sin(np.radians(tilt_deg)), -np.cos(np.radians(tilt_deg))
    distance = random.normal(0.0, 0.005, len(u))
    on_plane = (normal[2] * 400.0 / (rays @ normal))[:, None] * rays
    # Along the ray, by which a point changes and its pixel does not.
    points = on_plane + (distance / (rays @ normal))[:, None] * rays
    pixels = np.stack([u, v], axis=1).astype(np.int32)
    found = local_quadric_distance(Cloud(points.astype(np.float32), pixels, size), window)
    y, x = np.mgrid[-4:5, -4:5].reshape(2, -1)
    terms = np.stack([np.ones(81), x, y, x * x, x * y, y * y], axis=1)
    followed = (terms @ np.linalg.pinv(terms))[40, 40]
    inner = (u >= 4) & (u < size[0] - 4) & (v >= 4) & (v < size[1] - 4)
    share = found[inner] @ distance[inner] / (distance[inner] @ distance[inner])
    assert share == pytest.approx(1.0 - followed, rel=0.02)
