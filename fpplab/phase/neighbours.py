"""What neighbouring pixels show of errors that the images of one pixel do not.

Frames that were compressed, denoised, sharpened or scaled have errors that a pixel's own images hardly show:
an edge of reflectivity draws the phases beside it to the brighter side, a filter that is not linear bends
fringes, and what rounding the cosines of a block of pixels leaves is nearly a sinusoid. Second differences D
of the phase along rows and columns take smooth surfaces away. What is left is noise, and

    w² D(∇φ·∇ln A) + D(a cos Nφ + b sin Nφ),

where w is the blur in px, A the brightness, and N the number of images. Least squares find w², a and b. The
rest is compared with second differences of the residuals of the sinusoids, which went through the same
filter: the ratio is one unless phases scatter by more than residuals show. Three steps leave no residuals,
and the phases' second differences alone tell. A rough surface scatters too, so all this counts only where
residuals of neighbours are correlated, as those of a sensor's own frames are not.

In frames that nothing filtered, phases of neighbours may scatter by less than residuals: a part that vibrates
and a lamp that flickers leave residuals that are alike for all pixels of one phase.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Mask
from fpplab.core.robust import robust_spread
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.recording import Recording
from fpplab.phase.common_errors import CommonErrors, HarmonicsFit, fit_sinusoids, set_group
from fpplab.phase.limits import NEIGHBOURS
from fpplab.phase.noise import NoiseModel, fit_line, surprising_power

S = TypeVar("S", bound=np.generic)

_ALONG = (-2, -1)  # axes of an array of tiles that are rows and columns
_SQUARE_OF_BEND = 6.0  # variance of the second difference of independent values, 1² + 2² + 1²


@dataclass(frozen=True, eq=False)
class Tiles:
    """Whole tiles of a recording's frames, spread over the image."""

    levels: Floats  # (K, T, height, side) grey levels of every frame
    usable: Mask  # (T, height, side) pixels that no frame shows saturated or, unless few remain, black

    @classmethod
    def of(cls, recording: Recording, saturation: int) -> Tiles | None:
        """Cut tiles out of the frames; None where these are too small."""
        side, (rows, columns) = NEIGHBOURS.tile_px, recording.frames[0].shape
        if min(rows, columns) < side:
            return None
        tops, height = _spread_tiles(rows, side), side
        if recording.rows is not None:
            tops, height = _tiles_in_bands(recording.rows, side)
        lefts = _spread_tiles(columns, side)
        raw = np.array(
            [[f[v : v + height, u : u + side] for v in tops for u in lefts] for f in recording.frames]
        )
        bright = np.asarray((raw < saturation).all(axis=0))
        unclipped = bright & (raw > 0).all(axis=0)
        usable = unclipped if unclipped.sum() >= NEIGHBOURS.min_pixels else bright
        return cls(raw * np.float32(recording.grey), usable)


