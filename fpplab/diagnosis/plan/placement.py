"""How well projector coordinates agree with a calibration, in images that stand as they do or otherwise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import AXES, Axis, Floats, Mask
from fpplab.core.depth import DepthRange
from fpplab.diagnosis.plan.limits import PlanCheckLimits
from fpplab.diagnosis.points import expected_change

ITERATIONS = 8  # of Newton's method, which converges within four (chosen)
STEP = 1e-3  # of the inverse depth for its derivative, as a share of the inverse of three baselines (chosen)


Turn = tuple[tuple[int, int], tuple[int, int]]
"""How directions to the right and down in the images are those of the characterisation, as a matrix."""


@dataclass(frozen=True)
class Placement:
    """Agreement of coordinates with a calibration."""

    alignment: float  # cosine of the angle between their change along the image and that expected, the least
    possible_share: float  # share of pixels whose points lie before both devices, where the scene may lie
    epipolar_px: float | None  # systematic distance from the epipolar lines; None with one axis

    def fits(self, limits: PlanCheckLimits) -> bool:
        is_forward = self.alignment >= limits.min_alignment
        is_possible = is_forward and self.possible_share >= limits.min_possible_share
        return is_possible and not (self.epipolar_px or 0.0) > limits.max_epipolar_px


@dataclass(frozen=True, eq=False)
class PlacedSample:
    """Coordinates of some pixels of images."""

    pixels: Floats  # (P, 2) in px, column first
    coordinates: dict[Axis, Floats]  # (P,) in projector px, NaN where unknown
    gradients: dict[Axis, Floats]  # (P, 2) a measure of the change to the right and down

    def placement(self, calibration: Calibration, turn: Turn, depth: DepthRange | None) -> Placement:
        # To the right and down as in the images.
        expected = expected_change(calibration) @ turn
        alignment = min(
            _alignment(gradient, expected[AXES.index(axis)]) for axis, gradient in self.gradients.items()
        )
        known = np.all([np.isfinite(values) for values in self.coordinates.values()], axis=0)
        if not known.any():
            return Placement(alignment, 0.0, None)
        middle = (np.array(calibration.camera.size, np.float64) - 1.0) / 2.0
        pixels = (self.pixels[known] - middle) @ np.transpose(turn) + middle
        axes = tuple(self.coordinates)
        observed = np.stack([self.coordinates[axis][known] for axis in axes], axis=1)
        solved = _Rays.through(pixels, calibration).solve(observed, [AXES.index(axis) for axis in axes])
        is_possible = solved.is_before_both & (np.abs(solved.along_px) < 1.0)
        if depth is not None:
            is_possible &= (solved.depth_mm > depth.mm[0]) & (solved.depth_mm < depth.mm[1])
        share = float(np.mean(is_possible))
        return Placement(alignment, share, _systematic(solved.across_px) if len(axes) == 2 else None)


def _alignment(gradients: Floats, expected: Floats) -> float:
    lengths = np.maximum(np.linalg.norm(gradients, axis=1), 1e-12) * np.linalg.norm(expected)
    return float(np.median(gradients @ expected / lengths))


def _systematic(distances: Floats, neighbours: int = 16) -> float:
    """Typical distance, of which noise is averaged out over neighbours."""
    usable = len(distances) // neighbours * neighbours
    if usable == 0:
        return float(np.median(np.abs(distances)))
    return float(np.median(np.abs(np.median(distances[:usable].reshape(-1, neighbours), axis=1))))


@dataclass(frozen=True, eq=False)
class _Solved:
    depth_mm: Floats  # (P,) from the camera
    is_before_both: Mask
    along_px: Floats  # what is left of the coordinates along the epipolar lines
    across_px: Floats  # and across


@dataclass(frozen=True, eq=False)
class _Rays:
    """Camera rays in the projector's frame: a point at inverse depth q has the direction `far + q · near`."""

    far: Floats  # (P, 3)
    near: Floats  # (3,)
    calibration: Calibration

    @classmethod
    def through(cls, pixels: Floats, calibration: Calibration) -> _Rays:
        slopes = calibration.camera.normalise(pixels)
        rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
        pose = calibration.T_projector_camera
        return cls(rays @ pose.rotation.T, pose.translation, calibration)

    def _directions(self, inverse_depth: Floats) -> Floats:
        return self.far + inverse_depth[:, None] * self.near

    def _seen(self, inverse_depth: Floats, along: list[int]) -> Floats:
        return self.calibration.projector.project(self._directions(inverse_depth))[:, along]

    def solve(self, observed: Floats, along: list[int]) -> _Solved:
        """Find the depths with which points have coordinates (P, 1 or 2) along these axes."""
        typical = 1.0 / (3.0 * self.calibration.baseline_mm)
        inverse = np.full(len(observed), typical)
        for _ in range(ITERATIONS):
            residual, slope, _ = self._linearised(inverse, observed, along, STEP * typical)
            inverse = inverse - np.sum(residual * slope, axis=1) / np.sum(slope**2, axis=1)
            inverse = np.clip(inverse, -10.0 * typical, 30.0 * typical)
        residual, slope, length = self._linearised(inverse, observed, along, STEP * typical)
        unit = slope / length
        across = residual[:, 0] * unit[:, -1] - residual[:, -1] * unit[:, 0]
        before = (inverse > 0.0) & (self._directions(inverse)[:, 2] > 0.0)
        with np.errstate(divide="ignore"):
            return _Solved(1.0 / inverse, before, np.sum(residual * unit, axis=1), across)

    def _linearised(
        self, inverse: Floats, observed: Floats, along: list[int], step: float
    ) -> tuple[Floats, Floats, Floats]:
        here = self._seen(inverse, along)
        slope = (self._seen(inverse + step, along) - here) / step
        return here - observed, slope, np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)
