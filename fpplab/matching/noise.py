"""Noise of the bench, estimated from its frames for the twin: photon transfer, and vibration.

A frame of the reference less the level that the twin expects is noise, and the effect of the item's
displacement at that moment. The displacement is common to many thousands of pixels, so it is estimated by
least squares with the image's own gradients; the rest is the sensor's noise, whose variance rises with the
level.

References
----------
Janesick, Photon Transfer, 2007
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fpplab.core.conventions import Floats, Image, PixelIndices
from fpplab.matching.loss import board_mask, subsample_pixels
from fpplab.matching.reference import Reference
from fpplab.simulation.matchable import Twin, TwinParameters

SHIFT_MM = 0.02
MAX_PIXELS = 30_000
BINS = 12
ROUNDING_VARIANCE = 1.0 / 12.0
"""Variance of rounding to integers."""
NOISE_ABOVE_ROUNDING = 0.15
"""Share of full scale above black from which the noise is large enough for rounding to act as noise."""
SAME_LEVEL = 0.2
"""Difference of two frames' levels, as share of full scale, below which their noise is the same."""


@dataclass(frozen=True)
class ReferenceNoise:
    """Noise of frames at their bit depth: variance `constant + per_level * (level - black)`, and vibration.

    Attributes
    ----------
    constant : float
        Variance at black, in raw levels squared.
    constant_sigma : float
        Standard uncertainty of `constant`.
    per_level : float
        Increase of the variance with the level, in raw levels.
    vibration_mm : float
        Standard deviation of the item's position along each axis, from frame to frame.
    """

    constant: float
    constant_sigma: float
    per_level: float
    vibration_mm: float


def match_noise(reference: Reference, twin: Twin, poses: Sequence[int]) -> TwinParameters:
    """Give the twin the noise of the reference, estimated in the same way from frames of both.

    Read noise is changed only where it is significant beside rounding. The twin is left as it is.

    Parameters
    ----------
    reference : Reference
        What was recorded of the bench.
    twin : Twin
        With matched geometry and light.
    poses : sequence of int
        Indices of the poses whose frames are compared.

    Returns
    -------
    TwinParameters
        With another full-well capacity, vibration and, where significant, read noise.
    """
    now = twin.parameters
    images = reference.plan.finest_images
    patterns = reference.shown(images)
    own = [twin.frames(pose, patterns, reference.settings) for pose in poses]
    real = [[np.asarray(f) for f in reference.frames(pose, images)] for pose in poses]
    views = [_View.of(reference, twin, now, pose, images) for pose in poses]
    twin.become(now)
    of_reference, of_twin = (_noise(reference, views, frames) for frames in (real, own))
    ratio = (
        of_twin.per_level / of_reference.per_level
        if min(of_twin.per_level, of_reference.per_level) > 0
        else 1.0
    )
    changed = replace(now, full_well_e=now.full_well_e * ratio, vibration_mm=of_reference.vibration_mm)
    shows = of_reference.constant - ROUNDING_VARIANCE > 3.0 * of_reference.constant_sigma
    if shows and of_twin.constant > ROUNDING_VARIANCE:
        grown = np.sqrt((of_reference.constant - ROUNDING_VARIANCE) / (of_twin.constant - ROUNDING_VARIANCE))
        changed = replace(changed, read_noise_e=float(now.read_noise_e * grown * ratio))
    return changed


