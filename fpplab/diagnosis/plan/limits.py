"""Limits by which a plan is called wrong, and another one right."""

from __future__ import annotations

from typing import ClassVar

from fpplab.core.config import Positive
from fpplab.diagnosis.limits import CountLimit, LimitsSection, ShareLimit


class PlanCheckLimits(LimitsSection):
    """How much the sets of a plan may disagree, and how well another plan must fit."""

    section: ClassVar[str] = "plan_check"

    max_agreeing: Positive = 1.5
    """Median disagreement of the sets, in units of what noise explains, up to which nothing else is tried.
    Derived: of noise alone it is 1."""
    max_proposed: Positive = 15.0
    """Disagreement of a plan that is proposed. Measured: right ones reach it where the response is bent."""
    max_better_ratio: ShareLimit = 0.6
    """Disagreement of a plan that fits better, as a share of that of the plan given. Chosen."""
    lower_quantile: ShareLimit = 0.3
    """Quantile of the pixels at which it must fit better too. Derived: where masks leave about half of
    them, the median is no guide."""
    max_equal_ratio: Positive = 1.5
    """Factor on the least disagreement within which plans fit equally well, and the simplest is taken.
    Chosen."""
    max_equal_stripes: ShareLimit = 0.005
    """Relative difference of stripes up to which they are those of the plan. Chosen."""
    min_origin_rad: Positive = 0.3
    """Phase origin in rad that is reported. Chosen."""
    stripes_searched: ShareLimit = 0.04
    """Share of the stripes by which the search for better ones reaches to each side, at least one.
    Chosen."""
    min_whole_agreement: ShareLimit = 0.85
    """Agreement of whole stripes without a phase origin, as a share of the best, above which they are
    taken. Chosen."""
    max_turn_rad: Positive = 1.2
    """Typical change of phase in rad over the distance chosen. Derived: well below π it is unambiguous."""
    min_lit_share: ShareLimit = 0.2
    """Modulation of a pixel that sees the fringes of a set, as a share of the strongest. Chosen."""
    min_lit_level: Positive = 1.0
    """The same in 8-bit grey levels. Derived: rounding."""
    min_lit_pixels: CountLimit = 200
    """Lit pixels from which anything is concluded. Chosen."""
    min_coherence: ShareLimit = 0.5
    """Mean of exp(i times the second difference of a set's phase) from pixel to pixel. Derived: it is near
    1 for fringes, 0 for noise, and 0.5 where noise is 0.5 rad."""
