"""A sample of a recording's pixels: spread over the image, and whole tiles where there are edges."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.clouds import Cloud
from fpplab.core.compiled import kernel
from fpplab.core.config import Positive
from fpplab.core.conventions import Axis, Floats, Map, Mask
from fpplab.core.robust import robust_spread
from fpplab.diagnosis.limits import USUAL_LIMITS, CountLimit, DiagnosisLimits, LimitsSection
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded
from fpplab.phase.common_errors import fit_sinusoids
from fpplab.phase.error_model import ErrorModel, error_model_of
from fpplab.phase.precision import phase_uncertainty

MEDIAN = 0.6745  # median absolute value of a normal variable, in its standard deviations


class SampleLimits(LimitsSection):
    """Which pixels are looked at, and which of them see the fringes."""

    pixels: CountLimit = 40_000
    """Pixels spread over the image, about. Chosen: a tenth of a second for all figures."""
    tile_px: CountLimit = 64
    """Side of a whole tile in px. Chosen."""
    max_tiles: CountLimit = 20
    """Number of tiles, those with most contrast. Chosen."""
    min_lit_share: Positive = 0.15
    """Modulation of a pixel that sees the fringes, as a share of the strongest. Measured on benches."""
    min_lit_sigmas: Positive = 8.0
    """The same as a multiple of its own noise. Chosen: noise does not reach it in any of 40 000 pixels."""


@dataclass(frozen=True, eq=False)
class SetFit:
    """The sinusoid of one fringe set at some pixels, in 8-bit grey levels."""

    offset: Floats  # A, shaped as the pixels
    modulation: Floats  # B, of the same shape
    phase: Floats  # phase in rad, of the same shape


@dataclass(frozen=True, eq=False)
class FrameSample:
    """Pixels of a recording."""

    recording: Recording  # whose they are
    coordinates: dict[Axis, Map] = field(default_factory=dict)  # projector coordinates in px by axis
    limits: DiagnosisLimits = USUAL_LIMITS  # that the recording is judged by

    @classmethod
    def of(
        cls, recording: Recording, decoded: Decoded | None, limits: DiagnosisLimits = USUAL_LIMITS
    ) -> FrameSample:
        """Take the pixels of a recording, with their coordinates where it is decoded."""
        coordinates = {axis: decoded.coordinate(axis) for axis in recording.plan.axes} if decoded else {}
        return cls(recording, coordinates, limits)

    @cached_property
    def _limits(self) -> SampleLimits:
        return self.limits.of(SampleLimits)

    @cached_property
    def step(self) -> int:
        """Distance in px between neighbours of the pixels that are spread over the image."""
        height, width = self.recording.frames[0].shape
        return max(1, int(np.sqrt(height * width / self._limits.pixels)))

    @cached_property
    def spread(self) -> Floats:
        """(K, rows, columns) grey levels of every frame at the pixels spread over the image."""
        picked = [frame[:: self.step, :: self.step] for frame in self.recording.frames]
        return np.asarray(self.recording.grey * np.stack(picked).astype(np.float64))

    @cached_property
    def fits(self) -> list[SetFit]:
        """Each fringe set at the pixels spread over the image."""
        return self._fitted(self.spread)

    @cached_property
    def tiles(self) -> Floats:
        """(K, T, side, side) grey levels of every frame in whole tiles, those with most contrast."""
        height, width = self.recording.frames[0].shape
        side = min(self._limits.tile_px, height, width)
        tops, lefts = np.meshgrid(
            np.arange(0, height - side + 1, side), np.arange(0, width - side + 1, side), indexing="ij"
        )
        corners = np.stack([tops.ravel(), lefts.ravel()], axis=1)
        chosen = corners[np.argsort(self._contrasts(corners, side))[::-1][: self._limits.max_tiles]]
        cut = [[f[t : t + side, x : x + side] for t, x in chosen] for f in self.recording.frames]
        return self.recording.grey * np.array(cut, np.float64)

    def _contrasts(self, corners: NDArray[np.intp], side: int) -> Floats:
        """Range of grey levels (T,) in tiles with these corners (T, 2), by the pixels of `spread` in them."""
        mean = np.mean([fit.offset for fit in self.fits], axis=0)
        inner = np.arange(max(side // self.step, 2))
        rows, columns = (
            np.minimum(first[:, None] // self.step + inner, size - 1)
            for first, size in zip(corners.T, mean.shape, strict=True)
        )
        levels = mean[rows[:, :, None], columns[:, None, :]].reshape(len(corners), -1)
        return np.asarray(np.ptp(np.percentile(levels, (5, 95), axis=1), axis=0))

    @cached_property
    def tile_fits(self) -> list[SetFit]:
        return self._fitted(self.tiles)

    @cached_property
    def offsets_in_tiles(self) -> Floats:
        """(sets, T, side, side) offset A of each fringe set in the tiles."""
        return np.stack([fit.offset for fit in self.tile_fits])

    def _fitted(self, frames: Floats) -> list[SetFit]:
        plan = self.recording.plan
        fits = []
        for (a, b), fringe in zip(pairwise(plan.set_starts), plan.fringes, strict=True):
            fitted = fit_sinusoids(frames[a:b].reshape(b - a, -1), fringe)
            offset, c, s = fitted.reshape(3, *frames.shape[1:])
            fits.append(SetFit(offset, np.hypot(c, s), np.arctan2(s, c)))
        return fits

    @cached_property
    def errors(self) -> ErrorModel:
        """Noise of the grey levels, and errors common to all pixels of one phase."""
        return error_model_of(self.recording)

    @cached_property
    def saturated(self) -> Mask:
        """(rows, columns) which of the pixels spread over the image any frame shows saturated."""
        return np.asarray(self.spread.max(axis=0) >= self.recording.grey * self.errors.saturation)

    @cached_property
    def strongest(self) -> float:
        """Modulation in grey levels of the best lit pixels: the 99.9th percentile in the widest fringes."""
        return float(np.percentile(self.widest.modulation, 99.9))

    @cached_property
    def widest(self) -> SetFit:
        """The set of the widest fringes, which blur changes least."""
        return self.fits[self._widest]

    @cached_property
    def _widest(self) -> int:
        return int(np.argmin([fringe.stripes for fringe in self.recording.plan.fringes]))

    @cached_property
    def noise_level(self) -> float:
        """Noise of a grey level at the tiles' mean level, from neighbouring pixels: motion is no noise."""
        first = self.recording.plan.set_starts[self._widest]
        change = self.tiles[first + 1] - self.tiles[first]
        bend = np.diff(change, 2, axis=-1)
        # Second differences of the difference of two frames have 6 + 6 times the variance of one.
        return max(robust_spread(bend.ravel(), 0.0) / math.sqrt(12.0), math.sqrt(1.0 / 12.0))

    def noise(self, offset: Floats | float) -> Floats:
        """Compute the standard deviation of the modulation of the widest fringes."""
        steps, model = self.recording.plan.fringes[self._widest].images, self.errors.noise
        # Motion and flicker pass for noise in the model, which compares frames, but not between neighbours.
        variance = float(model.variance(float(self.offsets_in_tiles.mean())))
        share = min(1.0, self.noise_level**2 / max(variance, 1e-12))
        return np.asarray(np.sqrt(2.0 / steps * np.maximum(share * model.variance(offset), 1.0 / 12.0)))

    def phase_noise(self, index: int) -> float:
        """Compute the noise of the phase of a fringe set at a typical measured pixel; there must be some."""
        fit, steps = self.fits[index], self.recording.plan.fringes[index].images
        offset = float(np.median(fit.offset[self.measured]))
        modulation = max(float(np.median(fit.modulation[self.measured])), 1e-6)
        noise = math.sqrt(float(self.errors.noise.variance(offset)))
        return float(phase_uncertainty(noise, modulation, steps))

    @cached_property
    def coherence(self) -> float:
        """Share of the power of the widest fringes that 25 neighbours share: 0 for noise, 1 for fringes."""
        fit = self.tile_fits[self._widest]
        phasor = fit.modulation * np.exp(1j * fit.phase)
        around = (
            cv2.blur(part, (5, 5), borderType=cv2.BORDER_REFLECT)
            for tile in phasor
            for part in (tile.real, tile.imag)
        )
        shared = sum(np.square(each).sum() for each in around)
        share = float(shared) / max(float(np.sum(np.square(fit.modulation))), 1e-12)
        return (share - 1.0 / 25.0) / (1.0 - 1.0 / 25.0)

    @cached_property
    def lit(self) -> Mask:
        """(rows, columns) which of the pixels spread over the image see the projector's fringes."""
        of_strongest = self._limits.min_lit_share * self.strongest
        of_noise = self._limits.min_lit_sigmas * self.noise(self.widest.offset)
        is_lit = self.widest.modulation >= np.maximum(of_strongest, of_noise)
        return np.asarray(is_lit | (self.saturated & (self.widest.offset > 128.0)))

    def estimate_pixels_seeing_fringes(self, points: Cloud | Decoded) -> float:
        """Count the pixels of the whole image that see the projector's fringes."""
        others = self.lit
        if isinstance(points, Decoded):
            count, others = int(points.valid.sum()), others & ~points.valid[:: self.step, :: self.step]
        else:
            count = len(points)
            if points.pixels is not None:
                others = others & (self.numbers_of(points.pixels) < 0)
        return count + float(others.mean()) * self.recording.frames[0].size

    def numbers_of(self, pixels: NDArray[np.int32]) -> NDArray[np.int32]:
        """Give the number of the point at each pixel spread over the image, -1 where there is none."""
        # pixels (N, 2); returns (rows, columns)
        numbers = np.full(self.spread.shape[1:], -1, np.int32)
        _enter_numbers(pixels, self.step, numbers)
        return numbers

    @cached_property
    def measured(self) -> Mask:
        """(rows, columns) which of them are lit and not saturated."""
        return np.asarray(self.lit & ~self.saturated)


@kernel()
def _enter_numbers(pixels: NDArray[np.int32], step: int, numbers: NDArray[np.int32]) -> None:
    row, is_sampled = -1, False
    for i in range(len(pixels)):
        u, v = pixels[i, 0], pixels[i, 1]
        if v != row:
            row, is_sampled = v, v % step == 0
        if is_sampled and u % step == 0:
            numbers[v // step, u // step] = i
