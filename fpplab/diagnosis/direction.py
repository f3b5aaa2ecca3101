"""The direction in which a coordinate changes along the image, compared with the one that is predicted."""

from __future__ import annotations

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.config import Positive
from fpplab.core.conventions import Axis, Floats, Map
from fpplab.diagnosis.limits import LimitsSection


class DirectionLimits(LimitsSection):
    """From when on a coordinate runs backwards."""

    min_change: Positive = 0.1
    """Typical change along the image, as a share of that on a surface at constant depth. Derived: a slope
    of the surface changes it, but never its sign; a tenth is left for noise."""


def changes_along_image(coordinate: Map, calibration: Calibration, axis: Axis, stride: int) -> Floats:
    # On a surface at constant depth the calibration predicts how the coordinate changes along the image. A
    # slope of the surface makes it change faster or slower, but never backwards: both devices see its front.
    # coordinate (height, width) px; returns (rows, columns)
    values = coordinate[:-1:stride, :-1:stride].astype(np.float64)
    right = coordinate[:-1:stride, 1::stride][:, : values.shape[1]] - values
    down = coordinate[1::stride, :-1:stride][: values.shape[0]] - values
    expected = expected_change(calibration)["xy".index(axis)]
    return np.asarray((right * expected[0] + down * expected[1]) / (expected @ expected))


def expected_change(calibration: Calibration) -> Floats:
    """Change of the projector's coordinates (u, v) by a pixel to the right and down, (2, 2)."""
    camera, pose = calibration.camera, calibration.T_projector_camera
    pixels = np.array(camera.size) / 2.0 + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    rays = np.concatenate([camera.normalise(pixels), np.ones((3, 1))], axis=1)
    # On a surface three baselines away; the direction hardly depends on the distance.
    projected = calibration.projector.project(3.0 * calibration.baseline_mm * rays, pose)
    return np.stack([projected[1] - projected[0], projected[2] - projected[0]], axis=1)
