"""Light that does not come from the projector."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.config import Positive
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.limits import LimitsSection
from fpplab.diagnosis.pictures import draw_sample_map
from fpplab.diagnosis.visibility import GreyLevelLimits


class AmbientLimits(LimitsSection):
    """How much light may not change with the fringes."""

    max_ratio: Positive = 1.0
    """Other light relative to the fringes' modulation. Derived: photon noise is then 1.4 times as large."""
    min_level: Positive = 8.0
    """Grey levels of 255 below which what does not change may be the camera's own black level. Chosen."""


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample, limits = evidence.frames, evidence.limits.of(AmbientLimits)
    if not sample.measured.any():
        return
    fit = sample.widest
    other = float(np.median((fit.offset - fit.modulation)[sample.measured]))
    fringes = float(np.median(fit.modulation[sample.measured]))
    if other <= max(limits.max_ratio * fringes, limits.min_level):
        return
    text = (
        f"{other:.0f} grey levels of light do not change with the fringes, whose modulation is "
        f"{fringes:.0f}; noise is {math.sqrt(1.0 + other / fringes):.1f} times as large as without (at most "
        f"{math.sqrt(1.0 + limits.max_ratio):.1f})"
    )
    # Without it they reach twice their modulation, and may be exposed for longer.
    peak = 2.0 * float(np.percentile(fit.modulation[sample.measured], 98)) / 255.0
    factor = max(evidence.limits.of(GreyLevelLimits).best_peak_share / peak, 1.0)
    yield Finding(AMBIENT, text, other / fringes / limits.max_ratio, factor=factor)


def _draw(evidence: Evidence, _: Finding) -> Figure:
    from fpplab.core.robust import value_range

    sample, limit = evidence.frames, evidence.limits.of(AmbientLimits).max_ratio
    fit = sample.widest
    share = np.where(
        sample.measured, (fit.offset - fit.modulation) / np.maximum(fit.modulation, 1e-3), np.nan
    )
    upper = max(2.0 * limit, value_range(share, 0, 95)[1]) if sample.measured.any() else 1.0
    label = f"other light over modulation (limit {limit:g})"
    return draw_sample_map(share, sample, "magma", (0.0, upper), label)


AMBIENT = FaultCause(
    key="ambient",
    meaning="There is ambient light.",
    remedy="shade the scene, switch the room's lights off, or put a filter of the lamp's colour before the "
    "lens",
    measured="constant light relative to the modulation of the widest fringes",
    limit="equal: photon noise is then 1.4 times as large; and "
    f"{AmbientLimits().min_level:g} grey levels of 255",
    seen_in="frames",
    detectors=(Detector(DetectionStage.FRAMES, _find),),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"bands"}),
)
