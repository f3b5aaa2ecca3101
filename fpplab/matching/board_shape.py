"""The shape of the bench's board, which the twin's board, a plane, lacks.

A characterisation that refines its board finds by how much each of its points lies before or behind the
plane. Fitted to images as if it were flat, a bent board would be taken for other lenses and other poses; so
what the bend changes in the images is computed to first order, and taken off.
"""

from __future__ import annotations

import numpy as np

from fpplab.core.conventions import Floats, PixelIndices
from fpplab.matching.places import places_seen
from fpplab.matching.reference import Reference
from fpplab.simulation.matchable import TwinParameters

DEGREE = 3
"""Of the polynomial of the board's shape."""
LEAST_MM = 1e-4
"""Distance from the plane below which a board is flat."""


def bend_mm(board: Floats, places: Floats) -> Floats:
    """Interpolate the shape of a board by a polynomial; beyond its points it goes on as at the last of them.

    Parameters
    ----------
    board : ndarray of float64
        Points (N, 3) of the board in mm in its own frame.
    places : ndarray of float64
        (P, 2) in mm.

    Returns
    -------
    ndarray of float64
        (P,), by how much the board lies along its normal from its plane there, in mm.
    """
    if np.abs(board[:, 2]).max() < LEAST_MM:
        return np.zeros(len(places))
    low, high = board[:, :2].min(axis=0), board[:, :2].max(axis=0)
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-9)
    coefficients = np.linalg.lstsq(_terms((board[:, :2] - middle) / half), board[:, 2], rcond=None)[0]
    return np.asarray(_terms(np.clip((places - middle) / half, -1.0, 1.0)) @ coefficients)


def _terms(places: Floats) -> Floats:
    x, y = places.T
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return np.stack([x**i * y**j for i, j in powers], axis=1)


def bend_moves(reference: Reference, parameters: TwinParameters, pose: int, pixels: PixelIndices) -> Floats:
    """Compute by how much the bend moves the board's surface where pixels see it.

    Parameters
    ----------
    reference : Reference
        With the board as its characterisation found it.
    parameters : TwinParameters
        Of the twin.
    pose : int
        Index of the pose.
    pixels : PixelIndices
        Rows and columns of P pixels.

    Returns
    -------
    ndarray of float64
        (P, 3) in mm along the camera's axes.
    """
    points = np.stack(pixels[::-1], axis=-1).astype(np.float64)
    there = parameters.poses[pose]
    places = places_seen(points, parameters.calibration, there)[:, :2]
    return np.outer(bend_mm(reference.characterisation.board, places), there.rotation[:, 2])


def change_by_bend(
    reference: Reference, parameters: TwinParameters, pose: int, pixels: PixelIndices, slopes: Floats
) -> Floats:
    """Compute by how much the bend changes levels, to first order.

    Parameters
    ----------
    reference : Reference
        With the board as its characterisation found it.
    parameters : TwinParameters
        Of the twin.
    pose : int
        Index of the pose.
    pixels : PixelIndices
        Rows and columns of P pixels.
    slopes : ndarray of float64
        Derivatives (n, P, 3) of the levels by a displacement of the board in mm.

    Returns
    -------
    ndarray of float64
        (n, P).
    """
    return np.asarray(np.einsum("npa,pa->np", slopes, bend_moves(reference, parameters, pose, pixels)))
