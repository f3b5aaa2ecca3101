"""Causes that are seen in the brightness of frames and of their rows: a colour that is missing, bands."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.diagnosis.catalogue import FaultCause, Finding
from fpplab.diagnosis.fringe_shape import MOST_UNEVEN, unevenness
from fpplab.diagnosis.sample import FrameSample

COLOURS = 3
"""Patterns of 8 bits that one image of 24 bits carries."""

LEAST_COLOUR = 0.9
"""Least brightness of the frames of one colour, as a share of the others'."""

CREST_PERCENTILE = 90
"""Share of the pixels, in %, that are darker than the crests of the fringes."""

FEWEST_STRIPES = 4.0
"""Stripes of a set from which on the mean of a frame does not depend on its phase."""

MANY_STRIPES = 16.0
"""Stripes of a set from which on it does not either where the camera sees a part of them."""

DISTINCT = 4.0
"""How many times the scatter of all frames' brightness a colour must be off."""

MOST_BANDS = 0.01
"""Scatter of the rows' brightness between frames that is told."""

FEWEST_IN_ROW, FEWEST_ROWS = 20, 40
"""Fewest measured pixels of a row, and fewest rows, from which bands are concluded."""

LEAST_ROWS = 0.9
"""Least share of the rows over which the phases of a set are spread, if it tells bands from harmonics."""

HARMONICS = (2, 3, 4)
"""Harmonics of the response that residuals of single frames are freed from, rising."""


def frame_levels(sample: FrameSample) -> Floats:
    """Compute the brightness of each frame at the crests of its fringes, where the scene is bright.

    The mean would depend on the phase, where the camera sees few stripes.
    """
    # returns (K,)
    brightest = sample.spread.max(axis=0)
    bright = brightest >= 0.5 * np.percentile(brightest, 95)
    return np.asarray(np.percentile(sample.spread[:, bright], CREST_PERCENTILE, axis=1))


def light_elsewhere(excess: float) -> Finding:
    """Give what else than a dark projector shows no light anywhere in the image."""
    words = "no light of the projector anywhere: it may be dark, or light another place; images do not tell"
    return Finding(FaultCause.NO_OVERLAP, words, excess)


