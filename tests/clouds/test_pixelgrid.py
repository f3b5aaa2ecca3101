"""A cloud as a surface over the pixels: which points its faces join."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from fpplab.clouds import Cloud

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
