"""Advice to the operator on the poses of a board: what to add before leaving the bench."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.characterisation.limits import USUAL_LIMITS, CharacterisationLimits
from fpplab.characterisation.observation import Observation
from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole, RigidTransform

REGION_NAMES = (
    ("upper left", "top", "upper right"),
    ("left", "middle", "right"),
    ("lower left", "bottom", "lower right"),
)
"""Names of the ninths of an image, by row and column."""

Ninths = NDArray[np.bool_]  # (3, 3), by row and column of an image


def coverage_warnings(
    observations: Sequence[Observation],
    poses: Sequence[RigidTransform],
    calibration: Calibration,
    board: Floats,
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> tuple[str, ...]:
    """Warn of what the poses leave undetermined."""
    # board (P, 3) mm
    centres = [T.apply(board[o.ids].mean(axis=0)) for o, T in zip(observations, poses, strict=True)]
    return (*_about_tilts(poses, limits), *_about_distances(np.array(centres)[:, 2], limits),
            *_about_parts(observations, np.array(centres), calibration))  # fmt: skip


def spread_of_tilts(poses: Sequence[RigidTransform]) -> float:
    """Compute the greatest angle between the planes of any two boards."""
    normals = np.array([T.rotation[:, 2] for T in poses])
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1).min())))


def _about_tilts(poses: Sequence[RigidTransform], limits: CharacterisationLimits) -> Iterator[str]:
    max_tilt_deg = max(float(np.degrees(np.arccos(min(abs(T.rotation[2, 2]), 1.0)))) for T in poses)
    if max_tilt_deg < limits.min_tilt_deg:
        yield (
            f"no board is tilted by more than {max_tilt_deg:.0f}°, which leaves focal lengths and principal "
            "points uncertain; add poses tilted by 20 to 35°"
        )
    elif (apart := spread_of_tilts(poses)) < limits.min_tilt_spread_deg:
        yield (
            f"all boards have the same tilt, to within {apart:.0f}°; tilt the board to the other side as "
            "well, and about its other axis"
        )


def _about_distances(distances: Floats, limits: CharacterisationLimits) -> Iterator[str]:
    nearest, farthest = float(distances.min()), float(distances.max())
    if farthest - nearest < limits.min_distance_range * float(distances.mean()):
        yield (
            f"all boards stand at nearly the same distance, {nearest:.0f} to {farthest:.0f} mm; "
            "add poses nearer and farther, over the depth that will be measured"
        )


def _about_parts(
    observations: Sequence[Observation], centres: Floats, calibration: Calibration
) -> Iterator[str]:
    for name, bare in uncovered_regions(observations, centres, calibration).items():
        if bare.any():
            where = ", ".join(REGION_NAMES[row][column] for row, column in np.argwhere(bare))
            yield (
                f"no point of a board lay in this part of the {name}'s image: {where}; its distortion is "
                "not known there, so hold the board there too"
            )


def uncovered_regions(
    observations: Sequence[Observation], centres: Floats, calibration: Calibration
) -> dict[str, Ninths]:
    """Find the parts of both images in which no point of a board lay."""
    # centres (M, 3) mm; returns (3, 3)
    pair = calibration.T_projector_camera
    camera, projector = calibration.camera, calibration.projector
    sides = (
        ("camera", camera, projector, pair, centres),
        ("projector", projector, camera, pair.inverse(), pair.apply(centres)),
    )
    return {
        name: _seen_by_both(device, other, T_other_device, float(np.median(places[:, 2])))
        & ~covered_regions(observations, name, device.size)
        for name, device, other, T_other_device, places in sides
    }


def covered_regions(observations: Sequence[Observation], device: str, size: tuple[int, int]) -> Ninths:
    """Tell which ninths of an image contain points of a board."""
    # size (width, height) px; returns (3, 3)
    return regions_with_points(np.concatenate([getattr(o, f"{device}_px") for o in observations]), size)


def regions_with_points(pixels: Floats, size: tuple[int, int]) -> Ninths:
    # pixels (K, 2) px; size (width, height) px; returns (3, 3)
    held = np.zeros((3, 3), np.bool_)
    column, row = np.clip((3 * (pixels + 0.5) / np.array(size)).astype(int), 0, 2).T
    held[row, column] = True
    return held


def _seen_by_both(
    device: Pinhole, other_device: Pinhole, T_other_device: RigidTransform, distance: float
) -> Ninths:
    """Tell which ninths (3, 3) have a centre that the other device sees as well, at the boards' distance."""
    # The others cannot contain points of a board, and no point will ever be measured there.
    shares = (np.arange(3) + 0.5) / 3
    u, v = np.meshgrid(shares * device.size[0] - 0.5, shares * device.size[1] - 0.5)
    slopes = device.normalise(np.stack([u, v], axis=-1))
    points = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1) * distance
    return other_device.sees(points, T_other_device)
