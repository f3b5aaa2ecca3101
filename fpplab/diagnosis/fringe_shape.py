"""Phases of wide fringes compared with those that the coordinate gives, and what errors of the phase cost."""

import math
from collections.abc import Iterator

import numpy as np

from fpplab.core.config import Positive
from fpplab.core.conventions import TWO_PI, Floats, Mask, axis_length
from fpplab.core.remembered import remembered
from fpplab.diagnosis.finding import FaultCause, Finding
from fpplab.diagnosis.limits import CountLimit, LimitsSection
from fpplab.diagnosis.sample import FrameSample
from fpplab.phase.precision import phase_uncertainty


class FringeShapeLimits(LimitsSection):
    """From how many pixels an error that repeats with the phase is concluded, and from when on it matters."""

    min_pixels: CountLimit = 500
    """Pixels of known coordinate. Chosen: noise of a phase then averages to a twentieth."""
    max_unevenness: Positive = 0.3
    """How unevenly their phases may spread over a period: 0 evenly, 1 at one phase. Measured on benches."""
    min_harmonic_rad: Positive = 0.03
    """RMS phase error by harmonics in rad that is reported. Chosen."""


def phase_unevenness(phase: Floats, used: Mask) -> Floats:
    """Measure how unevenly phases are spread over a period."""
    # phase (..., P); used (..., P)
    turns = (np.where(used, np.exp(1j * m * phase), 0.0) for m in (1, 2, 3))
    return np.asarray(np.max([np.abs(turn.sum(axis=-1)) / used.sum(axis=-1) for turn in turns], axis=0))


@remembered
def phase_deviations(sample: FrameSample) -> list[tuple[int, Floats, Floats]]:
    """Compare the phases of wide sets with those that the coordinate gives, in which the finest set rules."""
    deviations = []
    recording, limits = sample.recording, sample.limits.of(FringeShapeLimits)
    for k, fringe in enumerate(recording.plan.fringes):
        finest = recording.plan.fringes[recording.plan.finest_set(fringe.axis)]
        coordinate = sample.coordinates.get(fringe.axis)
        if coordinate is None or fringe.stripes > 0.5 * finest.stripes:
            continue
        size = axis_length(recording.projector_size, fringe.axis)
        position = (coordinate[:: sample.step, :: sample.step].astype(np.float64) + 0.5) / size
        used = sample.measured & np.isfinite(position)
        if used.sum() < limits.min_pixels:
            continue
        expected = np.where(used, TWO_PI * fringe.stripes * position, np.nan)
        phasors = np.exp(1j * (sample.fits[k].phase - expected))
        deviations.append((k, expected, np.angle(phasors * np.conj(phasors[used].mean()))))
    return deviations


def phase_ripples(sample: FrameSample) -> Iterator[float]:
    """Measure the phase error, N times in a period, of wider sets of as many images N as the finest."""
    # Three images show no harmonics by themselves, and four no third one; the coordinate tells which phase
    # each wider set should have.
    plan, limits = sample.recording.plan, sample.limits.of(FringeShapeLimits)
    for k, expected, deviation in phase_deviations(sample):
        fringe = plan.fringes[k]
        if fringe.images != plan.fringes[plan.finest_set(fringe.axis)].images:
            continue
        finite = np.isfinite(deviation)
        wave = np.exp(1j * fringe.images * expected[finite])
        if np.abs(wave.mean()) < limits.max_unevenness:
            errors = deviation[finite]
            yield float(math.sqrt(2.0) * np.abs(np.mean((errors - errors.mean()) * wave)))


def harmonics_of_power_law_rad(sample: FrameSample) -> float:
    """RMS phase error in rad by the second harmonic of the finest set, as of a power law; 0 where unknown."""
    errors = sample.errors.sets[sample.recording.plan.finest_set()]
    return float(np.nan_to_num(errors.harmonic_rad))


def phase_error_finding(
    sample: FrameSample, cause: FaultCause, rad: float, min_rad: float, disturbance: str
) -> Finding | None:
    """Report an error of the phase that is above a limit and above the noise."""
    if not sample.measured.any() or not rad > min_rad:
        return None
    fit, steps = sample.widest, sample.recording.plan.fringes[sample.recording.plan.finest_set()].images
    offset = float(np.median(fit.offset[sample.measured]))
    modulation = float(np.median(fit.modulation[sample.measured]))
    noise = float(
        phase_uncertainty(math.sqrt(float(sample.errors.noise.variance(offset))), modulation, steps)
    )
    limit = max(min_rad, noise)
    if rad <= limit:
        return None
    noise_text = f"where noise does by {noise:.3f} (at most {limit:.3f})"
    text = f"{disturbance} shift the phase by {rad:.3f} rad RMS, {noise_text}"
    return Finding(cause, text, rad / limit)
