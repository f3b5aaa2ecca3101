"""The fringes are no sinusoids."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fpplab.core.config import Positive
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding, Picture
from fpplab.diagnosis.fringe_shape import (
    FringeShapeLimits,
    harmonics_of_power_law_rad,
    phase_error_finding,
    phase_ripples,
)
from fpplab.diagnosis.limits import LimitsSection
from fpplab.diagnosis.pictures import draw_errors_by_phase
from fpplab.diagnosis.sample import FrameSample
from fpplab.phase.bent_phases import exponent_of_second_harmonic


class ResponseLimits(LimitsSection):
    """How far fringes may depart from sinusoids, and by what."""

    max_harmonics_share: Positive = 0.15
    """Harmonics as a share of the fringes. Chosen: those of an exponent of 1.53."""
    unexplained_harmonics_ratio: Positive = 2.0
    """Phase error by harmonics compared with what a power law explains, above which 'fpplab gamma' does not
    correct it. Measured on benches."""


def harmonics_share(sample: FrameSample) -> float:
    """Measure the greatest second and third harmonics of a set, as a share of the fringes."""
    shares = [float(np.nan_to_num(np.hypot(*e.harmonics[:2]))) for e in sample.errors.sets if e.images > 3]
    return max(shares, default=0.0)


def unexplained_harmonics_rad(sample: FrameSample) -> float | None:
    """Measure the phase error of harmonics where these are not those of a power law."""
    limits = sample.limits.of(ResponseLimits)
    plan, error = sample.recording.plan, max(phase_ripples(sample), default=0.0)
    # Three images do not separate a second harmonic, as of a power law, from others.
    if plan.fringes[plan.finest_set()].images <= 3:
        return None
    explained = limits.unexplained_harmonics_ratio * harmonics_of_power_law_rad(sample)
    return error if error > explained else None


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample, limits = evidence.frames, evidence.limits.of(ResponseLimits)
    share = harmonics_share(sample)
    if share > limits.max_harmonics_share:
        text = (
            f"harmonics of the response are {100 * share:.0f} % of the fringes (at most "
            f"{100 * limits.max_harmonics_share:g} %){_fitted_exponent(sample)}"
        )
        yield Finding(RESPONSE, text, share / limits.max_harmonics_share)
        return
    if unexplained_harmonics_rad(sample) is not None:
        return
    rad = max(harmonics_of_power_law_rad(sample), max(phase_ripples(sample), default=0.0))
    min_rad = evidence.limits.of(FringeShapeLimits).min_harmonic_rad
    finding = phase_error_finding(sample, RESPONSE, rad, min_rad, "harmonics of the response")
    if finding is not None:
        yield replace(finding, evidence=finding.evidence + _fitted_exponent(sample))


def _fitted_exponent(sample: FrameSample) -> str:
    """Say which power law fits the frames; nothing where a measured response is known instead."""
    shares = [errors.harmonics[0] for errors in sample.errors.sets if np.isfinite(errors.harmonics[0])]
    if sample.recording.response is not None or not shares:
        return ""
    exponent = exponent_of_second_harmonic(float(max(shares, key=abs)))
    return f"; the frames are those of a response with the exponent (gamma) {exponent:.2f}"


RESPONSE = FaultCause(
    key="response",
    meaning="The fringes are not sinusoidal: the response is not linear.",
    remedy="measure the response with 'fpplab gamma' and refer to it in the plan, or use more steps",
    measured="harmonics of the fringes; phase error they cause",
    limit=f"{100 * ResponseLimits().max_harmonics_share:g} %; "
    f"{FringeShapeLimits().min_harmonic_rad:g} rad, and the noise",
    seen_in="frames, coordinates",
    detectors=(Detector(DetectionStage.FRAMES, _find),),
    picture=Picture(Needs.FRAMES, draw_errors_by_phase),
    side_effects=frozenset({"wrong_resolution", "stale_calibration"}),
    # The third harmonic of wide fringes moves the mean of three images, as motion does.
    outweighs_from={"vibration": 0.5},
)
