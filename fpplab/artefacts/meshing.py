"""Meshes from corner loops (n, 3) and triangles (m, 3, 3) in mm, counterclockwise from outside."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from fpplab.core.conventions import Floats

if TYPE_CHECKING:
    import trimesh


def rectangle_corners(x0: float, x1: float, y0: float, y1: float) -> Floats:
    # returns (4, 3) mm
    return np.array([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)])


def centred_rectangle(size: tuple[float, float], z: float) -> Floats:
    # returns (4, 3) mm
    return raised(rectangle_corners(-size[0] / 2, size[0] / 2, -size[1] / 2, size[1] / 2), z)


def raised(loop: Floats, z: float) -> Floats:
    # loop (n, 3) mm; returns (n, 3) mm
    return np.asarray(loop + np.array([0.0, 0.0, z]))


def profile_at(profile: Sequence[tuple[float, float]], y: float) -> Floats:
    # profile (x, z) mm; returns (n, 3) mm
    return np.array([(x, y, z) for x, z in profile])


def fan_triangles(loop: Floats) -> Floats:
    # loop (n, 3) mm
    return np.stack([np.broadcast_to(loop[0], loop[1:-1].shape), loop[1:-1], loop[2:]], axis=1)


def strip_triangles(low: Floats, high: Floats) -> Floats:
    # low (n, 3) mm; returns (2n, 3, 3) mm
    low_next, high_next = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    return np.concatenate(
        [np.stack([low, low_next, high_next], axis=1), np.stack([low, high_next, high], axis=1)]
    )


def closed_body(parts: Iterable[Floats]) -> trimesh.Trimesh:
    # parts (m, 3, 3) mm
    import trimesh  # most of a second that listing names does not need

    triangles = np.concatenate(list(parts))
    return trimesh.Trimesh(
        vertices=triangles.reshape(-1, 3), faces=np.arange(3 * len(triangles)).reshape(-1, 3), process=True
    )
