"""Distance from many points to a finely triangulated surface, by a local search from the nearest vertex."""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.comparison.neighbours import nearest_neighbours
from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Floats

Ints = NDArray[np.int64]


def distance_to_surface(queries: Floats, vertices: Floats, faces: NDArray[np.int32]) -> Floats:
    # queries (Q, 3); vertices (V, 3); faces (F, 3); returns (Q,)
    vertices = np.ascontiguousarray(vertices, np.float64)
    touched = np.zeros(len(vertices), np.bool_)
    touched[faces] = True
    used = np.flatnonzero(touched)
    start = used[nearest_neighbours(queries, vertices[used])[1]]
    around, begins = _faces_around(faces, len(vertices))
    distance = np.empty(len(queries))
    _walk(np.ascontiguousarray(queries, np.float64), start, vertices, faces, around, begins, distance)
    return distance


@kernel(error_model="numpy")
def _faces_around(faces: NDArray[np.int32], count: int) -> tuple[Ints, Ints]:
    begins = np.zeros(count + 1, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            begins[faces[f, k] + 1] += 1
    for i in range(count):
        begins[i + 1] += begins[i]
    at, around = begins[:-1].copy(), np.empty(3 * len(faces), np.int64)
    for f in range(len(faces)):
        for k in range(3):
            around[at[faces[f, k]]] = f
            at[faces[f, k]] += 1
    return around, begins


@kernel(parallel=True, error_model="numpy")
def _walk(
    queries: Floats,
    start: Ints,
    vertices: Floats,
    faces: NDArray[np.int32],
    around: Ints,
    begins: Ints,
    distance: Floats,
) -> None:
    for q in prange(len(queries)):
        x, y, z = queries[q, 0], queries[q, 1], queries[q, 2]
        best, best_face = np.inf, -1
        for k in range(begins[start[q]], begins[start[q] + 1]):
            square = _square_to_triangle(x, y, z, vertices, faces[around[k]])
            if square < best:
                best, best_face = square, around[k]
        for _ in range(32):  # steps of the search at most
            here = best_face
            for corner in range(3):
                vertex = faces[here, corner]
                for k in range(begins[vertex], begins[vertex + 1]):
                    square = _square_to_triangle(x, y, z, vertices, faces[around[k]])
                    if square < best:
                        best, best_face = square, around[k]
            if best_face == here:
                break
        distance[q] = np.sqrt(best)


@njit(inline="always")
def _square_to_segment(px: float, py: float, pz: float, dx: float, dy: float, dz: float) -> float:
    along = (px * dx + py * dy + pz * dz) / max(dx * dx + dy * dy + dz * dz, 1e-300)
    along = min(max(along, 0.0), 1.0)
    rx, ry, rz = px - along * dx, py - along * dy, pz - along * dz
    return float(rx * rx + ry * ry + rz * rz)


@kernel_part(error_model="numpy")
def _square_to_triangle(x: float, y: float, z: float, vertices: Floats, face: NDArray[np.int32]) -> float:
    a, b, c = face[0], face[1], face[2]
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    e1x, e1y, e1z = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    e2x, e2y, e2z = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    nx, ny, nz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
    square = nx * nx + ny * ny + nz * nz
    # Barycentric coordinates, times `square`, of the foot on the plane.
    s = (py * e2z - pz * e2y) * nx + (pz * e2x - px * e2z) * ny + (px * e2y - py * e2x) * nz
    t = (e1y * pz - e1z * py) * nx + (e1z * px - e1x * pz) * ny + (e1x * py - e1y * px) * nz
    if square > 0.0 and s >= 0.0 and t >= 0.0 and s + t <= square:
        height = px * nx + py * ny + pz * nz
        return float(height * height / square)
    return min(
        _square_to_segment(px, py, pz, e1x, e1y, e1z),
        _square_to_segment(px, py, pz, e2x, e2y, e2z),
        _square_to_segment(px - e1x, py - e1y, pz - e1z, e2x - e1x, e2y - e1y, e2z - e1z),
    )
