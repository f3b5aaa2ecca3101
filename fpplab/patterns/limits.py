"""Limits of responses and patterns, each with where it comes from: derived, measured or chosen."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PatternLimits:
    """Limits of the measurement of a response, and of patterns that are corrected by it."""

    min_exponent: float = 0.5
    """Least exponent of a response that patterns are corrected with. Derived: 256 grey levels show its
    inverse with at most 0.007 rad of error in three steps."""
    max_exponent: float = 5.0  # greatest such exponent, as `min_exponent`
    max_phase_error_rad: float = 0.01
    """Greatest acceptable RMS phase error. Derived: about the noise of one pixel of twelve 8-bit frames,
    0.02 px of a projector of 912 columns at 64 stripes."""
    max_steps: int = 30  # greatest number of steps that are tried (chosen)
    coverage: float = 2.0
    """Coverage factor, in standard uncertainties: a fit is judged at its worse end, and a spline must predict
    better by as many standard errors. Chosen: about 95 %."""
    reported_steps: tuple[int, ...] = (3, 4, 5, 6, 8, 12)
    """Numbers of steps whose phase errors are always reported. Chosen."""
    min_levels: int = 5
    """Fewest levels that are fitted. Derived: three parameters, and two degrees of freedom to judge the fit
    by."""
    max_sigma_g: float = 0.05
    """Greatest relative uncertainty of g with which patterns are corrected. Chosen: the share of the error
    that may remain."""
    max_clipped_share: float = 1e-3
    """Share of pixels at full scale beyond which a mean level counts as saturated. Chosen."""
    min_rise: float = 0.05
    """Rise from black to white, as a share of full scale, below which a region is dark. Chosen."""
    max_spread_g: float = 0.05
    """Relative spread of the regions' g beyond which there is no common response. Derived: g of 1.05 instead
    of 1 changes the phase of three steps by 0.01 rad."""
    max_coefficients: int = 24  # most coefficients of a spline (chosen)
    min_reach: float = 0.98
    """Level shown that must have been seen, since a spline tells nothing beyond the last level. Chosen."""
    max_error_ratio: float = 0.7
    """The spline is chosen where its mean square error of prediction is less than this share of the power
    law's. Chosen."""

    @property
    def max_jump(self) -> float:
        """Greatest step of the light between 256 grey levels, as a share: the first of the least exponent."""
        return float((1 / 255) ** self.min_exponent)


PATTERN_LIMITS = PatternLimits()
