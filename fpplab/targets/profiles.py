"""Brightness models of what surrounds a point of a board: two crossing edges, or a disc.

A model has parameters θ of which θ[:2] is the offset of its centre in px. Its level, its linear
gradient and its gain are fitted separately.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from fpplab.core.conventions import Floats

BrightnessProfile = Callable[[Floats, Floats, Floats], Floats]
"""Brightness of a model with parameters θ at offsets (x, y) in px; -1 to 1."""


@dataclass(frozen=True)
class PointModel:
    """Brightness model of a point and where to fit it.

    Attributes
    ----------
    shape : BrightnessProfile
        Brightness of the model, positive where the board is bright for a dark foreground.
    start : Callable[[Floats], Floats]
        Initial parameters θ from the Jacobian (2, 2) of the board's homography in px per mm.
    half_mm : float
        Half the side in mm of the square around the point that shows nothing else.
    """

    shape: BrightnessProfile
    start: Callable[[Floats], Floats]
    half_mm: float


def crossing_edges(half_mm: float) -> PointModel:
    """Model the corner of four squares as the product of two blurred edges.

    Parameters
    ----------
    half_mm : float
        Half the side of the fitting window in mm.

    Returns
    -------
    PointModel
        θ = (x, y, directions of the two edges in rad, blur in px).
    """
    return PointModel(_crossing, _crossing_start, half_mm)


def disc(radius_mm: float, half_mm: float) -> PointModel:
    """Model a circle as an ellipse with a blurred rim.

    Parameters
    ----------
    radius_mm : float
        Radius of the circle on the board in mm.
    half_mm : float
        Half the side of the fitting window in mm.

    Returns
    -------
    PointModel
        θ = (x, y, the ellipse's form (a, b, c), blur in px): the rim is a x² + 2 b x y + c y² = 1.
    """
    return PointModel(_disc, lambda frame: _disc_start(frame, radius_mm), half_mm)


def _crossing_start(frame: Floats) -> Floats:
    along_x, along_y = np.arctan2(frame[1], frame[0])
    return np.array([0.0, 0.0, along_x, along_y, 1.0])


def _crossing(theta: Floats, x: Floats, y: Floats) -> Floats:
    u, v = x - theta[0], y - theta[1]
    first = (np.cos(theta[2]) * v - np.sin(theta[2]) * u) / theta[4]
    second = (np.cos(theta[3]) * v - np.sin(theta[3]) * u) / theta[4]
    return np.asarray(erf(first) * erf(second))


def _disc_start(frame: Floats, radius_mm: float) -> Floats:
    inverse = np.linalg.inv(frame) / radius_mm
    form = inverse.T @ inverse
    return np.array([0.0, 0.0, form[0, 0], form[0, 1], form[1, 1], 1.0])


def _disc(theta: Floats, x: Floats, y: Floats) -> Floats:
    u, v = x - theta[0], y - theta[1]
    along_u, along_v = theta[2] * u + theta[3] * v, theta[3] * u + theta[4] * v
    radius = np.sqrt(np.maximum(u * along_u + v * along_v, 1e-12))
    # First-order distance from the rim; only pixels near the rim carry information.
    distance = (radius - 1) * radius / np.maximum(np.hypot(along_u, along_v), 1e-12)
    return np.asarray(erf(distance / theta[5]))
