"""The projector lights hardly anything that the camera sees."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.drawing import ALARM, colour_bar, draw_map, map_axes
from fpplab.diagnosis.causes.projector_dark import darkness_excess
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.pictures import sample_extent
from fpplab.diagnosis.visibility import VisibilityLimits


def light_elsewhere(excess: float) -> Finding:
    """Say what else than a dark projector shows no light anywhere in the image."""
    text = (
        "no light of the projector anywhere: it may be dark or point elsewhere; images cannot "
        "distinguish these"
    )
    return Finding(NO_OVERLAP, text, excess)


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    visibility = evidence.visibility
    limit, share = visibility.limits.min_lit_share, visibility.lit_share
    if visibility.tiny_part_share is not None:
        advice = (
            "check whether the part has the right size (meshes are in mm), is near enough, and is in "
            "view of both camera and projector"
        )
        yield Finding(
            NO_OVERLAP,
            _evidence(visibility.tiny_part_share, limit),
            limit / visibility.tiny_part_share,
            advice,
        )
    elif visibility.is_dark:
        yield light_elsewhere(darkness_excess(visibility))
    elif not visibility.is_weak and share < limit:
        yield Finding(NO_OVERLAP, _evidence(share, limit), limit / max(share, 1e-4))


def _evidence(share: float, limit: float) -> str:
    return f"the fringes light {100 * share:.2g} % of the image (at least {100 * limit:g} %)"


def _draw(evidence: Evidence, _: Finding) -> Figure:
    sample = evidence.frames
    figure, axes = map_axes(sample.lit.shape)
    mean = sample.spread.mean(axis=0)
    levels = (0.0, max(float(np.percentile(mean, 99.8)), 1.0))
    shown = draw_map(axes, mean, "gray", levels, sample_extent(sample))
    colour_bar(figure, axes, shown, "mean grey level of 255")
    height, width = sample.lit.shape
    places = [np.arange(n) * sample.step for n in (width, height)]
    if sample.lit.any() and not sample.lit.all():
        axes.contour(*places, sample.lit, levels=[0.5], colors=[ALARM], linewidths=1.2)
    limit = evidence.limits.of(VisibilityLimits).min_lit_share
    axes.set_title(f"{100 * sample.lit.mean():.2g} % see fringes (at least {100 * limit:g} %)")
    return figure


NO_OVERLAP = FaultCause(
    key="no_overlap",
    meaning="The projector lights hardly anything that the camera sees.",
    remedy="point camera and projector at the same place, at the distance of the part",
    measured="fraction of the image with fringes; ranked after `projector_dark` if there are none",
    limit=f"{100 * VisibilityLimits().min_lit_share:g} %",
    seen_in="frames",
    detectors=(Detector(DetectionStage.VISIBILITY, _find),),
    picture=Picture(Needs.FRAMES, _draw),
    invalidates=frozenset({DetectionStage.COLOUR, DetectionStage.FRAMES, DetectionStage.BLUR}),
)
