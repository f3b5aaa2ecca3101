"""What offset, fringes, flicker and motion leave of the frames of a set: what bands are looked for in.

Frame n of a set is

    (1 + ε_n + d_n·∇A/A) (A + B cos θ_n) - κ_n B sin θ_n + A ρ_n cos(2π f r + φ_n)

with the projector's light ε_n (flicker), a shift d_n of the print and κ_n of the fringe by motion, and a wave
along the rows r: light on the mains as a rolling shutter sees it. A, B and θ differ from pixel to pixel, so
that least squares over many thousands of them find the few numbers of a frame.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from fpplab.core.conventions import Axis, Floats, PixelIndices, raw_per_grey
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.phase.common_errors import beyond_fringe, fit_sinusoids, fringe_levels
from sim.matching.loss import board_mask, subsample_pixels
from sim.matching.reference import Reference
from sim.parameters import TwinParameters

Complex = NDArray[np.complex128]  # arrays of waves


@dataclass(frozen=True, eq=False)
class FringeResidual:
    """What is left of one fringe set of one pose."""

    pose: int  # index of the pose
    frames: Floats  # numbers (N,) of the frames in their session
    rest: Floats  # levels (N, P), in 8-bit grey levels
    beyond: Floats  # (N, N), takes off what of the frames is taken for the pixel's own offset and fringe
    level: Floats  # mean levels A (P,) above black
    rows: Floats  # rows (P,) of the image
    axis: Axis  # of the fringes

    @property
    def freedom(self) -> int:
        """Number of independent frames of `rest`."""
        return len(self.frames) - 3

    @property
    def shows_bands(self) -> bool:
        """Whether fringes lie across the rows; otherwise what is left of a motion looks like bands."""
        return self.axis == "x"

    def waves(self, frequency: Floats) -> Complex:
        """Compute the waves along the rows in every frame."""
        # frequency (F,); returns (N, F)
        waves = self.level[:, None] * np.exp(-2j * np.pi * self.rows[:, None] * frequency)
        return np.asarray(self.rest @ waves / (self.level @ self.level))


def fringe_residuals(
    reference: Reference, parameters: TwinParameters, poses: Sequence[int]
) -> list[FringeResidual]:
    return [residual for pose in poses for residual in _of_pose(reference, parameters, pose)]


def _of_pose(reference: Reference, parameters: TwinParameters, pose: int) -> Iterator[FringeResidual]:
    area = board_mask(parameters.calibration.camera, parameters.poses[pose], reference.target)
    pixels, grey = subsample_pixels(area, 8_000), raw_per_grey(reference.settings.bits)
    plan, black = reference.plan, 255.0 * parameters.black_level
    for index, fringe in enumerate(plan.sets):
        # Of fewer images, waves do not differ from motion (derived).
        if not isinstance(fringe, FringeSet) or fringe.images < 7:
            continue
        images = range(plan.set_starts[index], plan.set_starts[index + 1])
        frames = reference.frames(pose, images)
        even = reference.evened(frames.mean(axis=0), parameters.black_level)
        slopes = np.stack([slope[pixels] for slope in np.gradient(even)]) / grey
        levels = frames[:, *pixels].astype(np.float64)
        clear = levels.max(axis=0) < reference.full_scale
        yield residual_of_set(
            levels[:, clear] / grey - black,
            slopes[:, clear],
            (pixels[0][clear], pixels[1][clear]),
            fringe,
            (pose, images.start),
        )


def residual_of_set(
    levels: Floats, slopes: Floats, pixels: PixelIndices, fringe: FringeSet, place: tuple[int, int] = (0, 0)
) -> FringeResidual:
    """Take offset, fringes, flicker and motion off the frames of a set."""
    # levels (N, P); slopes (2, P); pixels (P,)
    shift, count = fringe.phase_shifts(), len(levels)
    fitted, beyond = fit_sinusoids(levels, fringe), beyond_fringe(shift)
    offset, (light, across) = fitted[0], fringe_levels(fitted, shift)
    print_moves = [light * values / np.maximum(offset, 1.0) for values in slopes]
    size = np.sqrt(np.mean(light**2))
    tilts = [across * (values - values.mean()) for values in pixels]
    moves = (
        size / max(float(np.sqrt(np.mean(values**2))), 1e-9) * values
        for values in (across, *tilts, *print_moves)
    )
    regressors = [light, *moves]
    # Frame n has its own coefficients; what of them fits the pixel's own fringe is not seen.
    normal = np.block([[beyond * (a @ b.T) for b in regressors] for a in regressors])
    rest = beyond @ levels
    right = np.concatenate([np.sum(a * rest, axis=1) for a in regressors])
    for_all = _inverse(normal) @ right
    for n, regressor in enumerate(regressors):
        rest = rest - beyond @ (for_all[n * count : (n + 1) * count, None] * regressor)
    frames = place[1] + np.arange(count, dtype=np.float64)
    return FringeResidual(place[0], frames, rest, beyond, offset, pixels[0].astype(np.float64), fringe.axis)


def _inverse(normal: Floats) -> Floats:
    """Pseudo-inverse of a symmetric matrix, without directions that are not determined."""
    strength, vectors = np.linalg.eigh(normal)
    determined = strength > 1e-4 * max(strength[-1], 1e-12)
    return np.asarray((vectors[:, determined] / strength[determined]) @ vectors[:, determined].T)


@dataclass(frozen=True, eq=False)
class Variances:
    """Random numbers of known noise whose further variance is asked for."""

    squares: Floats  # (K,) squared values, or squared sizes of complex ones
    noise: Floats  # (K,) their expectation by noise alone
    weight: Floats  # (K,) degrees of freedom of each

    def misfit(self, further: float) -> float:
        """Compute twice the negative logarithm of the likelihood of a further variance."""
        whole = self.noise + further
        return float(np.sum(self.weight * (np.log(whole) + self.squares / whole)))

    @cached_property
    def further(self) -> float:
        """The most likely further variance, not negative."""
        largest = float(self.squares.max())
        if self.misfit(0.0) <= self.misfit(1e-6 * largest):
            return 0.0
        minimum = minimize_scalar(
            lambda logarithm: self.misfit(float(np.exp(logarithm))),
            bounds=(np.log(1e-6 * largest), np.log(largest)),
            method="bounded",
        )
        return float(np.exp(minimum.x))

    @property
    def relative_sigma(self) -> float:
        """Standard uncertainty of the further standard deviation, relative."""
        share = self.further / (self.noise + self.further)
        return float(1.0 / np.sqrt(2.0 * max(np.sum(self.weight * share**2), 1e-12)))

    def criterion(self, further: float, free: int) -> float:
        """Compute Schwarz's criterion of a further variance."""
        return self.misfit(further) + free * float(np.log(np.sum(self.weight)))
