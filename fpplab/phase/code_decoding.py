"""Decode the codes along one axis by maximum likelihood, whatever kinds they are of."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Axis, Floats, Image, Map
from fpplab.core.progress import Progress, no_progress
from fpplab.patterns.fringe_sets import PatternSet
from fpplab.patterns.recording import Recording
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.code_kernel import search_codes
from fpplab.phase.code_table import CodeTable, code_table
from fpplab.phase.limits import CODES
from fpplab.phase.noise import QUANTISATION, NoiseModel, fit_line, level_step, surprising_power

_BLOCK = 1 << 15  # pixels that one thread decodes at a time (chosen)
_FIGURES = 9  # of each pixel, in the order of `search_codes`
_OFFSET, _MISFIT, _LIKELIHOOD = 3, 4, 8
_Measure = Callable[[NDArray[np.float32]], float]


@dataclass(frozen=True, eq=False)
class CodedAxis:
    """What the codes of one axis tell of every camera pixel, maps (height, width)."""

    coordinate: Map  # px, NaN where a pixel sees no code
    sigma: Map  # 1-sigma of the coordinate in px
    modulation: Map  # half of the difference of white and black, in 8-bit grey levels
    offset: Map  # mean of the images, in 8-bit grey levels
    misfit: Map  # mean square of what the code leaves, in units of the noise's variance
    gap: Map  # by how much χ² is worse at the best coordinate elsewhere
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
    kinds = tuple(recording.plan.sets[k] for k in sets)
    search = _fitted_search(recording, axis, kinds, frames, bounds)
    found = np.empty((frames[0].size, _FIGURES), np.float32)
    starts = range(0, len(found), _BLOCK)

    def decode_block(start: int) -> None:
        part = slice(start, start + _BLOCK)
        search.run([frame[part] for frame in frames], part, found[part])

    with ThreadPoolExecutor(processors()) as pool:
        for done, _ in enumerate(pool.map(decode_block, starts), 1):
            progress(done / len(starts))
    shape = recording.frames[0].shape
    u, variance, modulation, offset, misfit, gap, lower, upper = (
        np.ascontiguousarray(column).reshape(shape) for column in found.T[:_LIKELIHOOD]
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
    search = _fitted_search(recording, axis, tuple(recording.plan.sets[k] for k in sets), frames, None)
    sample = _lit_sample(frames, search.min_range / search.grey)
    if not len(sample):
        return None
    figures, likelihoods = np.empty((len(sample), _FIGURES), np.float32), []
    for order in orders:
        search.run([frames[k][sample] for k in order], sample, figures)
        likelihoods.append(float(np.nansum(figures[:, _LIKELIHOOD], dtype=np.float64)))
    return np.array(likelihoods)


def _lit_sample(frames: Sequence[Image], min_range: float) -> NDArray[np.int64]:
    """Pixels whose raw levels change as those of a code do, evenly spread."""
    lit = np.flatnonzero(level_range(frames) >= min_range)
    return lit[:: max(1, len(lit) // CODES.sample_pixels)]


def processors() -> int:
    """Count the processors that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


@dataclass(frozen=True, eq=False)
class _Search:
    """A table of codes with what the pixels of a recording tell of blur and noise."""

    table: CodeTable
    blur_px: float
    noise: NoiseModel  # of 8-bit grey levels
    grey: float  # grey levels of a raw one
    min_range: float  # of a pixel's levels, in grey levels
    bounds: tuple[NDArray[np.float32], NDArray[np.float32]] | None  # ends of the possible coordinates, (P,)

    def run(
        self, frames: Sequence[Image], pixels: slice | NDArray[np.int64], out: NDArray[np.float32]
    ) -> None:
        """Fill the figures of some pixels, (P, 9)."""
        levels = np.stack(frames, axis=1).astype(np.float32) * np.float32(self.grey)
        used = np.ptp(levels, axis=1) >= self.min_range
        table = self.table
        ranges = np.empty((len(levels), 2), np.int64)
        ranges[:] = 0, table.candidates.shape[1]
        if self.bounds is not None:
            lower, upper = (end[pixels] for end in self.bounds)
            first = table.coordinate[table.start[:-1]]
            ranges[:, 0] = np.maximum(np.searchsorted(first, lower, "right") - 1, 0)
            ranges[:, 1] = np.searchsorted(first, upper, "right")
        parts = (table.candidates, table.start, table.coordinate, table.light, table.scale, table.slope)
        surprise = surprising_power(_freedom(frames))
        noise = (self.noise.constant, self.noise.per_level, CODES.hull_chi2, surprise)
        search_codes(levels, used, ranges, parts, noise, out)


