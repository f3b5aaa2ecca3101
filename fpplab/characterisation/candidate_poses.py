"""Poses of a board to choose from: over the field, the depth and the tilts that both devices see."""

from collections.abc import Iterator
from itertools import product

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Floats, Mask
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform

TILT_DEG = 35.0
"""Tilt of the board against the image plane. Chosen on drawn rigs: more would blur and foreshorten it."""

DIRECTIONS = tuple((x, y) for y, x in product((-1, 0, 1), repeat=2) if x or y)
"""To the right and down: towards which part of the image the board is moved, or which edge is tilted away."""

MAX_SLANT_DEG = 50.0
"""Greatest angle between the board's normal and the way to the projector. Chosen: light is grazing beyond."""


def tilted_away(direction: tuple[float, float], tilt_deg: float) -> Floats:
    """Tilt a board that faces the camera."""
    # returns (3, 3)
    x, y = np.array(direction, np.float64) / np.hypot(*direction)
    return RigidTransform.from_vectors(np.radians(tilt_deg) * np.array([y, -x, 0.0]), np.zeros(3)).rotation


def board_grid(size_mm: tuple[float, float], rim_mm: float = 0.0) -> Floats:
    """Spread points over a board and a rim around it."""
    # size_mm (width, height) mm; returns (25, 3) mm
    x, y = (np.linspace(-0.5, 0.5, 5) * (side + 2.0 * rim_mm) for side in size_mm)
    u, v = np.meshgrid(x, y)
    return np.asarray(np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3))


def visible_shares(calibration: Calibration, places: Floats) -> Floats:
    # places (..., K, 3) mm
    visible: Mask = calibration.camera.sees(places)
    visible &= calibration.projector.sees(places, calibration.T_projector_camera)
    return np.asarray(visible.mean(axis=-1))


def candidate_poses(
    calibration: Calibration,
    size_mm: tuple[float, float],
    depth_mm: DepthInterval,
    rim_mm: float = 5.0,
) -> list[RigidTransform]:
    """List poses of a board that both devices see whole.

    A rim around the board has to be seen too: a hand does not hold it exactly where it should.

    For each tilt and depth the board is in the middle of the field that both devices see, and as far from
    there as it is still seen, towards each edge and corner of the camera's image.
    """
    # size_mm (width, height) mm
    grid = board_grid(size_mm, rim_mm)
    for min_share in (1.0, 0.6):  # most of a board that is too large to be seen whole
        if poses := list(_visible_poses(calibration, grid, depth_mm, min_share)):
            return poses
    raise CalibrationError(
        f"a board of {size_mm[0]:g} x {size_mm[1]:g} mm is not seen by both devices from "
        f"{depth_mm[0]:.0f} to {depth_mm[1]:.0f} mm from the camera; use a smaller board, or turn both "
        "devices to one place"
    )


def _visible_poses(
    calibration: Calibration,
    grid: Floats,
    depth_mm: DepthInterval,
    min_share: float,
) -> Iterator[RigidTransform]:
    tilts = [np.eye(3), *(tilted_away(direction, TILT_DEG) for direction in DIRECTIONS)]
    for z, rotation in product(np.linspace(*depth_mm, 3), tilts):
        board = grid @ rotation.T
        paths = _paths_from_field_centre(calibration, float(z))
        share = visible_shares(calibration, paths[:, :, None] + board)
        good = (share >= min_share) & _faces_projector(calibration, rotation, paths)
        last = np.where(good.any(axis=1), good.shape[1] - 1 - np.argmax(good[:, ::-1], axis=1), -1)
        placed = {tuple(paths[k, step]) for k, step in enumerate(last) if step >= 0}
        yield from (RigidTransform(rotation, np.array(place)) for place in sorted(placed))


def _paths_from_field_centre(calibration: Calibration, z: float, steps: int = 12) -> Floats:
    """Places (9, steps + 1, 3) at a depth, from the middle of the field to it, the edges and the corners."""
    camera = calibration.camera
    (width, height), shares = camera.size, np.linspace(0.0, 1.0, 9)
    pixels = np.stack(np.meshgrid(shares * (width - 1), shares * (height - 1)), axis=-1).reshape(-1, 2)
    places = z * np.column_stack([camera.normalise(pixels), np.ones(len(pixels))])
    in_view = calibration.projector.sees(places, calibration.T_projector_camera)
    middle = pixels[in_view].mean(axis=0) if in_view.any() else pixels.mean(axis=0)
    size = np.array([width - 1.0, height - 1.0])
    ends = np.array([middle, *(0.5 * size * (1.0 + np.array(direction)) for direction in DIRECTIONS)])
    # Towards an edge, not the middle of it: the other coordinate stays.
    for k, direction in enumerate(DIRECTIONS, 1):
        ends[k] = np.where(np.array(direction) == 0, middle, ends[k])
    along = middle + np.linspace(0.0, 1.0, steps + 1)[:, None] * (ends - middle)[:, None]
    slopes = camera.normalise(along.reshape(-1, 2)).reshape(along.shape)
    return np.asarray(z * np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1))


def _faces_projector(calibration: Calibration, rotation: Floats, places: Floats) -> Mask:
    """Whether the board's front is lit from not too far aside."""
    away = places - calibration.projector_centre
    cosine = away @ rotation[:, 2] / np.linalg.norm(away, axis=-1)
    return np.asarray(cosine > np.cos(np.radians(MAX_SLANT_DEG)))
