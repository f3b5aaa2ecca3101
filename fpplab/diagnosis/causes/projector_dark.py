"""No fringes in the image."""

from collections.abc import Iterator, Sequence

from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.pictures import draw_sample_map
from fpplab.diagnosis.visibility import Visibility, VisibilityLimits


def darkness_excess(visibility: Visibility) -> float:
    """Compute how far the strongest modulation is below that of fringes."""
    return visibility.limits.min_fringe_sigmas / max(visibility.strength, 0.01)


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    visibility = evidence.visibility
    if visibility.is_dark and visibility.tiny_part_share is None:
        text = (
            f"the fringes' modulation is {evidence.frames.strongest:.2g} of 255 grey levels, "
            f"{visibility.strength:.1f} times its noise (at least {visibility.limits.min_fringe_sigmas:g})"
        )
        yield Finding(PROJECTOR_DARK, text, darkness_excess(visibility))


def _draw(evidence: Evidence, _: Finding) -> Figure:
    sample = evidence.frames
    limits = (0.0, max(sample.strongest, 1.0))
    return draw_sample_map(
        sample.widest.modulation, sample, "viridis", limits, "modulation in grey levels of 255"
    )


PROJECTOR_DARK = FaultCause(
    key="projector_dark",
    meaning="There are no fringes in the image.",
    remedy="switch on the lamp and its LEDs, and remove the lens cap; then run 'fpplab check'",
    measured="modulation of the widest fringes relative to its noise, and agreement of neighbouring pixels",
    limit=f"{VisibilityLimits().min_fringe_sigmas:g} times the noise, "
    f"{VisibilityLimits().min_modulation:g} grey levels",
    seen_in="frames",
    detectors=(Detector(DetectionStage.VISIBILITY, _find),),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"no_overlap"}),
    invalidates=frozenset({DetectionStage.COLOUR, DetectionStage.FRAMES, DetectionStage.BLUR}),
)
