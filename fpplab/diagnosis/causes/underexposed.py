"""The image is underexposed."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.drawing import ACCENT
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.pictures import curve_axes, draw_limit
from fpplab.diagnosis.visibility import GreyLevelLimits


def _find_weak_fringes(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    """Fringes that can hardly be distinguished from the dark."""
    visibility, sample = evidence.visibility, evidence.frames
    if visibility.is_dark or not visibility.is_weak or visibility.tiny_part_share is not None:
        return
    text = (
        f"the fringes' modulation is {sample.strongest:.2g} of 255 grey levels, {visibility.strength:.1f} "
        f"times its noise (at least {visibility.limits.min_clear_sigmas:g})"
    )
    best = evidence.limits.of(GreyLevelLimits).best_peak_share
    factor = best * 255.0 / max(2.0 * sample.strongest, 1.0)
    yield Finding(UNDEREXPOSED, text, visibility.limits.min_clear_sigmas / visibility.strength, factor=factor)


def _find_low_peaks(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample, limits = evidence.frames, evidence.limits.of(GreyLevelLimits)
    peak = float(np.percentile(sample.spread.max(axis=0)[sample.lit], 98)) / 255.0
    if peak >= limits.min_peak_share:
        return
    text = (
        f"the brightest parts reach {100 * peak:.1f} % of full scale (at least "
        f"{100 * limits.min_peak_share:g} %)"
    )
    # Without black level and the noise of single frames, which peaks contain.
    fringes = 2.0 * float(np.percentile(sample.widest.modulation[sample.lit], 98)) / 255.0
    factor = limits.best_peak_share / max(fringes, 1e-3)
    yield Finding(UNDEREXPOSED, text, limits.min_peak_share / max(peak, 1e-3), factor=factor)


def _draw(evidence: Evidence, _: Finding) -> Figure:
    sample = evidence.frames
    brightest = sample.spread.max(axis=0)
    shown = brightest[sample.lit] if sample.lit.any() else brightest.ravel()
    figure, axes = curve_axes()
    axes.hist(100.0 * shown / 255.0, bins=list(range(101)), color=ACCENT)
    limit = 100.0 * evidence.limits.of(GreyLevelLimits).min_peak_share
    draw_limit(axes, limit, "least that the brightest should reach")
    axes.set(xlabel="brightest grey level of a pixel, in % of full scale", ylabel="pixels", xlim=(0, 100))
    return figure


UNDEREXPOSED = FaultCause(
    key="underexposed",
    meaning="The image is underexposed.",
    remedy="increase exposure_s, open the camera's aperture, or brighten the lamp",
    measured="grey level of the brightest lit pixels",
    limit=f"{100 * GreyLevelLimits().min_peak_share:g} % of full scale",
    seen_in="frames",
    detectors=(
        Detector(DetectionStage.VISIBILITY, _find_weak_fringes),
        Detector(DetectionStage.FRAMES, _find_low_peaks),
    ),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"bands"}),
    invalidates=frozenset({DetectionStage.COLOUR, DetectionStage.FRAMES}),
)
