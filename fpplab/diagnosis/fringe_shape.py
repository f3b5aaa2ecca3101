"""Causes that are seen in the phase of wide fringes beside the coordinate, and in the coordinate itself."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Axis, Floats, Image, Map, Mask, axis_length
from fpplab.diagnosis.catalogue import FaultCause, Finding
from fpplab.diagnosis.sample import FrameSample

LEAST_RIPPLED, MOST_UNEVEN = 500, 0.3
"""Fewest pixels that tell a ripple, and how unevenly they may be spread over its period."""

MOST_STRAY_RAD = 0.055
"""Phase error of wide fringes in rad RMS that neighbours share and no phase explains."""

BLOCK = 8
"""Side in pixels of the sample of the blocks over which phase errors are averaged."""

LEAST_KNOWN = 0.5
"""Least share of a block's pixels whose phase error is known."""

MOST_MOIRE_PX = 0.04
"""Amplitude in projector px of an error of the coordinate that repeats with the projector's pixels."""

SMOOTHED_PX = 24
"""Camera px over which a surface is taken as straight."""

MOIRE_CYCLES = (0.06, 0.55)
"""Least and greatest frequency of a moiré in cycles per projector px."""

OFF_CYCLES = 0.006
"""How far from those of the fringes and their harmonics frequencies of a moiré lie, in cycles per px."""

FRINGE_ORDERS = 6
"""Harmonics of the fringes that are taken out of the coordinate's roughness before a moiré is looked for."""

EVEN_SHARE = 0.03
"""Greatest change of brightness from pixel to pixel, as a share, of an even scene."""

FEWEST_FRINGES = 4.0
"""Periods of a set that have to be seen for its harmonics to be told from a moiré."""

MOIRE_POINTS = 60_000
"""Most coordinates that a moiré is looked for in."""


def unevenness(phase: Floats, used: Mask) -> Floats:
    """Measure how unevenly phases are spread over a period."""
    # phase (..., P); used (..., P)
    turns = (np.where(used, np.exp(1j * m * phase), 0.0) for m in (1, 2, 3))
    return np.asarray(np.max([np.abs(turn.sum(axis=-1)) / used.sum(axis=-1) for turn in turns], axis=0))


def phase_deviations(sample: FrameSample) -> Iterator[tuple[int, Floats, Floats]]:
    """Compare the phases of wide sets with those that the coordinate gives, in which the finest set rules."""
    recording = sample.recording
    for k, fringe in enumerate(recording.plan.fringes):
        finest = recording.plan.fringes[recording.plan.finest_set(fringe.axis)]
        known = sample.coordinates.get(fringe.axis)
        if known is None or fringe.stripes > 0.5 * finest.stripes:
            continue
        size = axis_length(recording.projector_size, fringe.axis)
        position = (known[:: sample.step, :: sample.step].astype(np.float64) + 0.5) / size
        used = sample.measured & np.isfinite(position)
        if used.sum() < LEAST_RIPPLED:
            continue
        expected = np.where(used, TWO_PI * fringe.stripes * position, np.nan)
        off = np.exp(1j * (sample.fits[k].phase - expected))
        yield k, expected, np.angle(off * np.conj(off[used].mean()))


def ripples(sample: FrameSample) -> Iterator[float]:
    """Measure the phase error, N times in a period, of wider sets of as many images N as the finest.

    Three images show no harmonics by themselves, and four no third one; the coordinate tells which phase each
    wider set should have.
    """
    plan = sample.recording.plan
    for k, expected, deviation in phase_deviations(sample):
        fringe = plan.fringes[k]
        if fringe.images != plan.fringes[plan.finest_set(fringe.axis)].images:
            continue
        known = np.isfinite(deviation)
        wave = np.exp(1j * fringe.images * expected[known])
        if np.abs(wave.mean()) < MOST_UNEVEN:
            off = deviation[known]
            yield float(math.sqrt(2.0) * np.abs(np.mean((off - off.mean()) * wave)))