def _spread_tiles(size: int, side: int) -> NDArray[np.intp]:
    """Where tiles begin, each in the middle of an equal part of the image."""
    count = min(NEIGHBOURS.tiles_along, size // side)
    return (size * (np.arange(count) + 0.5) / count - 0.5 * side).astype(np.intp)


def _tiles_in_bands(rows: NDArray[np.intp], side: int) -> tuple[NDArray[np.intp], int]:
    """Where tiles begin that lie within bands of rows, and how high they are."""
    begins = np.flatnonzero(np.diff(rows, prepend=-2) != 1)
    lengths = np.diff(begins, append=len(rows))
    height = min(side, int(lengths.min()))
    count = min(len(begins), NEIGHBOURS.tiles_along * side // height)
    chosen = ((np.arange(count) + 0.5) * len(begins) / count).astype(np.intp)
    return begins[chosen] + (lengths[chosen] - height) // 2, height


def with_errors_of_neighbours(
    sets: Sequence[CommonErrors],
    recording: Recording,
    saturation: int,
    fits: Mapping[int, HarmonicsFit],
    noise: NoiseModel,
) -> list[CommonErrors]:
    """Add what neighbours show to the errors of each set; `fits` are those of single sets by index."""
    tiles, plan = Tiles.of(recording, saturation), recording.plan
    if tiles is None:
        return list(sets)
    gradients = np.gradient(np.log(np.maximum(tiles.levels.mean(axis=0), 1.0)), axis=_ALONG)
    result = []
    for k, (errors, fringe) in enumerate(zip(sets, plan.fringes, strict=True)):
        finest = plan.fringes[plan.finest_set(fringe.axis)].stripes
        if fringe.stripes < NEIGHBOURS.min_share_of_finest * finest:
            result.append(errors)
            continue
        beside = k - 1 if k else min(1, len(sets) - 1)
        levels, others = (tiles.levels[slice(*plan.set_starts[j : j + 2])] for j in (k, beside))
        phases = _PhasesInTiles(levels, tiles.usable, fringe, plan.masks.modulation_min, noise)
        result.append(phases.added_to(errors, gradients, fits.get(k), others))
    return result


def noise_of_neighbours(recording: Recording, saturation: int, noise: NoiseModel) -> NoiseModel:
    """Estimate the noise of one set of three steps, whose images leave nothing else to tell it."""
    # Roughness of the surface counts as noise, since nothing tells them apart.
    tiles, fringe = Tiles.of(recording, saturation), recording.plan.fringes[0]
    if tiles is None:
        return noise
    phases = _PhasesInTiles(tiles.levels, tiles.usable, fringe, recording.plan.masks.modulation_min, noise)
    if phases.used.sum() < NEIGHBOURS.min_pixels:
        return noise
    of_noise = fringe.phase_noise * np.sqrt(_SQUARE_OF_BEND) / _inner(phases.modulation)[phases.used]
    bends = np.concatenate([_bend(phases.phasor, axis)[phases.used] / of_noise for axis in _ALONG])
    level = np.tile(_inner(phases.fitted[0])[phases.used], len(_ALONG))
    return fit_line(level, np.square(bends), 1, noise.step)


class _PhasesInTiles:
    """The phases of one set in tiles, and their second differences."""

    def __init__(
        self, levels: Floats, usable: Mask, fringe: FringeSet, modulation_min: float, noise: NoiseModel
    ) -> None:
        self.levels, self.fringe, self.noise = levels, fringe, noise
        self.fitted = fit_sinusoids(levels.reshape(len(levels), -1), fringe).reshape(3, *levels.shape[1:])
        self.wave = self.fitted[1] + 1j * self.fitted[2]
        self.modulation = np.maximum(np.abs(self.wave), 1e-3)
        self.phasor = self.wave / self.modulation
        self._bright: Mask = usable & (self.modulation >= max(modulation_min, NEIGHBOURS.min_modulation))
        self.used: Mask = _inner(
            np.all([np.roll(self._bright, by, axis) for axis in _ALONG for by in range(-2, 3)], axis=0)
        )

    def added_to(
        self, errors: CommonErrors, gradients: Sequence[Floats], fit: HarmonicsFit | None, others: Floats
    ) -> CommonErrors:
        if self.used.sum() < NEIGHBOURS.min_pixels:
            return errors
        images, phase = self.fringe.images, np.angle(self.phasor)
        slopes = [_slope(self.phasor, axis) for axis in _ALONG]
        edges = np.sum([slope * g for slope, g in zip(slopes, gradients, strict=True)], axis=0)
        shapes = np.stack([edges, np.cos(images * phase), np.sin(images * phase)])
        bends = np.stack([_bend(self.phasor, axis)[self.used] for axis in _ALONG])
        if robust_spread(bends.ravel(), 0.0) > NEIGHBOURS.max_bend_rad:
            return errors
        terms = np.stack([_differences(shapes, axis)[:, self.used] for axis in _ALONG], axis=1)
        if np.square(terms[1:]).sum(axis=0).mean(axis=1).max() < NEIGHBOURS.min_ripple_power:
            terms[1:] = 0.0  # a wide ripple looks as a surface does
        strengths, rest, kept = _fitted(terms.reshape(3, -1), bends.ravel())
        ripple_rad = float(np.hypot(*strengths[1:])) / np.sqrt(2.0)
        beyond = max(0.0, ripple_rad**2 - float(np.nan_to_num(errors.harmonic_rad)) ** 2)
        if fit is None:
            nearest = float(np.square(rest[kept]).mean())
            misfit = scatter = self._scatter_of_three_steps(others, nearest, strengths, shapes)
        elif self._were_filtered(residuals := self._residuals(fit)):
            bends, power = self._scatter(residuals, rest.reshape(2, -1), kept.reshape(2, -1))
            misfit = scatter = max(bends, 1.0) * power
            far = self._variance_of_distant_bends(strengths, shapes) if bends < 1.0 else None
            if far is not None:  # what a filter bends besides noise is in the residuals, not in the phases
                nearest = float(np.square(rest[kept]).mean())
                scatter = min(misfit, max(nearest, far) / self._variance_of_noise())
        else:
            misfit, scatter = 1.0, self._scatter_of_independent(rest.reshape(2, -1))
        with_ripple = replace(errors, ripple_rad=float(np.sqrt(beyond)), blur_px2=float(strengths[0]))
        return replace(with_ripple, scatter=scatter, misfit_scatter=misfit)

    def _residuals(self, fit: HarmonicsFit) -> Floats:
        """What sinusoids, gains and harmonics leave, each as noisy as a level."""
        count, shape = len(self.levels), self.levels.shape[1:]
        group = set_group(0, self.levels.reshape(count, -1), self.fitted.reshape(3, -1), self.fringe)
        return group.combine_without_common_errors(group.quiet, fit).reshape(-1, *shape)

    def _were_filtered(self, residuals: Floats) -> bool:
        """Whether residuals of neighbours are correlated, and not only because their phases are alike."""
        return _are_correlated(residuals, self.used) and _are_correlated(
            self._without_common_phases(residuals), self.used
        )

    def _without_common_phases(self, residuals: Floats) -> Floats:
        """Take off what is alike for all pixels of one phase in a tile, as where a part vibrates."""
        # residuals (R, T, height, side)
        shape, tiles = residuals.shape, len(self.fitted[0])
        bright = self._bright.reshape(tiles, 1, -1)
        once, twice = self.phasor, self.phasor**2
        waves = np.stack([once.real, once.imag, twice.real, twice.imag])
        terms = np.moveaxis(self.modulation * waves, 0, 1).reshape(tiles, len(waves), -1) * bright
        values = np.moveaxis(residuals, 0, 1).reshape(tiles, len(residuals), -1)
        normal = np.einsum("tap,tbp->tab", terms, terms)
        strengths = np.linalg.pinv(normal, hermitian=True) @ np.einsum("tap,trp->tar", terms, values)
        left = values - np.einsum("tap,tar->trp", terms, strengths)
        return np.moveaxis(left, 1, 0).reshape(shape)

    def _scatter_of_independent(self, rest: Floats) -> float:
        """Variance of the phases beside that of noise in frames that nothing filtered; 1 at most."""
        # rest (2, P). What scatters by more is a rough surface.
        scaled = rest / np.sqrt(_SQUARE_OF_BEND * 2.0 / len(self.levels) * self._noise_per_power())
        kept = np.abs(scaled) < NEIGHBOURS.outlier_sigmas * robust_spread(scaled.ravel(), 1e-6)
        scatter = float(np.square(scaled[kept]).mean())
        # Second differences share pixels: of n pixels the mean square has a relative uncertainty of 2/√n.
        chance = NEIGHBOURS.significance * 2.0 / np.sqrt(scaled.shape[1])
        return scatter if scatter < 1.0 - chance else 1.0

    def _change_of_offset(self, others: Floats) -> Floats:
        """The offset beside that of another set, as noisy as a level; 0 where there is no other."""
        # Three images leave nothing else. Gains change it too, and the response by its third harmonic.
        change = self.fitted[0] - others.mean(axis=0)
        third = self.modulation * self.phasor**3
        terms = np.stack([*self.fitted, third.real, third.imag])
        known = terms.reshape(len(terms), -1)[:, self._bright.ravel()]
        strengths = np.linalg.pinv(np.einsum("ap,bp->ab", known, known), hermitian=True) @ np.einsum(
            "ap,p->a", known, change[self._bright]
        )
        change -= np.einsum("a,a...->...", strengths, terms)
        return np.asarray(change / np.sqrt(1.0 / len(self.levels) + 1.0 / len(others)))[None]

    def _scatter_of_three_steps(
        self, others: Floats, nearest: float, strengths: Floats, shapes: Floats
    ) -> float:
        """Variance of the phases beside that of noise, by phases alone; 1 where neighbours are independent.

        Offsets tell whether frames were filtered, but not by how much phases scatter: a filter changes the
        offset of coarse fringes otherwise than that of fine ones.
        """
        # shapes (3, T, height, side)
        if not _are_correlated(self._change_of_offset(others), self.used):
            return 1.0
        far = self._variance_of_distant_bends(strengths, shapes) or nearest
        scatter = max(nearest, far) / self._variance_of_noise()
        # Beyond the limit it is a rough surface, or images without noise.
        return scatter if scatter < NEIGHBOURS.max_scatter else 1.0

    def _variance_of_noise(self) -> float:
        """Mean square of second differences that the noise of grey levels makes."""
        return _SQUARE_OF_BEND * 2.0 / len(self.levels) * float(self._noise_per_power().mean())

    def _noise_per_power(self) -> Floats:
        """Variance of the noise of every pixel that is used, over the square of its modulation."""
        return _inner(self.noise.variance(self.fitted[0]) / np.square(self.modulation))[self.used]

    def _variance_of_distant_bends(self, strengths: Floats, shapes: Floats) -> float | None:
        """Mean square of second differences over 2 and 3 px; None where it grows as no noise does."""
        # Neighbours share some of the noise of filtered frames; pixels further apart do not.
        second, third = (self._mean_square_bend(apart, strengths, shapes) for apart in (2, 3))
        return 0.5 * (second + third) if third < NEIGHBOURS.max_growth * second else None

    def _mean_square_bend(self, apart: int, strengths: Floats, shapes: Floats) -> float:
        """Mean square of the second differences of pixels some px apart, beyond edges and ripple."""
        # strengths (3,); shapes (3, T, height, side)
        near = [np.roll(self._bright, by, axis) for axis in _ALONG for by in (-apart, 0, apart)]
        used = _inner(np.all(near, axis=0), max(apart, 2))
        rest = [
            _bend(self.phasor, axis, apart) - np.tensordot(strengths, _differences(shapes, axis, apart), 1)
            for axis in _ALONG
        ]
        values = np.stack(rest)[:, used]
        spread = robust_spread(values.ravel(), 1e-6)
        return float(np.square(values[np.abs(values) < NEIGHBOURS.outlier_sigmas * spread]).mean())

    def _scatter(self, residuals: Floats, rest: Floats, kept: Mask) -> tuple[float, float]:
        """Variance of the phases beside residuals, and of these beside noise, in filtered frames."""
        # residuals (R, T, height, side); rest (2, P); kept (2, P)
        count = len(self.levels)
        variance = _inner(self.noise.variance(self.fitted[0]))[self.used]
        power = np.square(_inner(residuals)[:, self.used]).mean(axis=0) / variance
        power = power[power < surprising_power(len(residuals))]
        between = np.stack([_differences(residuals / self.modulation, a)[:, self.used] for a in _ALONG])
        noise = 2.0 / count * float(np.square(between).mean(axis=1)[kept].mean())
        scattered = float(np.square(rest[kept]).mean())
        if scattered >= NEIGHBOURS.max_scatter * noise:
            return 1.0, 1.0  # a rough surface, or images without noise
        return scattered / noise, max(float(power.mean()), 1.0)


def _inner(values: NDArray[S], margin: int = 2) -> NDArray[S]:
    """Tiles without some pixels at every side, whose neighbours lie in other tiles or are none."""
    return values[..., margin:-margin, margin:-margin]


def _slope(phasor: Floats, axis: int) -> Floats:
    """Change of the phase per pixel, in rad."""
    return np.asarray(0.5 * np.angle(np.roll(phasor, -1, axis) * np.roll(phasor, 1, axis).conj()))


def _bend(phasor: Floats, axis: int, apart: int = 1) -> Floats:
    """Second difference of the phase in rad."""
    beside = np.roll(phasor, -apart, axis) * np.roll(phasor, apart, axis)
    return _inner(np.angle(beside * phasor.conj() ** 2), max(apart, 2))


def _differences(values: Floats, axis: int, apart: int = 1) -> Floats:
    """Second differences of values that do not wrap."""
    differences = np.roll(values, -apart, axis) + np.roll(values, apart, axis) - 2.0 * values
    return np.asarray(_inner(differences, max(apart, 2)))


def _fitted(terms: Floats, values: Floats) -> tuple[Floats, Floats, Mask]:
    """Strengths of terms by least squares, 0 where noise may have made them, what they leave, and inliers."""
    # terms (3, V); values (V,)
    rest, kept = values, np.full(values.shape, False)
    for _ in range(NEIGHBOURS.fit_passes):
        before, kept = kept, np.abs(rest) < NEIGHBOURS.outlier_sigmas * robust_spread(rest, 1e-6)
        if (kept == before).all():
            break
        chosen = terms[:, kept]
        # Not by BLAS, see `fpplab.phase.common_errors`.
        inverse = np.linalg.pinv(np.einsum("ap,bp->ab", chosen, chosen), hermitian=True)
        strengths = inverse @ np.einsum("ap,p->a", chosen, values[kept])
        rest = values - strengths @ terms
    sigma = np.sqrt(np.diag(inverse) * np.square(rest[kept]).mean())
    return np.where(np.abs(strengths) > NEIGHBOURS.significance * sigma, strengths, 0.0), rest, kept


def _are_correlated(residuals: Floats, used: Mask) -> bool:
    """Whether residuals of neighbours are, seen across the direction in which smooth ones were taken off."""
    # What is the same for all pixels of one phase, as where an exposure is no multiple of the projector's
    # period, is common to long stretches along the fringes; no filter reaches as far.
    for across, along in (_ALONG, _ALONG[::-1]):
        bends = _differences(residuals, along) * used
        # Every tile counts by its pixels, so that two faces in one do not count for all.
        power = np.square(bends).sum(axis=(0, *_ALONG), keepdims=True)
        bends *= np.sqrt(used.sum(axis=_ALONG, keepdims=True) / np.maximum(power, 1e-12))
        near, far = (
            abs((bends * np.roll(bends, apart, across)).sum()) for apart in (1, NEIGHBOURS.unfiltered_px)
        )
        chance = NEIGHBOURS.significance / np.sqrt(len(residuals) * used.sum())
        limit = max(NEIGHBOURS.max_correlation, chance) * np.square(bends).sum()
        if near > limit and far < NEIGHBOURS.max_reach * near:
            return True
    return False
