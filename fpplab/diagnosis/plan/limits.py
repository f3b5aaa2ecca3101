"""Limits by which a plan is called wrong, another one right, or one is guessed."""

from dataclasses import dataclass

from fpplab.core.config import Positive
from fpplab.diagnosis.limits import CountLimit, LimitsSection, ShareLimit


class PlanCheckLimits(LimitsSection):
    """How much the sets of a plan may disagree, and how well another plan must fit."""

    max_agreeing: Positive = 1.5
    """Median disagreement of the sets, in units of what noise explains, up to which nothing else is tried.
    Derived: of noise alone it is 1."""
    max_proposed: Positive = 5.0
    """Disagreement of a plan that is proposed. Chosen: right ones, once straightened, stay below 3."""
    min_bend: Positive = 0.08
    """Difference of an exponent from 1 that is straightened. Chosen: three steps are shifted by 0.02 rad."""
    max_scale_difference: Positive = 0.15
    """Relative difference of a set's change of phase from its stripes. Chosen: of right ones it is 1 %."""
    max_better_ratio: ShareLimit = 0.6
    """Disagreement of a plan that fits better, as a share of that of the plan given. Chosen, and judged on
    simulated scenes: each of 15 mistakes is named, and 60 right plans and six captures are left alone."""
    lower_quantile: ShareLimit = 0.3
    """Quantile of the pixels at which it must fit better too. Derived: masks may leave about half of them."""
    max_equal_ratio: Positive = 1.5
    """Factor on the least disagreement within which plans fit equally, and the simplest wins. Chosen."""
    max_equal_stripes: ShareLimit = 0.005
    """Relative difference of stripes up to which they are those of the plan. Chosen."""
    max_stripes: CountLimit = 4096
    """Stripes that are tried, at most. Derived: no projector shows more."""
    min_origin_rad: Positive = 0.3
    """Phase origin in rad that is reported. Chosen."""
    stripes_searched: ShareLimit = 0.04
    """Share of the stripes by which the search reaches to each side, at least one. Chosen."""
    min_whole_agreement: ShareLimit = 0.85
    """Agreement of whole stripes without an origin, as a share of the best, above which they win. Chosen."""
    max_turn_rad: Positive = 1.2
    """Typical change of phase in rad over the distance chosen. Derived: well below π it is unambiguous."""
    pixels: CountLimit = 12_000
    """Pixels that are looked at, about. Chosen."""
    min_lit_share: ShareLimit = 0.2
    """Modulation of a pixel that sees the fringes of a set, as a share of the strongest. Chosen."""
    min_lit_level: Positive = 1.0
    """The same in 8-bit grey levels. Derived: rounding."""
    min_lit_pixels: CountLimit = 200
    """Lit pixels from which anything is concluded. Chosen."""
    min_coherence: ShareLimit = 0.5
    """Mean of exp(i times the second difference of a set's phase) from pixel to pixel. Derived: it is near
    1 for fringes, 0 for noise, and 0.5 where noise is 0.5 rad."""
    min_possible_share: ShareLimit = 0.5
    """Share of the lit pixels whose points lie before both devices, and in the range of depths where one is
    stated, of an explanation that is possible. Chosen."""
    min_alignment: ShareLimit = 0.5
    """Cosine of the angle between the directions in which a coordinate changes along the image and should, of
    an explanation that is possible. Chosen: slopes of a surface turn it, and images turned by 90° give 0."""
    max_epipolar_px: Positive = 1.0
    """Systematic distance from the epipolar lines in projector px of an explanation that is possible. Chosen:
    a calibration of the rig leaves less than a third of it, images that are turned tens of px."""
    max_equal_epipolar_px: Positive = 0.3
    """The same, up to which explanations count as equally good. Derived: that of a stale calibration."""


@dataclass(frozen=True)
class GuessLimits:
    """Limits by which images are taken for fringe sets, and stripes for whole numbers."""

    pixels: int = 4_000  # pixels that decide what images are, about (chosen)
    code_pixels: int = 200_000  # pixels that a guessed code is tried on, about (chosen)
    min_binary_images: int = 3  # from which on images may be of a code (chosen)
    min_decoded_share: float = 0.5  # of the lit pixels, which a guessed code explains (chosen)
    usual_misfit: float = 0.04  # misfit of a sinusoid, as a share of its modulation (chosen)
    min_squares_per_set: float = 12.0
    """Squares of the usual misfit by which another set must reduce the misfit. Chosen."""
    max_misfit: float = 0.2
    """RMS misfit, as a share of the modulation, up to which images are sets of sinusoids. Chosen."""
    max_stripes: int = 400  # stripes of a coarsest set that is tried (chosen)
    max_whole_difference: float = 0.004  # relative difference from whole numbers of stripes (chosen)
    max_visible_periods: float = 1.2
    """Periods seen of a coarsest set of one stripe, at most. Derived: gradients are known to a tenth."""
    near: float = 0.2
    """Distance from a pixel's least or greatest level, as a share of its range, that counts as it. Chosen."""
    min_binary_share: float = 0.85
    """Share of the pixels that are dark or bright in an image of two levels. Chosen: a sinusoid has 59 %."""
    min_each_share: float = 0.1
    """Share of the pixels that are dark, and bright, in an image of two levels, unless its neighbour is one.
    Derived: of a sinusoid that has both a quarter lies between."""
    min_uniform_share: float = 0.97
    """Share of the pixels that are bright in a white image, or dark in a black one. Chosen."""
    min_lit_share: float = 0.3
    """Range of a pixel that sees the projector, as a share of that of bright ones. Chosen: what the scene
    scatters onto places that the projector does not reach stays below a tenth."""
    min_range: float = 0.05
    """Range of a pixel, as a share of full scale, from which it carries information. Chosen."""
    max_rank_misfit: float = 0.1
    """What two waves may leave of sinusoids of any steps, as a share of their mean square. Chosen."""
    max_free_misfit: float = 0.02
    """What two waves may leave of a set of unequal steps. Chosen: a part that moves leaves more."""
    min_equal_misfit: float = 0.05  # what equal steps leave of unequal ones, as a share of all (chosen)
    min_misfit_ratio: float = 3.0  # the same, as a multiple of what free steps leave (chosen)
    max_step_error_deg: float = 15.0
    """Greatest error of steps that are taken for equal ones in another order. Chosen."""
    min_gain: float = 0.3
    """Least gain of a frame, as a share of the mean, with changing brightness. Chosen: black needs none."""
    max_unexplained: float = 0.01
    """What gains and offsets may leave of sinusoids' variance. Chosen: Gray code leaves almost half."""
    min_explained_ratio: float = 4.0
    """Factor by which gains and offsets must reduce what is left. Chosen: without changes it is 1."""
    min_gain_change: float = 0.01
    """Standard deviation of gains that is told. Measured: it is 0.002 where nothing changes."""


GUESS_LIMITS = GuessLimits()
