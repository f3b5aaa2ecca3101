"""Decode the codes along one axis by maximum likelihood, whatever kinds they are of."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from math import log

import numpy as np
from numpy.typing import NDArray

from fpplab.core import buffers
from fpplab.core.conventions import Axis, Floats, Image, Lattice, Map
from fpplab.core.progress import Progress, no_progress
from fpplab.patterns.fringe_sets import PatternSet
from fpplab.patterns.recording import Recording
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.code_kernel import SearchLimits, search_codes
from fpplab.phase.code_table import CodeTable, code_table, with_bounds
from fpplab.phase.limits import CODES
from fpplab.phase.noise import QUANTISATION, NoiseModel, fit_line, level_step, surprising_power

_BLOCK = 30_000  # pixels that one thread decodes at a time (chosen: no power of 2, rows share no cache lines)
_FIGURES = 9  # of each pixel, in the order of `search_codes`
_OFFSET, _MISFIT, _WIDTH = 3, 4, 8
_NARROWEST_PX = np.float32(1e-5)  # less than single precision tells of a coordinate
_Measure = Callable[[NDArray[np.float32]], float]


@dataclass(frozen=True, eq=False)
class CodedAxis:
    """What the codes of one axis tell of every camera pixel, maps (height, width)."""

    coordinate: Map  # px, NaN where a pixel sees no code
    sigma: Map  # 1-sigma of the coordinate in px
    modulation: Map  # half of the difference of white and black, in 8-bit grey levels
    offset: Map  # mean of the images, in 8-bit grey levels
    misfit: Map  # mean square of what the code leaves, in units of the noise's variance
    gap: Map  # by how much χ² is worse at the best coordinate elsewhere, at most what is looked for
    lower: Map  # least coordinate that noise does not exclude, px
    upper: Map  # greatest one, px
    blur_px: float  # standard deviation of the blur of projector and camera
    noise: NoiseModel  # of the grey levels


def decode_codes(
    recording: Recording,
    axis: Axis,
    sets: tuple[int, ...],
    bounds: PossibleCoordinates | None = None,
    progress: Progress = no_progress,
) -> CodedAxis:
    """Find the likeliest coordinate of every pixel along one axis by some of the sets."""
    frames = [frame.reshape(-1) for k in sets for frame in recording.of_set(k)]
    search, _ = _fitted_search(recording, axis, sets, frames)
    ends = None if bounds is None else (bounds.lower.ravel(), bounds.upper.ravel())
    search = replace(search, table=with_bounds(search.table), bounds=ends)
    figures = buffers.empty((_FIGURES, frames[0].size))
    starts = range(0, frames[0].size, _BLOCK)

    def decode_block(start: int) -> None:
        part = slice(start, start + _BLOCK)
        figures[:, part] = search.run([frame[part] for frame in frames], part)

    with ThreadPoolExecutor(processors()) as pool:
        for done, _ in enumerate(pool.map(decode_block, starts), 1):
            progress(done / len(starts))
    shape = recording.frames[0].shape
    u, variance, modulation, offset, misfit, gap, lower, upper = (
        row.reshape(shape) for row in figures[:_WIDTH]
    )
    return CodedAxis(
        u, np.sqrt(variance), modulation, offset, misfit, gap, lower, upper, search.blur_px, search.noise
    )


def sampled_likelihood(
    recording: Recording, axis: Axis, sets: tuple[int, ...], orders: Sequence[NDArray[np.int64]]
) -> Floats | None:
    """Logarithm of the likelihood of a sample of pixels with their frames in several orders."""
    # orders (K,) each, of the frames of the sets; None where no pixel sees a code
    frames = [frame.reshape(-1) for k in sets for frame in recording.of_set(k)]
    search, sample = _fitted_search(recording, axis, sets, frames)
    if not len(sample):
        return None
    likelihoods = []
    for order in orders:
        figures = search.run([frames[k][sample] for k in order], sample)
        likelihoods.append(float(np.nansum(_likelihoods(figures, len(frames)), dtype=np.float64)))
    return np.array(likelihoods)


def _lit_sample(frames: Sequence[Image], min_range: float) -> NDArray[np.int64]:
    """Pixels whose raw levels change as those of a code do, evenly spread."""
    apart = max(1, frames[0].size // CODES.looked_at_pixels)
    lit = apart * np.flatnonzero(level_range([frame[::apart] for frame in frames]) >= min_range)
    return lit[:: max(1, len(lit) // CODES.sample_pixels)]


def processors() -> int:
    """Count the processors that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


@dataclass(frozen=True)
class _Codes:
    """Codes of one axis, and which pixels see them."""

    kinds: tuple[PatternSet, ...]
    axis: Axis
    size: tuple[int, int]
    lattice: Lattice
    grey: float  # grey levels of a raw one
    min_range: float  # of a pixel's levels, in grey levels
    certain_chi2: float  # as in `SearchLimits`

    def table(self, blur_px: float) -> CodeTable:
        return code_table(self.kinds, self.axis, self.size, self.lattice, blur_px)