def missing_colour(sample: FrameSample) -> Finding | None:
    """Look for a colour that is missing or weak: every third frame is darker than the others."""
    plan = sample.recording.plan
    starts = zip(pairwise(plan.set_starts), plan.fringes, strict=True)
    frames = [(one.stripes, k) for (a, b), one in starts for k in range(a, b)]
    fine, finest = ([k for stripes, k in frames if stripes >= n] for n in (FEWEST_STRIPES, MANY_STRIPES))
    # Of 8 stripes the camera may see 3, so that the mean of a frame still depends on their phase a little.
    fine = finest if len(finest) >= 3 * COLOURS else fine
    if len(fine) < COLOURS:
        return None
    levels = frame_levels(sample)
    # Fringes of one set may have more contrast than those of another; half the frames have all colours.
    for a, b in pairwise(plan.set_starts):
        levels[a:b] /= max(float(np.sort(levels[a:b])[(b - a) // 2 :].mean()), 1.0)
    return colour_finding(levels[fine], np.array(fine))


def colour_finding(levels: Floats, places: NDArray[np.intp]) -> Finding | None:
    """Tell whether every third of some frames is darker than the others."""
    # levels (K,); places (K,)
    own = [levels[places % COLOURS == c] for c in range(COLOURS)]
    if any(len(part) == 0 for part in own):
        return None
    worst = int(np.argmin([part.mean() for part in own]))
    others = np.concatenate([part for c, part in enumerate(own) if c != worst])
    share = float(own[worst].mean() / others.mean())
    scatter = math.hypot(float(others.std()), float(own[worst].std())) / float(others.mean())
    if share >= LEAST_COLOUR or own[worst].max() >= others.min() or 1.0 - share < DISTINCT * scatter:
        return None
    words = (
        f"frames {worst + 1}, {worst + 4}, {worst + 7} … have {100 * share:.0f} % of the others' brightness "
        f"(at least {100 * LEAST_COLOUR:g} %): one of three colours is weak or missing"
    )
    return Finding(FaultCause.MISSING_COLOUR, words, LEAST_COLOUR / max(share, 1e-3) * (1.0 - share) * 100.0)


def row_gains(sample: FrameSample) -> Floats | None:
    """Compute by how much the rows of frames are brighter than the fit of their fringe set says.

    Sets of more than three images show the gain of each frame; sets of three only that of their mean, which
    is given as if of one frame.
    """
    # returns (F, R)
    used = sample.measured
    rows = np.flatnonzero(used.sum(axis=1) >= FEWEST_IN_ROW)
    if len(rows) < FEWEST_ROWS:
        return None
    for sets in (_along_rows(sample, rows), range(len(sample.fits))):
        found = _from_frames(sample, rows, sets) or _between_sets(sample, rows, sets)
        if found:
            break
    if not found:
        return None
    gains = np.stack(found)
    return np.asarray(gains - gains.mean(axis=1, keepdims=True))


def _along_rows(sample: FrameSample, rows: NDArray[np.intp]) -> list[int]:
    """Sets whose phases are spread evenly over most rows.

    Where a row has few phases, harmonics of the response change its brightness from frame to frame too.
    """
    used = sample.measured[rows]
    spread = [unevenness(fit.phase[rows], used) < MOST_UNEVEN for fit in sample.fits]
    return [k for k, even in enumerate(spread) if np.mean(even) >= LEAST_ROWS]


def _from_frames(sample: FrameSample, rows: NDArray[np.intp], sets: Sequence[int]) -> list[Floats]:
    plan, used = sample.recording.plan, sample.measured[rows]
    found = []
    for k in sets:
        fringe = plan.fringes[k]
        if fringe.images <= 3:
            continue
        fit = sample.fits[k]
        offset, phase = np.where(used, fit.offset[rows], 0.0), fit.phase[rows]
        power = np.square(offset).sum(axis=1)
        angles = phase - fringe.phase_shifts()[:, None, None]
        images = sample.spread[plan.set_starts[k] : plan.set_starts[k + 1], rows]
        left = images - fit.offset[rows] - fit.modulation[rows] * np.cos(angles)
        left -= _even_waves(left, fit.modulation[rows], angles, used)
        found += list((left * offset).sum(axis=2) / power * math.sqrt(fringe.images / (fringe.images - 3)))
    return found


def _even_waves(left: Floats, modulation: Floats, angles: Floats, used: NDArray[np.bool_]) -> Floats:
    """What harmonics of the response leave beside the sinusoid, with one strength in all used pixels."""
    total, shown = np.zeros_like(left), np.where(used, modulation, 0.0)
    for wave in harmonic_waves(angles):
        shape = shown * wave
        total += float(np.vdot(left, shape)) / max(float(np.vdot(shape, shape)), 1e-12) * shape
    return total


def harmonic_waves(angles: Floats) -> Iterator[Floats]:
    """Give those harmonics of the phase that the fit of a sinusoid to N images leaves."""
    # angles (N, ...) rad; returns (N, ...)
    turn = np.exp(1j * angles)
    harmonic, reached = turn, 1
    for order in HARMONICS:
        if not 1 < order % len(angles) < len(angles) - 1:
            continue
        for _ in range(order - reached):
            harmonic = harmonic * turn
        reached = order
        yield harmonic.real
        yield harmonic.imag


def _between_sets(sample: FrameSample, rows: NDArray[np.intp], sets: Sequence[int]) -> list[Floats]:
    if len(sets) < 2:
        return []
    used = sample.measured[rows]
    offsets = np.stack([np.where(used, sample.fits[k].offset[rows], 0.0) for k in sets])
    mean = offsets.mean(axis=0)
    share = (offsets * mean).sum(axis=2) / np.square(mean).sum(axis=1) - 1.0
    count = len(offsets)
    images = np.array([sample.recording.plan.fringes[k].images for k in sets])
    return list(share * np.sqrt(images * count / (count - 1.0))[:, None])


def band_finding(sample: FrameSample) -> Finding | None:
    """Look for bands: rows whose brightness changes from frame to frame, as neighbouring rows' does."""
    gains = row_gains(sample)
    if gains is None:
        return None
    # Noise is independent in neighbouring rows, bands are not.
    shared = float((gains[:, 1:] * gains[:, :-1]).mean())
    scatter = math.sqrt(max(shared, 0.0))
    if scatter <= MOST_BANDS:
        return None
    words = (
        f"rows differ in brightness from frame to frame by {100 * scatter:.1f} % RMS "
        f"(at most {100 * MOST_BANDS:g} %)"
    )
    return Finding(FaultCause.BANDS, words, scatter / MOST_BANDS)