def stray_light(sample: FrameSample, explained_rad: float) -> Finding | None:
    """Look for light that arrives by way of other surfaces, with the phase of those."""
    worst = max((_stray_rad(sample, k, e, d) for k, e, d in phase_deviations(sample)), default=0.0)
    limit = max(MOST_STRAY_RAD, 1.5 * explained_rad)
    if worst <= limit:
        return None
    words = (
        f"the phase of wide fringes differs from that of fine ones by {worst:.2f} rad RMS from place to "
        f"place (at most {limit:.2f}): part of the light comes by way of other surfaces"
    )
    return Finding(FaultCause.INTERREFLECTION, words, worst / limit)


def _stray_rad(sample: FrameSample, k: int, expected: Floats, deviation: Floats) -> float:
    """RMS that neighbours share, without what a phase alone explains as harmonics and gains do."""
    known = np.isfinite(deviation)
    orders = (0, 1, sample.recording.plan.fringes[k].images)
    waves = np.concatenate([[np.cos(m * expected[known]), np.sin(m * expected[known])] for m in orders])
    left = np.full(deviation.shape, np.nan)
    strengths = np.linalg.lstsq(waves.T, deviation[known], rcond=1e-6)[0]
    left[known] = deviation[known] - strengths @ waves
    rows, columns = (n // BLOCK * BLOCK for n in left.shape)
    blocks = left[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK)
    blocks = blocks.transpose(0, 2, 1, 3).reshape(-1, BLOCK * BLOCK)
    halves = blocks[:, ::2], blocks[:, 1::2]
    # Where light of two surfaces is mixed, many pixels are masked.
    whole = np.logical_and(*(np.isfinite(half).mean(axis=1) >= LEAST_KNOWN for half in halves))
    if whole.sum() < 2 * BLOCK:
        return 0.0
    # Noise is independent in the medians of two halves, and edges are few.
    halves = np.nanmedian(halves[0][whole], axis=1), np.nanmedian(halves[1][whole], axis=1)
    return math.sqrt(max(float(np.mean(halves[0] * halves[1])), 0.0))


def moire(sample: FrameSample) -> Finding | None:
    """Look for errors of the coordinate that repeat along the projector's pixels, but not with the fringes.

    A picture that is scaled before it is shown has places where it is off by up to half a pixel.
    """
    found = [one for axis in sample.coordinates if (one := moire_spectrum(sample, axis)) is not None]
    if not found:
        return None
    cycles, amplitudes = max(found, key=lambda one: float(one[1].max()))
    k = int(amplitudes.argmax())
    if amplitudes[k] <= MOST_MOIRE_PX:
        return None
    words = (
        f"the coordinate is off by {amplitudes[k]:.2f} px once in {1.0 / cycles[k]:.1f} projector px (at "
        f"most {MOST_MOIRE_PX:g} px): the picture is scaled before it is shown"
    )
    return Finding(FaultCause.WRONG_RESOLUTION, words, float(amplitudes[k]) / MOST_MOIRE_PX)


def moire_spectrum(sample: FrameSample, axis: Axis) -> tuple[Floats, Floats] | None:
    """Measure what of the coordinate's roughness repeats with a frequency along the projector's pixels."""
    # returns cycles (F,), amplitudes (F,)
    position, rough = _roughness(sample.coordinates[axis], _even(sample.recording.mean_image()), sample.step)
    if len(position) < LEAST_RIPPLED:
        return None
    span = float(np.ptp(np.percentile(position, (1, 99))))
    cycles = np.arange(MOIRE_CYCLES[0], MOIRE_CYCLES[1], 0.5 / max(span, 100.0))
    size = axis_length(sample.recording.projector_size, axis)
    sets = [one.stripes / size for one in sample.recording.plan.fringes if one.axis == axis]
    fine = [own for own in sets if own >= 0.02]
    for own in fine:
        cycles = cycles[np.abs(cycles / own - np.rint(cycles / own)) * own > OFF_CYCLES]
    if len(cycles) == 0:
        return None
    bins = np.rint(4.0 * (position - position.min())).astype(np.intp)
    count = np.bincount(bins)
    total = np.asarray(np.bincount(bins, rough), np.float64)
    places = np.arange(len(total)) / 4.0
    total = total - count * _of_fringes(places, total, count, _harmonics(sets, fine, span))
    sums = np.exp(-1j * TWO_PI * np.outer(cycles, places)) @ total
    return cycles, np.asarray(2.0 * np.abs(sums) / count.sum())


def _harmonics(sets: list[float], fine: list[float], span: float) -> list[float]:
    """Cycles per px of harmonics that are told from a moiré by a fit.

    All those of coarse fringes lie among its frequencies, too close together to be left out.
    """
    cycles = [m * own for own in fine for m in range(1, FRINGE_ORDERS + 1)]
    if not fine and (finest := max(sets)) * span >= FEWEST_FRINGES:
        cycles = [m * finest for m in range(1, int(MOIRE_CYCLES[1] / finest) + 1)]
    return [one for one in cycles if one < MOIRE_CYCLES[1]]


def _of_fringes(places: Floats, total: Floats, count: NDArray[np.intp], cycles: list[float]) -> Floats:
    """What harmonics of the fringes explain: of a short span they leak into other frequencies."""
    if not cycles:
        return np.zeros(len(places))
    angles = TWO_PI * np.outer(places, cycles)
    waves = np.concatenate([np.cos(angles), np.sin(angles), np.ones((len(places), 1))], axis=1)
    weights = np.sqrt(count)
    means = total / np.maximum(count, 1)
    best = np.linalg.lstsq(weights[:, None] * waves, weights * means, rcond=1e-6)[0]
    return np.asarray(waves @ best)


def _roughness(coordinate: Map, even: Mask, step: int) -> tuple[Floats, Floats]:
    """Coordinates of some pixels in a direction in which they change, and how far they are off a line there.

    A blurred edge shifts the coordinate, and so would a regular print; only pixels of an even scene are used.
    """
    right, down = (np.abs(np.diff(coordinate[::step, ::step], axis=k)) for k in (1, 0))
    steep = np.nanmedian(right) if np.isfinite(right).any() else 0.0
    turned = steep < (np.nanmedian(down) if np.isfinite(down).any() else 0.0)
    along, smooth = (coordinate.T, even.T) if turned else (coordinate, even)
    every = slice(None, None, max(1, along.size // MOIRE_POINTS))
    rows, smooth = along[every].astype(np.float64), smooth[every]
    half = SMOOTHED_PX // 2
    if rows.shape[1] <= 2 * SMOOTHED_PX:
        return np.empty(0), np.empty(0)
    sums = np.cumsum(np.pad(np.nan_to_num(rows), ((0, 0), (1, 0))), axis=1)
    known = np.cumsum(np.pad(np.isfinite(rows).astype(np.float64), ((0, 0), (1, 0))), axis=1)
    window = 2 * half + 1
    mean = (sums[:, window:] - sums[:, :-window]) / window
    whole = known[:, window:] - known[:, :-window] == window
    middle = rows[:, half : half + mean.shape[1]]
    rough = middle - mean
    whole &= (np.abs(rough) < 1.0) & smooth[:, half : half + mean.shape[1]]
    return middle[whole], rough[whole]


def _even(image: Image) -> Mask:
    """Which pixels have neighbours of nearly their own brightness."""
    level = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32)
    change = np.hypot(cv2.Sobel(level, -1, 1, 0, scale=0.125), cv2.Sobel(level, -1, 0, 1, scale=0.125))
    return np.asarray(change < EVEN_SHARE * level)