@dataclass(frozen=True, eq=False)
class _Search:
    """A table of codes with what the pixels of a recording tell of blur and noise."""

    codes: _Codes
    table: CodeTable
    blur_px: float
    noise: NoiseModel  # of 8-bit grey levels
    bounds: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None  # of possible coordinates, (P,)

    def run(self, frames: Sequence[Image] | Image, pixels: slice | NDArray[np.int64]) -> NDArray[np.float32]:
        """Figures of some pixels, (9, P)."""
        table, (images, count) = self.table, (len(frames), len(frames[0]))
        levels, figures = np.empty((images, count), np.float32), np.empty((_FIGURES, count), np.float32)
        for row, frame in zip(levels, frames, strict=True):
            np.multiply(frame, np.float32(self.codes.grey), out=row, dtype=np.float32)
        if self.bounds is None:
            lower, upper = (np.full(count, end - 0.5, np.float32) for end in (0, table.length))
        else:
            lower, upper = (end[pixels] for end in self.bounds)
        limits = SearchLimits(
            self.noise.constant,
            self.noise.per_level,
            CODES.hull_chi2,
            self.codes.certain_chi2,
            surprising_power(_freedom(images)),
        )
        upper = np.where(np.ptp(levels, axis=0) >= self.codes.min_range, upper, lower)
        levels -= np.mean(levels, axis=0, out=figures[_OFFSET])
        search_codes(levels, lower, upper, table, limits, table.memory(), figures)
        return figures


def _freedom(images: int) -> int:
    """Images that remain when offset, modulation and coordinate are fitted."""
    return max(images - 3, 1)


def _fitted_search(
    recording: Recording, axis: Axis, sets: tuple[int, ...], frames: Sequence[Image]
) -> tuple[_Search, NDArray[np.int64]]:
    """Blur and noise that a sample of pixels tells, and the sample."""
    rules, kinds = recording.plan.masks, tuple(recording.plan.sets[k] for k in sets)
    size, lattice, min_range = recording.projector_size, recording.lattice, 2.0 * rules.modulation_min
    certain = max(CODES.certain_chi2, 1.0 - 2.0 * log(rules.wrong_order_max))
    codes = _Codes(kinds, axis, size, lattice, recording.grey, min_range, certain)
    sample = _lit_sample(frames, min_range / recording.grey)
    levels = np.stack([frame[sample] for frame in frames])
    return _fitted(codes, len(frames), levels.dtype.str, levels.tobytes()), sample


@lru_cache(maxsize=8)  # of two axes, which are decoded, and whose order of images is then judged
def _fitted(codes: _Codes, images: int, kind: str, sample: bytes) -> _Search:
    """Take the blur that makes a sample of pixels likeliest, and the noise that it then leaves."""
    levels = np.frombuffer(sample, kind).reshape(images, -1)
    some = slice(0, levels.shape[1])
    step = (level_step(levels) if levels.size else 1.0) * codes.grey
    blur_px, noise = CODES.usual_blur_px, NoiseModel(QUANTISATION * step**2, 0.0, step)
    best = _Search(codes, codes.table(blur_px), blur_px, noise)
    if not levels.size:
        return best
    # First the noise that the best blur leaves, and with it the likelihood of each blur, which does not
    # prefer those whose codes can follow noise.

    def likelihood(figures: NDArray[np.float32]) -> float:
        return float(np.nanmean(_likelihoods(figures, images)))

    for measure in (_fit, likelihood):

        def tried(index: int, start: _Search = best, measure: _Measure = measure) -> tuple[float, _Search]:
            blur_px = CODES.blurs_px[index]
            trial = replace(start, table=codes.table(blur_px), blur_px=blur_px)
            return measure(trial.run(levels, some)), trial

        best = _highest(tried, len(CODES.blurs_px), CODES.blurs_px.index(best.blur_px))
        figures = best.run(levels, some)
        offset, misfit = (figures[k].astype(np.float64) for k in (_OFFSET, _MISFIT))
        usable = np.isfinite(misfit)
        variance = misfit[usable] * best.noise.variance(offset[usable])
        best = replace(best, noise=fit_line(offset[usable], variance, _freedom(images), step))
    return best


def _highest(tried: Callable[[int], tuple[float, _Search]], count: int, start: int) -> _Search:
    """Climb from trial to neighbouring trial."""
    index, (value, best) = start, tried(start)
    for step in (1, -1):
        while 0 <= index + step < count and (other := tried(index + step))[0] > value:
            index, (value, best) = index + step, other
    return best


def _fit(figures: NDArray[np.float32]) -> float:
    return -float(np.nanmedian(figures[_MISFIT]))


def _likelihoods(figures: NDArray[np.float32], images: int) -> NDArray[np.float32]:
    """Logarithm of the likelihood of the code at any coordinate."""
    freedom = _freedom(images)
    misfit = np.minimum(figures[_MISFIT], np.float32(surprising_power(freedom)))
    width = np.maximum(figures[_WIDTH], _NARROWEST_PX)  # 0 px where frames have no noise
    return np.asarray(np.log(width) - np.float32(0.5 * freedom) * misfit)


def level_range(frames: Sequence[Image]) -> Image:
    """Greatest minus smallest raw level of every pixel."""
    highest, lowest = frames[0].copy(), frames[0].copy()
    for frame in frames[1:]:
        np.maximum(highest, frame, out=highest)
        np.minimum(lowest, frame, out=lowest)
    return highest - lowest
