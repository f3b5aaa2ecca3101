"""The fringes are distorted in a way that no power law explains."""

from collections.abc import Iterator, Sequence

from fpplab.diagnosis.causes.response import ResponseLimits, harmonics_share, unexplained_harmonics_rad
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding, Picture
from fpplab.diagnosis.fringe_shape import FringeShapeLimits, harmonics_of_power_law_rad, phase_error_finding
from fpplab.diagnosis.pictures import draw_errors_by_phase


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample = evidence.frames
    if harmonics_share(sample) > evidence.limits.of(ResponseLimits).max_harmonics_share:
        return  # far from sinusoids, whatever bends them
    rad = unexplained_harmonics_rad(sample)
    if rad is None:
        return
    description = f"harmonics that no power law explains ({harmonics_of_power_law_rad(sample):.3f} rad)"
    min_rad = evidence.limits.of(FringeShapeLimits).min_harmonic_rad
    if (finding := phase_error_finding(sample, HARMONICS, rad, min_rad, description)) is not None:
        yield finding


HARMONICS = FaultCause(
    key="harmonics",
    meaning="The fringes are distorted in a way that no power law explains.",
    remedy="switch off image enhancement and tone curves of the projector, or use a plan with at "
    "least five steps; 'fpplab gamma' fits a power law, which does not correct this",
    measured="phase error with N cycles per period for sets of N > 3 images, relative to what a power "
    "law with the same second harmonic would cause",
    limit=f"{FringeShapeLimits().min_harmonic_rad:g} rad, the noise, and twice that",
    seen_in="coordinates",
    detectors=(Detector(DetectionStage.FRAMES, _find),),
    picture=Picture(Needs.FRAMES, draw_errors_by_phase),
    side_effects=frozenset({"wrong_resolution"}),
)
