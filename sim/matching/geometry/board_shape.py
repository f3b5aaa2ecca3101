"""The shape of the bench's board, which the twin's board, a plane, lacks.

A characterisation that refines its board finds by how much each of its points lies before or behind the
plane. Fitted to images as if it were flat, a bent board would be taken for other lenses and other poses; so
what the bend changes in the images is computed to first order, and taken off.
"""

import numpy as np

from fpplab.core.conventions import Floats, PixelIndices
from sim.matching.geometry.surface_points import surface_and_projector_points
from sim.matching.reference import Reference
from sim.parameters import TwinParameters


def bend_mm(board: Floats, places: Floats) -> Floats:
    """Interpolate a board's shape by a cubic polynomial, extended beyond its points as at the last."""
    # board (N, 3) mm; places (P, 2) mm; returns (P,) mm
    if np.abs(board[:, 2]).max() < 1e-4:  # mm (chosen); such a board is flat
        return np.zeros(len(places))
    low, high = board[:, :2].min(axis=0), board[:, :2].max(axis=0)
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-9)
    coefficients = np.linalg.lstsq(_bending_terms((board[:, :2] - middle) / half), board[:, 2], rcond=None)[0]
    return np.asarray(_bending_terms(np.clip((places - middle) / half, -1.0, 1.0)) @ coefficients)


def _bending_terms(places: Floats) -> Floats:
    x, y = places.T
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    return np.stack([x**i * y**j for i, j in powers], axis=1)


def bend_displacements_mm(
    reference: Reference, parameters: TwinParameters, pose: int, pixels: PixelIndices
) -> Floats:
    """Compute by how much the bend moves the board's surface where pixels see it."""
    # returns (P, 3) mm
    points = np.stack(pixels[::-1], axis=-1).astype(np.float64)
    board = parameters.poses[pose]
    places = surface_and_projector_points(points, parameters.calibration, board)[:, :2]
    return np.outer(bend_mm(reference.characterisation.board, places), board.rotation[:, 2])


def change_by_bend(
    reference: Reference, parameters: TwinParameters, pose: int, pixels: PixelIndices, slopes: Floats
) -> Floats:
    """Compute by how much the bend changes levels, to first order."""
    # slopes (n, P, 3) mm; returns (n, P)
    return np.asarray(
        np.einsum("npa,pa->np", slopes, bend_displacements_mm(reference, parameters, pose, pixels))
    )