def _freedom(frames: Sequence[Image]) -> int:
    """Images that remain when offset, modulation and coordinate are fitted."""
    return max(len(frames) - 3, 1)


def _fitted_search(
    recording: Recording,
    axis: Axis,
    kinds: tuple[PatternSet, ...],
    frames: Sequence[Image],
    bounds: PossibleCoordinates | None,
) -> _Search:
    """Take the blur that a sample of pixels makes likeliest, and the noise that it then leaves."""
    min_range = 2.0 * recording.plan.masks.modulation_min
    sample = _lit_sample(frames, min_range / recording.grey)
    levels = [frame[sample] for frame in frames]
    step = level_step(np.stack(levels)) * recording.grey if len(sample) else recording.grey
    noise = NoiseModel(QUANTISATION * step**2, 0.0, step)
    ends = None if bounds is None else (bounds.lower.ravel(), bounds.upper.ravel())
    size, figures = recording.projector_size, np.empty((len(sample), _FIGURES), np.float32)
    blur_px = CODES.usual_blur_px
    table = partial(code_table, kinds, axis, size, recording.lattice)
    best = _Search(table(blur_px), blur_px, noise, recording.grey, min_range, ends)
    if not len(sample):
        return best
    # First the noise that the best blur leaves, and with it the likelihood of each blur, which does not
    # prefer those whose codes can follow noise.
    for measure in (_fit, _likelihood):

        def tried(index: int, start: _Search = best, measure: _Measure = measure) -> tuple[float, _Search]:
            blur_px = CODES.blurs_px[index]
            trial = replace(start, table=table(blur_px), blur_px=blur_px)
            trial.run(levels, sample, figures)
            return measure(figures), trial

        best = _highest(tried, len(CODES.blurs_px), CODES.blurs_px.index(best.blur_px))
        best.run(levels, sample, figures)
        offset, misfit = (figures[:, k].astype(np.float64) for k in (_OFFSET, _MISFIT))
        usable = np.isfinite(misfit)
        variance = misfit[usable] * best.noise.variance(offset[usable])
        best = replace(best, noise=fit_line(offset[usable], variance, _freedom(frames), step))
    return best


def _highest(tried: Callable[[int], tuple[float, _Search]], count: int, start: int) -> _Search:
    """Climb from trial to neighbouring trial."""
    index, (value, best) = start, tried(start)
    for step in (1, -1):
        while 0 <= index + step < count and (other := tried(index + step))[0] > value:
            index, (value, best) = index + step, other
    return best


def _fit(figures: NDArray[np.float32]) -> float:
    return -float(np.nanmedian(figures[:, _MISFIT]))


def _likelihood(figures: NDArray[np.float32]) -> float:
    return float(np.nanmean(figures[:, _LIKELIHOOD]))


def level_range(frames: Sequence[Image]) -> Image:
    """Greatest minus smallest raw level of every pixel."""
    highest, lowest = frames[0].copy(), frames[0].copy()
    for frame in frames[1:]:
        np.maximum(highest, frame, out=highest)
        np.minimum(lowest, frame, out=lowest)
    return highest - lowest
