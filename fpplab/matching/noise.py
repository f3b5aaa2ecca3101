"""Noise of the bench, found from its frames and given to the twin: photon transfer, and vibration.

What the bench saw less what the twin expects of a frame is noise, and the item's displacement at that moment.
The displacement shows in many thousands of pixels, so it is known far better than any of them (least squares
with the image's own slopes); the rest is the sensor's, whose variance rises with the level (Janesick, Photon
Transfer, 2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fpplab.core.conventions import Floats, Image, PixelIndices
from fpplab.matching.loss import board_mask, thinned
from fpplab.matching.reference import Reference
from fpplab.simulation.matchable import Parameters, Twin

STEP_MM = 0.02
PIXELS = 30_000
BINS = 12
ROUNDING = 1.0 / 12.0
"""Variance of rounding to integers."""
DITHERED = 0.15
"""Share of full scale above black from which noise is enough for rounding to be noise as well."""
ALIKE = 0.2
"""Two frames' levels that differ by less, of full scale, have the same noise."""


@dataclass(frozen=True)
class Noise:
    """Of frames at their depth: variance `constant + per_level * (level - black)`, and the item's vibration.

    constant_sigma: standard uncertainty of `constant`. vibration_mm: along each axis.
    """

    constant: float
    constant_sigma: float
    per_level: float
    vibration_mm: float


def match_noise(bench: Reference, twin: Twin, poses: Sequence[int]) -> Parameters:
    """The twin's parameters with the bench's noise, found alike in frames of both.

    Read noise is changed only where it shows beside rounding. Leaves the twin as it is.
    """
    now = twin.parameters
    images = bench.plan.finest_images
    patterns = bench.shown(images)
    own = [twin.frames(pose, patterns, bench.settings) for pose in poses]
    real = [[np.asarray(f) for f in bench.frames(pose, images)] for pose in poses]
    views = [_View.of(bench, twin, now, pose, images) for pose in poses]
    twin.become(now)
    there, here = (_noise(bench, views, frames) for frames in (real, own))
    ratio = here.per_level / there.per_level if min(here.per_level, there.per_level) > 0 else 1.0
    changed = replace(now, full_well_e=now.full_well_e * ratio, vibration_mm=there.vibration_mm)
    shows = there.constant - ROUNDING > 3.0 * there.constant_sigma
    if shows and here.constant > ROUNDING:
        grown = np.sqrt((there.constant - ROUNDING) / (here.constant - ROUNDING))
        changed = replace(changed, read_noise_e=float(now.read_noise_e * grown * ratio))
    return changed


@dataclass(frozen=True, eq=False)
class _View:
    """Pixels of a pose; levels expected (n, P), and by displacement in mm (n, P, 3)."""

    pixels: PixelIndices
    expected: Floats
    slopes: Floats

    @classmethod
    def of(cls, bench: Reference, twin: Twin, now: Parameters, pose: int, images: Sequence[int]) -> _View:
        pixels = thinned(board_mask(now.calibration.camera, now.poses[pose], bench.target), PIXELS)

        def expected(parameters: Parameters) -> Floats:
            twin.become(parameters)
            levels = twin.expected_at(pose, bench.shown(images), bench.settings, pixels)
            return levels.astype(np.float64)

        here, held = expected(now), now.poses[pose]
        slopes = []
        for axis in np.eye(3):
            there = now.with_pose(pose, held.moved(STEP_MM * axis))
            slopes.append((expected(there) - here) / STEP_MM)
        return cls(pixels, here, np.stack(slopes, axis=-1))

    def taken_apart(self, frames: Sequence[Image]) -> tuple[Floats, Floats, Floats]:
        """Displacement of every frame in mm (n, 3), its variance (n, 3), and what it leaves (n, P)."""
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


def _noise(bench: Reference, views: Sequence[_View], poses: Sequence[Sequence[Image]]) -> Noise:
    squares, weights, levels, variances = 0.0, 0.0, [], []
    for view, frames in zip(views, poses, strict=True):
        shifts, variance, rest = view.taken_apart(frames)
        if len(frames) > 1:
            excess = shifts.var(axis=0, ddof=1) - variance.mean(axis=0)
            weight = 1.0 / variance.mean(axis=0) ** 2
            squares, weights = squares + float(weight @ excess), weights + float(weight.sum())
        level, spread = _transfer(view.expected, rest, bench.full_scale)
        levels.append(level)
        variances.append(spread)
    vibration = float(np.sqrt(max(squares / weights, 0.0))) if weights else 0.0
    constant, per_level, sigma = _line(np.concatenate(levels), np.concatenate(variances))
    return Noise(constant, sigma, per_level, vibration)


def _transfer(expected: Floats, rest: Floats, full_scale: int) -> tuple[Floats, Floats]:
    """Levels above black and variances of one pose's noise, by bins of level.

    From the difference of two frames, in which what the twin does not know of the board falls out.
    """
    black = float(expected.min())
    signal = 0.5 * (expected[1:] + expected[:-1]) - black
    alike = np.abs(np.diff(expected, axis=0)) < ALIKE * full_scale
    bright = (signal > DITHERED * full_scale) & alike & (signal + black < 0.97 * full_scale)
    at, half = signal[bright], 0.5 * np.diff(rest, axis=0)[bright] ** 2
    edges = np.linspace(DITHERED * full_scale, full_scale, BINS + 1)
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
        return ROUNDING, 0.0, np.inf
    basis = np.column_stack([np.ones_like(level), level])
    (constant, slope), *_ = np.linalg.lstsq(basis, variance, rcond=None)
    rest = variance - basis @ (constant, slope)
    covariance = np.linalg.inv(basis.T @ basis) * float(rest @ rest) / max(len(level) - 2, 1)
    return float(constant), max(float(slope), 0.0), float(np.sqrt(covariance[0, 0]))
