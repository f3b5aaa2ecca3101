"""Bands of brightness move over the rows from frame to frame."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Positive
from fpplab.core.conventions import Floats
from fpplab.core.drawing import ERROR_COLOURS, HALF, colour_bar, single_axes
from fpplab.diagnosis.brightness import harmonic_waves
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.fringe_shape import FringeShapeLimits, phase_unevenness
from fpplab.diagnosis.limits import CountLimit, LimitsSection, ShareLimit
from fpplab.diagnosis.sample import FrameSample


class BandsLimits(LimitsSection):
    """How much the brightness of rows may scatter, and from how many rows that is concluded."""

    max_scatter: Positive = 0.01
    """RMS difference of the rows' brightness between frames. Measured on benches."""
    min_row_pixels: CountLimit = 20
    """Measured pixels of a row of the sample. Chosen."""
    min_rows: CountLimit = 40
    """Such rows. Chosen."""
    min_even_rows: ShareLimit = 0.9
    """Share of the rows over which the phases of a set are spread, so that harmonics do not look like bands.
    Measured on benches."""


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    gains, limit = row_gains(evidence.frames), evidence.limits.of(BandsLimits).max_scatter
    if gains is None:
        return
    # Noise is independent in neighbouring rows, bands are not.
    shared = float((gains[:, 1:] * gains[:, :-1]).mean())
    scatter = math.sqrt(max(shared, 0.0))
    if scatter > limit:
        text = (
            f"rows differ in brightness from frame to frame by {100 * scatter:.1f} % RMS "
            f"(at most {100 * limit:g} %)"
        )
        yield Finding(BANDS, text, scatter / limit)


def row_gains(sample: FrameSample) -> Floats | None:
    """Compute by how much the rows of frames are brighter than the fit of their fringe set says."""
    # Sets of more than three images show the gain of each frame; sets of three only that of their mean, which
    # is given as if of one frame.
    # returns (F, R)
    limits, used = sample.limits.of(BandsLimits), sample.measured
    rows = np.flatnonzero(used.sum(axis=1) >= limits.min_row_pixels)
    if len(rows) < limits.min_rows:
        return None
    gains: list[Floats] = []
    for sets in (_evenly_spread_sets(sample, rows), range(len(sample.fits))):
        gains = _from_frames(sample, rows, sets) or _between_sets(sample, rows, sets)
        if gains:
            break
    if not gains:
        return None
    stacked = np.stack(gains)
    return np.asarray(stacked - stacked.mean(axis=1, keepdims=True))


def _evenly_spread_sets(sample: FrameSample, rows: NDArray[np.intp]) -> list[int]:
    """Sets whose phases are spread evenly over most rows."""
    # Where a row has few phases, harmonics of the response change its brightness from frame to frame too.
    used, max_unevenness = sample.measured[rows], sample.limits.of(FringeShapeLimits).max_unevenness
    spread = [phase_unevenness(fit.phase[rows], used) < max_unevenness for fit in sample.fits]
    min_share = sample.limits.of(BandsLimits).min_even_rows
    return [k for k, even in enumerate(spread) if np.mean(even) >= min_share]


def _from_frames(sample: FrameSample, rows: NDArray[np.intp], sets: Sequence[int]) -> list[Floats]:
    plan, used = sample.recording.plan, sample.measured[rows]
    gains: list[Floats] = []
    for k in sets:
        fringe = plan.fringes[k]
        if fringe.images <= 3:
            continue
        fit = sample.fits[k]
        offset, phase = np.where(used, fit.offset[rows], 0.0), fit.phase[rows]
        power = np.square(offset).sum(axis=1)
        turn = np.exp(1j * phase) * np.exp(-1j * fringe.phase_shifts())[:, None, None]
        images = sample.spread[plan.set_starts[k] : plan.set_starts[k + 1], rows]
        residuals = images - fit.offset[rows] - fit.modulation[rows] * turn.real
        residuals -= _even_waves(residuals, fit.modulation[rows], turn, used)
        # The fit of a sinusoid takes three of the N gains of its frames.
        free = math.sqrt(fringe.images / (fringe.images - 3))
        gains += list((residuals * offset).sum(axis=2) / power * free)
    return gains


def _even_waves(
    residuals: Floats, modulation: Floats, turn: NDArray[np.complex128], used: NDArray[np.bool_]
) -> Floats:
    """What harmonics of the response leave besides the sinusoid, with one strength in all used pixels."""
    total, shown = np.zeros_like(residuals), np.where(used, modulation, 0.0)
    for wave in harmonic_waves(turn):
        shape = shown * wave
        total += float(np.vdot(residuals, shape)) / max(float(np.vdot(shape, shape)), 1e-12) * shape
    return total


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


def _draw(evidence: Evidence, _: Finding) -> Figure | None:
    gains = row_gains(evidence.frames)
    if gains is None:
        return None
    figure, axes = single_axes(HALF, 3.0)
    limit = max(float(np.percentile(np.abs(100 * gains), 99)), 1.0)
    shown = axes.imshow(100.0 * gains.T, aspect="auto", cmap=ERROR_COLOURS, vmin=-limit, vmax=limit)
    colour_bar(figure, axes, shown, "brightness relative to the fit, in %")
    axes.set(xlabel="frame", ylabel="lit row of the sample")
    return figure


BANDS = FaultCause(
    key="bands",
    meaning="Bands of brightness move over the rows from frame to frame.",
    remedy="use a camera with a global shutter or a global reset, or expose for whole periods of the lamp "
    "and of the projector's sequence",
    measured="scatter of the brightness of rows between frames, correlated between neighbouring rows",
    limit=f"{100 * BandsLimits().max_scatter:g} %",
    seen_in="frames",
    detectors=(Detector(DetectionStage.FRAMES, _find),),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"interreflection", "wrong_resolution"}),
    outweighs_from={"flicker": 0.25, "response": 0.5, "harmonics": 0.5},
)