@dataclass(frozen=True, eq=False)
class _View:
    """Pixels of a pose, expected levels (n, P), and their derivatives by displacement in mm (n, P, 3)."""

    pixels: PixelIndices
    expected: Floats
    slopes: Floats

    @classmethod
    def of(
        cls, reference: Reference, twin: Twin, now: TwinParameters, pose: int, images: Sequence[int]
    ) -> _View:
        pixels = subsample_pixels(
            board_mask(now.calibration.camera, now.poses[pose], reference.target), MAX_PIXELS
        )

        def expected(parameters: TwinParameters) -> Floats:
            twin.become(parameters)
            levels = twin.expected_at(pose, reference.shown(images), reference.settings, pixels)
            return levels.astype(np.float64)

        here, held = expected(now), now.poses[pose]
        slopes = []
        for axis in np.eye(3):
            shifted = now.with_pose(pose, held.moved(SHIFT_MM * axis))
            slopes.append((expected(shifted) - here) / SHIFT_MM)
        return cls(pixels, here, np.stack(slopes, axis=-1))

    def separate(self, frames: Sequence[Image]) -> tuple[Floats, Floats, Floats]:
        """Estimate the displacement of every frame in mm (n, 3), its variance (n, 3), and the rest (n, P)."""
        shifts, variances, rest = [], [], []
        for frame, expected, slopes in zip(frames, self.expected, self.slopes, strict=True):
            seen = np.asarray(frame)[self.pixels].astype(np.float64)
            basis = np.column_stack([slopes, expected, np.ones_like(expected)])
            normal = basis.T @ basis
            found = np.linalg.solve(normal, basis.T @ (seen - expected))
            left = seen - expected - basis @ found
            shifts.append(found[:3])
            variances.append(np.diag(np.linalg.inv(normal))[:3] * float(np.mean(left**2)))
            rest.append(left)
        return np.array(shifts), np.array(variances), np.array(rest)


def _noise(reference: Reference, views: Sequence[_View], poses: Sequence[Sequence[Image]]) -> ReferenceNoise:
    squares, weights, levels, variances = 0.0, 0.0, [], []
    for view, frames in zip(views, poses, strict=True):
        shifts, variance, rest = view.separate(frames)
        if len(frames) > 1:
            excess_variance = shifts.var(axis=0, ddof=1) - variance.mean(axis=0)
            weight = 1.0 / variance.mean(axis=0) ** 2
            squares, weights = squares + float(weight @ excess_variance), weights + float(weight.sum())
        level, spread = _transfer(view.expected, rest, reference.full_scale)
        levels.append(level)
        variances.append(spread)
    vibration = float(np.sqrt(max(squares / weights, 0.0))) if weights else 0.0
    constant, per_level, sigma = _line(np.concatenate(levels), np.concatenate(variances))
    return ReferenceNoise(constant, sigma, per_level, vibration)


def _transfer(expected: Floats, rest: Floats, full_scale: int) -> tuple[Floats, Floats]:
    """Levels above black and variances of one pose's noise, by bins of level.

    From the difference of two frames, which cancels what the twin does not know of the board.
    """
    black = float(expected.min())
    signal = 0.5 * (expected[1:] + expected[:-1]) - black
    alike = np.abs(np.diff(expected, axis=0)) < SAME_LEVEL * full_scale
    bright = (signal > NOISE_ABOVE_ROUNDING * full_scale) & alike & (signal + black < 0.97 * full_scale)
    at, half = signal[bright], 0.5 * np.diff(rest, axis=0)[bright] ** 2
    edges = np.linspace(NOISE_ABOVE_ROUNDING * full_scale, full_scale, BINS + 1)
    bins = np.digitize(at, edges)
    chosen = [bins == k for k in range(1, BINS + 1) if np.count_nonzero(bins == k) > 200]
    # The median of a squared normal variable is 0.455 of its variance; edges that fit badly do not move it.
    return (
        np.array([at[k].mean() for k in chosen]),
        np.array([np.median(half[k]) / 0.4549 for k in chosen]),
    )


def _line(level: Floats, variance: Floats) -> tuple[float, float, float]:
    """Constant and slope of the variance, and the constant's standard uncertainty."""
    if len(level) < 3:
        return ROUNDING_VARIANCE, 0.0, np.inf
    basis = np.column_stack([np.ones_like(level), level])
    (constant, slope), *_ = np.linalg.lstsq(basis, variance, rcond=None)
    rest = variance - basis @ (constant, slope)
    covariance = np.linalg.inv(basis.T @ basis) * float(rest @ rest) / max(len(level) - 2, 1)
    return float(constant), max(float(slope), 0.0), float(np.sqrt(covariance[0, 0]))
