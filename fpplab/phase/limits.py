"""Limits of decoding, each with where it comes from: derived, measured or chosen.

They are named tuples, because compiled functions read them.
"""

import math
from typing import NamedTuple


class OrderLimits(NamedTuple):
    """Limits of unwrapping, fusion and the choice of fringe orders."""

    edge_margin_px: float = 0.05
    """How near the projector's edge, in px and besides its noise, a coordinate may come before stripes that
    repeat there leave it open which of the two edges is meant. Chosen."""
    edge_sigmas: float = 1.5
    """How many standard deviations of its noise a coordinate may lie beyond the possible ones. Chosen."""
    min_chi2_difference: float = 9.0
    """Least difference of χ² by which two hypotheses of the base are distinguished. Chosen: 3 sigma."""
    min_cost_difference: float = 1e-5
    """Least difference of their costs, weighted sums of squared disagreements in periods. Derived: rounding
    to float32 stays below it."""
    agreeing_sigmas: float = 4.0
    """How many standard deviations of their difference a set may lie from the finest one to take part.
    Chosen: chance exceeds it at one pixel in 16,000."""
    rounding_turns: float = 3e-6  # standard deviation of a phase in turns that rounding to float32 leaves
    rest_rounding: float = 4e-6
    """The same of what a fringe leaves, in squares, as a share of the squares of its levels: they are summed
    over the images, and their differences multiplied by up to four."""
    max_separation_ratio: float = 9.0
    """Shifts beyond this multiple of the smallest χ² are left out. Derived: where they matter, the nearest
    one masks the pixel."""
    beyond_sigmas: float = 5.0
    """How many standard deviations beyond the possible positions a shifted one is still considered. Derived:
    less than 3e-7 of its distribution lies within them then."""
    cap_log_odds: float = 50.0
    """Logarithm of odds from which on they are no longer distinguished. Derived: the order is certainly
    wrong, and the exponential stays finite."""
    max_log_odds: float = 60.0
    """Logarithm of the odds against a shift beyond which it is not looked at. Derived: with
    `min_share_inside` it adds less than 1e-17."""
    min_share_inside: float = 1e-9
    """Least share of a position's own distribution that is taken to lie within the possible positions.
    Chosen: keeps the odds finite at the edge."""
    max_moves: int = 8
    """How many shifts in turn may lead from the order of unwrapping to the likeliest. Chosen: two are
    rare."""
    bounded_share: float = 0.15
    """Share of the variance by errors common to all pixels of a phase that counts for orders. Derived: those
    of the response and the lamp are waves, which end at 1.4 of their standard deviations, where noise reaches
    3.7 at one pixel in 10,000."""
    max_wave_turns: float = 0.5
    """Height of the response's waves in periods of the finer fringes up to which that holds. Derived: higher
    ones change orders."""


class OutsideLimits(NamedTuple):
    """Limits of the look for light from outside of the depth range."""

    sample_pixels: int = 1000
    """About how many pixels are looked at. Chosen: a share of 5 % is then known to 0.7 %."""
    min_pixels: int = 50  # fewer pixels with fringes say nothing (chosen)
    max_noise_turns: float = 0.05
    """Greatest noise of a phase, in turns, of a pixel that is taken to have fringes. Chosen."""
    beyond_sigmas: float = 5.0
    """How many standard deviations beyond the interval a position certainly lies outside. Chosen, as those of
    `OrderLimits`."""
    warning_share: float = 0.05  # share of the pixels with fringes from which on a warning is given (chosen)


class GuidedAxisLimits(NamedTuple):
    """Limits of the axis whose orders come from the geometry."""

    half_interval_turns: float = 0.499
    """Half of the interval about the prediction in which its coordinate is looked for. Derived: a whole
    period, but for rounding."""
    max_off_turns: float = 0.25
    """Greatest distance from the prediction at which an order counts. Derived: the next period is then three
    times as far."""
    max_off_share: float = 0.5
    """Greatest share of pixels beyond that distance at which the others count. Chosen: the most."""


GUIDED_AXIS = GuidedAxisLimits()


class PhaseNoiseLimits(NamedTuple):
    """Limits of the estimate of noise."""

    sample_rows: int = 32
    """Rows of the image that pixels are sampled from. Chosen: whole cache lines of a few rows."""
    sample_pixels: int = 16_000  # sampled pixels (chosen, as `max_values`)
    max_values: int = 32_000
    """Values, pixels times degrees of freedom, that noise is estimated from. Chosen: noise is then known to
    1 %."""
    min_pixels: int = 100  # fewest pixels that errors are estimated from (chosen)
    min_samples: int = 3
    """Fewest unsaturated samples of a fringe set. Derived: a sinusoid has three parameters."""
    max_saturation_loss: float = 9.0
    """Greatest variance of the phase from unsaturated samples, relative to that from all. Chosen: the samples
    lie too close together beyond it."""
    min_spread: float = 0.0025
    """Variance of a level before rounding, in steps squared, that is distinguished from none. Derived: 1/20
    of a step, so that some part of the variance is always left to chance."""
    max_bins: int = 24  # bins of levels that a line is fitted through (chosen)
    min_pixels_per_bin: int = 30
    """Chosen: the mean of a bin is then known to 18 % with two degrees of freedom in each pixel."""
    rejected_share: float = 0.001
    """Share of pixels without motion or edges that are rejected as outliers. Chosen."""
    surprising_share: float = 1e-5
    """Share of pixels whose residuals pass by chance for a variance of their own. Chosen."""
    rejection_passes: int = 6  # passes of the rejection of outliers (chosen)
    min_sampled_share: float = 0.7
    """Share of rounding's variance below which the levels of a bin do not change over a whole step.
    Chosen."""
    max_repeated_share: float = 1e-4
    """Share of the variance by rounding that repeats, from which on it is computed. Chosen."""
    min_levels: int = 16  # fewest levels whose gaps tell the step of raw values (chosen)
    min_even_share: float = 0.9  # share of the gaps that must be one step (chosen)


class ExposureMergeLimits(NamedTuple):
    """Limits of merging several exposures."""

    headroom: float = 16.0
    """Full scale of merged frames, in full scales of the camera. Chosen: the longest exposure may show a few
    samples of a pixel whose others are as much brighter; a step of 16 bits is then 1/16 of an 8-bit one."""
    min_slope: float = 0.05
    """Least weight of a sample's variance in that of the pixel. Chosen: codes have levels at both ends
    alone."""
    max_level: float = 0.9
    """Share of full scale from which on neighbouring pixels are left out of the fit. Chosen: noise does not
    saturate below it."""
    max_black_share: float = 0.01
    """Share of samples at level 0 from which on a mean of them is left out. Chosen: noise is cut off
    there."""
    bins: int = 48  # bins of levels through whose means the ratio of two exposures is fitted (chosen)
    max_in_bin: int = 4000  # samples of a bin that noise is estimated from (chosen: it is then known to 2 %)
    black_prior: float = 8.0  # expected standard deviation of the black level, in grey levels (chosen)
    ratio_prior: float = 0.03
    """Expected standard deviation of a ratio of exposures, relative to that of their times. Chosen."""
    max_ratio_error: float = 0.1
    """Greatest relative error of a ratio. Chosen: a camera's gamma of 1/1.2 exceeds it at a ratio of 2."""
    max_misfit: float = 0.03
    """Greatest RMS misfit of proportional levels, as a share of the highest. Chosen: lamps change by less."""
    fit_passes: int = 6  # passes of the least squares (chosen)


class CommonErrorLimits(NamedTuple):
    """Limits of the estimate of errors that all pixels of one phase share."""

    gain_prior: float = 0.01
    """Standard deviation of the lamp's gains from image to image that is expected. Chosen."""
    harmonic_prior: float = 0.1
    """Standard deviation of the response's harmonics as shares of the fringe that is expected. Derived: the
    second one of an exponent of 1.33."""
    offset_prior_grey: float = 10.0
    """Standard deviation of the offset of whole sets in grey levels that is expected. Chosen."""
    min_variance: float = 1e-3
    """Least variance of a grey level, in grey levels squared. Chosen: keeps noise-free frames solvable."""
    outlier_ratio: float = 9.0  # power beyond this multiple of the median is left out (chosen: 3 sigma)
    fit_passes: int = 2  # passes of the fit, the last without outliers (chosen)
    sample_pixels: int = 2000  # pixels that are fitted, for one set (chosen)
    min_third_harmonic: float = -0.0168
    """Least third harmonic as a share of the fringe. Derived: somewhat below -0.0161, the least of any
    exponent."""
    min_stripes: float = 4.0
    """Fewest stripes of a set whose offset is compared. Chosen: light from the rest of the scene changes as
    slowly as wider fringes do."""
    gain_significance: float = -math.log(0.001)
    """Power of gains relative to that of noise, which noise alone reaches once in a thousand times.
    Derived."""
    highest_harmonic: int = 64  # highest harmonic of a power law that is computed (chosen)


class BentPhaseLimits(NamedTuple):
    """Limits of the search for the exponent that makes phases of three images agree."""

    pixels: int = 500  # pixels that are compared, at least (chosen: the exponent is then known to 0.02)
    second_harmonics: tuple[float, float] = (-0.2, 0.45)
    """Second harmonics as shares of the fringe that are searched. Chosen: exponents 0.5 to 3.45."""
    min_trials: int = 4
    """Exponents that are tried, besides those of the next limit, before the best is refined. Chosen."""
    trials_per_ratio: float = 0.4
    """Exponents that are tried for each unit of the ratio of stripes. Derived: from one to the next, phases
    then change by less than a radian."""
    refinement: float = 0.2
    """Distance of the exponents that the best is refined by, as a share of that of those tried. Chosen."""
    end_turns: float = 0.05
    """Part of the widest period at each of its ends in which pixels are left out. Chosen."""
    max_contradiction: float = 0.5
    """Greatest variance of what a phase differs by from its prediction, in rad², from which anything is
    concluded. Chosen: where one says nothing of the other, it is 7 and more."""
    min_contradiction: float = 1e-6
    """The same that noise makes at least. Chosen: keeps noise-free frames solvable."""


class BiasedOrderLimits(NamedTuple):
    """Limits of the search for orders that a bias between the sets has changed."""

    searched_px: int = 32
    """Distance of the rows and columns that are looked at first for any jumps, in px. Chosen."""
    near_period: float = 0.1
    """How near to whole periods a jump is one of orders, in periods. Chosen: a fifth of the jumps at edges
    is by chance."""
    min_whole_share: float = 0.8
    """Share of the steps between two parts that must be so, by the same number of periods. Chosen."""
    max_jumping_share: float = 0.25  # jumps for each pixel from which on neighbours see no surface (chosen)
    small_part_px: int = 30  # pixels of a part up to which that is enough (chosen)
    min_change_turns: float = 0.03
    """Change of the sets' contradiction at the border of a greater part, in turns. Chosen: one bias in
    thirty is nearer to whole periods."""
    max_gap_turns: float = 0.03
    """Greatest gap of the fine phase, in turns, where the bias may be continuous. Chosen: surfaces bend."""
    max_gap_at_edge_turns: float = 0.01
    """The same where it must have an edge. Chosen: one jump in depth in fifty is as near to whole periods."""
    beyond_sigmas: float = 3.0  # standard deviations of its noise by which a gap may be greater (chosen)
    stretches: int = 4  # parts of a border in each of which the fine phase must go on (chosen)
    min_majority: float = 2.0 / 3.0
    """Share of the joined pixels that must have one order for it to be taken as right. Chosen."""
    max_noise_turns: float = 0.03
    """Greatest noise of the coordinate in periods at a pixel in doubt that is looked at. Chosen: a third of
    `near_period`."""


class NeighbourLimits(NamedTuple):
    """Limits of what neighbouring pixels show."""

    tile_px: int = 32  # side of a tile in px (chosen)
    min_share_of_finest: float = 0.5
    """Stripes of a set as a share of the finest along its axis from which on neighbours are compared. Chosen:
    wider fringes hardly change from pixel to pixel, and have little weight."""
    tiles_along: int = 4
    """Tiles along each side of the image. Chosen: strengths are then known to some percent."""
    min_pixels: int = 2000  # fewest pixels that strengths are estimated from (chosen)
    min_modulation: float = 2.0
    """Modulation in grey levels below which the phases of neighbours are not compared. Chosen."""
    max_bend_rad: float = 0.7
    """Spread of the second differences of a phase beyond which neighbours do not see one surface. Chosen."""
    fit_passes: int = 4  # passes of the fit, each without the outliers of the one before (chosen)
    outlier_sigmas: float = 8.0
    """Second differences beyond this multiple of their spread lie at edges of the part. Chosen."""
    significance: float = 6.0
    """Strength of an error in its standard deviations that noise does not make. Chosen: those of neighbours
    are correlated, so that the true ones are up to twice as great."""
    min_ripple_power: float = (2.0 - 2.0 * math.cos(1.0)) ** 2
    """Mean square of second differences of a ripple from which on it is distinguished from a surface. Chosen:
    that of one that changes by 1 rad from pixel to pixel."""
    max_correlation: float = 0.04
    """Correlation of neighbours' residuals of a sensor's own frames. Measured on simulated ones: 0.01."""
    unfiltered_px: int = 8
    """Distance of pixels that no filter makes alike. Chosen: the side of a block of JPEG."""
    max_reach: float = 0.5
    """Correlation at that distance, of that of neighbours, by a filter. Measured on JPEG and filters: 0.2 at
    most; on light that differs by phase and frame: 0.8."""
    max_growth: float = 2.25
    """Greatest growth of squared second differences from pixels 2 px apart to 3 px, of noise. Derived: noise
    does not grow, surfaces and waves grow by 81/16; this is between, in proportion."""
    max_scatter: float = 100.0
    """Greatest variance of phases beside that of residuals. Chosen: no filter of images makes as much."""


class LagLimits(NamedTuple):
    """Limits of the look for the frame before in each frame."""

    min_pixels: int = 500  # fewest pixels that the share is estimated from (chosen)
    min_share: float = 0.002
    """Least share that is stated. Chosen: it displaces four steps of 64 stripes by 0.005 px."""
    significance: float = 5.0  # the same in standard deviations (chosen)
    fit_passes: int = 4  # passes of the fit, each without the outliers of the one before (chosen)
    outlier_ratio: float = 7.0
    """Residuals beyond this multiple of their median are left out. Derived: 5 sigma."""


class DriftLimits(NamedTuple):
    """Limits of the look for a projector's picture that walks."""

    min_steps: int = 7
    """Fewest steps of a set that shows it by itself. Derived: fewer show two or three combinations of their
    phases, which vibration makes as alike as drift does."""
    min_stripes_share: float = 0.5  # fewest stripes of a set, as a share of the finest's (chosen)
    min_pixels: int = 500  # fewest pixels that it is estimated from (chosen)
    max_pixels: int = 4000  # most pixels that it is estimated from (chosen: noise then counts for nothing)
    max_chance: float = 1e-4  # probability of a drift as clear without one (chosen)
    fit_passes: int = 2  # passes of the fit, each without the outliers of the one before (chosen)
    outlier_ratio: float = 10.0  # power beyond this multiple of the median is left out (chosen)
    scatter_passes: int = 5  # passes in which the frames' own scatter is estimated (chosen)


class PartMotionLimits(NamedTuple):
    """Limits of the look for parts that move evenly during a scan."""

    tile_px: int = 16
    """Side of a tile in px. Chosen: noise of its frames' rests is known to some percent."""
    max_tiles: int = 600  # about as many are looked at, spread over the image (chosen)
    min_tiles: int = 4  # neighbouring tiles that are a part (chosen)
    max_fringes: float = 2.6
    """Greatest displacement in widths of the finest fringes that is looked for. Chosen: above two."""
    fringes_step: float = 0.04  # between displacements that are tried (chosen)
    min_fringes: float = 0.1
    """Least displacement in widths of the finest fringes that is told from vibration and drift. Chosen."""
    max_walk_px: float = 2.5
    """By how many px of the projector its picture may walk over a scan. Chosen: less from pose to pose."""
    whole_share: float = 0.9
    """Share of the lit tiles from which on nothing stands still that tells it from motion. Chosen."""
    min_power_ratio: float = 1.5
    """How many times more frames at rest must leave than followed ones. Chosen: chance makes 1.2 of it."""
    min_variance: float = 1e-3  # of a level, in grey levels squared; less is rounding (chosen)
    passes: int = 6  # at most, each with distances of the one before (chosen: later ones change little)
    median_px: int = 9
    """Side of the square whose median is its distance. Chosen: beyond waves by motion."""
    trial_pixels: int = 300  # pixels by which displacements to begin with are compared (chosen)
    trial_patches: int = 12  # whose depths are looked for at each of them (chosen)
    refined_patches: int = 60  # whose depths tell the best of the refined ones (chosen: fewer cannot)
    patch_px: int = 5  # side of a patch of one order, odd (chosen: noise of a pixel may not tell it)
    refined_trials: int = 3  # of them that are refined (chosen)
    fitted_pixels: int = 800  # pixels by which the displacement is fitted (chosen)
    axial_trials: int = 3  # displacements along the axis to begin with (chosen)
    trials_across: int = 9  # displacements across it, from -2 to 2 of the finest fringes (chosen)
    prior_mm: float = 100.0  # standard deviation of a displacement that is expected (chosen: frames decide)
    derivative_mm: float = 0.05  # step of numerical derivatives (chosen: some hundredths of a fringe)
    fit_passes: int = 15  # passes of least squares (chosen)
    fit_tolerance: float = 1e-3  # relative change at which they end (chosen: Newton's method goes on)
    newton_steps: int = 4  # of the minimum of what is left (chosen)
    max_step_mm: float = 0.2  # greatest of them (chosen: a part of a fringe)
    tolerance_mm: float = 0.003  # least of them (chosen: a thousandth of a fringe)
    blur_px: float = 0.8
    """Blur of the frames that displacements are fitted to. Chosen: interpolation then keeps noise."""
    gain_sigma: float = 0.01  # of the lamp's light in a set, as a share (chosen: more than a lamp flickers)
    outlier_sigmas: float = 3.0  # rests beyond which count less (chosen)
    outlier_ratio: float = 3.0  # power beyond this multiple of the median is no part's (chosen)
    chance_sigmas: float = 4.0  # by how much better a pixel must follow than stand still (chosen)
    window_px: int = 5  # side of the square whose rests tell whether it moves (chosen)
    max_step_share: float = (
        0.004  # of the distance, from pixel to pixel of a surface (chosen: 2 mm at 450 mm)
    )
    max_rest_ratio: float = 2.0
    """Greatest mean square of what followed pixels leave, beside that of noise. Chosen: the right one
    leaves 0.5 to 1.2 of it, wrong ones and vibration several times as much."""
    max_jitter: float = 0.3
    """Greatest scatter of the frames' phases about an even displacement, as a share of it. Chosen: vibration
    alone scatters by more than its own ramp."""
    margin_px: int = 64  # beyond tiles that move up to which pixels are looked at (chosen)
    block_pixels: int = 50_000  # pixels that are followed at a time (chosen: 100 MB)
    max_patches: int = 3_000  # whose depths are looked for (chosen: seconds also of large cameras)
    patches: int = 200  # whose depths are looked for at a time (chosen: 100 MB)
    candidates_per_period: int = 8
    """Depths that are tried within a period of the finest fringes. Chosen: the right one is within π/8."""
    refined_orders: int = 4  # of them that are refined and compared (chosen)
    place_steps: int = 3  # of its refinement (chosen: each leaves the square of the error before)
    rim_px: int = 2  # from the edge of a part, within which pixels are given up (chosen: as blur reaches)
    max_alone_ratio: float = 2.5
    """The same of one set from which on all sets tell the depth together. Chosen: orders then scatter."""
    max_noise_ratio: float = 10.0
    """Greatest increase of a coordinate's noise by uneven steps. Chosen: beyond it frames do not allow it."""
    min_followed_share: float = 0.5
    """Least share of what moves that must follow a displacement. Chosen: the rest may be places that the part
    passed by, but no more than the part itself covers."""
    min_points_share: float = 0.7
    """Least share of a compensated part's lit pixels that become points of one surface. Chosen: of a part at
    rest nearly all do, half or less where a wrong displacement or very uneven steps scatter the orders."""


class EdgeLimits(NamedTuple):
    """Limits of the correction at edges of reflectivity."""

    tile_px: int = 128  # side of a tile in px (chosen: an edge's tail ends in it)
    margin_px: int = 16  # px around a tile that its tail takes light from (chosen: four times its width)
    tiles_along: int = 8  # tiles along each side of the image (chosen)
    min_tiles: int = 4  # fewest tiles whose scatter tells an uncertainty (chosen)
    min_share: float = 0.5  # least share of a tile's pixels that are measured (chosen)
    min_contrast: float = 0.05  # spread of the modulation in a tile with an edge, as a share (chosen)
    degree: int = 3
    """Of the surface in a tile. Chosen: it follows parts that are smooth, and no edge."""
    fit_passes: int = 2  # passes of the fit, each without the outliers of the one before (chosen)
    outlier_sigmas: float = 5.0  # residuals beyond this multiple of their spread are left out (chosen)
    agreement_rounds: int = 10  # of a fit that disagreeing tiles do not pull (chosen: it has settled)
    min_agreeing: float = 0.6
    """Share of agreeing tiles above which others are left out. Chosen: fewer may agree on what is wrong."""
    clean_ratio: float = 1.5
    """What is left in a tile, beside its spread by the median, below which there are no outliers. Chosen."""
    tail_px: float = 4.0
    """Width of the tail. Measured on real boards of 4.7 to 6.6 px/mm: 4 px explain more than 2 and 8."""
    significance: float = 4.0  # strength in its standard deviations that chance does not make (chosen)
    max_strengths_px2: tuple[float, float] = (2.0, 6.0)
    """Core and tail of the widest blur that is believed. Chosen: a core of 1.4 px RMS, and a third of the
    light in the tail; real boards show at most 0.52 and 2.7."""
    unknown_px2: float = 0.5
    """Standard deviation of the core's strength where frames do not tell it. Measured: the greatest of the
    twin's and five real boards'."""
    felt_share: float = 0.1
    """Error beside a pixel's noise that counts. Chosen: a mean over 100 points shows it."""
    max_change_px: float = 1.0
    """Displacement from which on the first order does not hold, and is stated in place of corrected. Chosen:
    real boards need more at one edge pixel in a thousand."""
    model_share: float = 0.3
    """Standard deviation of what a correction leaves, as a share of it. Measured on real boards:
    0.08 to 0.37."""


class CodeLimits(NamedTuple):
    """Limits of the decoder of all kinds of codes."""

    candidate_angle: float = 0.2
    """Angle in rad between unit codes within which coordinates are one candidate. Chosen: a smaller one makes
    more candidates, a greater one more of them worth a visit; the result is the same."""
    certain_chi2: float = 40.0
    """χ² beyond which a worse coordinate is not looked for. Chosen: chance takes it for the best one twice in
    10^9, or as seldom as a plan demands."""
    min_contrast: float = 0.05
    """Length of a code without its mean below which it has no contrast, in the light's range. Chosen."""
    blurs_px: tuple[float, ...] = (0.0, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
    """Standard deviations of the blur that are tried on a sample of pixels. Chosen: a step of the square
    root of 2 changes what edges leave by less than noise."""
    sample_pixels: int = 2000  # pixels that tell blur and noise (chosen)
    looked_at_pixels: int = 100_000  # pixels that the sample is taken from (chosen: a fiftieth may see codes)
    hull_chi2: float = 25.0
    """χ² up to which a coordinate is possible. Chosen: 5 sigma, since neighbouring fringes count on it."""
    usual_width_share: float = 0.9
    """Share of the pixels whose interval is within a period, for unwrapping to begin with it. Chosen: at
    edges of cells noise leaves more."""
    margin_share: float = 0.25
    """By how much the interval of possible coordinates is widened, where there is room, as a share of the
    width within which the fringes repeat nowhere. Chosen: translucent parts blur edges by more than the rest
    of the scene."""
    guard: float = 0.01
    """How near the ends of an interval of a whole period a coordinate is not believed, as a share of the
    period. Chosen: what the response leaves of four steps."""
    guard_of_three: float = 0.05
    """The same of three steps. Measured on a real display: 4 % with a bent response."""
    noise_share: float = 0.05
    """Noise over modulation at which a plan must still tell its codes apart. Chosen: a dark part."""
    confusion_sigmas: float = 3.7
    """How many standard deviations of the noise the middle between two codes must be away. Chosen: noise
    exceeds it at one pixel in 10,000."""
    apart_px: float = 4.0
    """Distance of coordinates from which on their codes must differ. Chosen: beyond the widest usual
    blur."""
    usual_blur_px: float = 0.7  # blur with which a plan is judged before anything is taken (chosen)


class IslandLimits(NamedTuple):
    """Limits of the islands in which neighbours unwrap a phase."""

    tests: tuple[tuple[int, int], ...] = ((1, 1), (1, 9), (3, 9))
    """Links of a sum that must go on as the slopes beside it say, and pixels along an edge whose mean it is.
    Chosen: blur spreads a step over three pixels, and nine lessen noise to a third."""
    slope_px: int = 5  # side of the square whose links tell a slope, odd (chosen)
    sigmas: float = 5.0
    """How many standard deviations a phase may differ from what the slopes say. Chosen: noise exceeds it at
    one link in two million."""
    slope_share: float = 1.0
    """The same as a share of the difference of the slopes. Derived: half of it is a crease along the columns;
    a slanted one lies elsewhere in each row of the square, which up to doubles it."""
    max_slope_rad: float = 2.2
    """Slope beyond which a link is not sound, in rad per pixel. Chosen: noise of 0.2 rad reaches π from
    there at 5 sigma."""
    step_px: tuple[int, ...] = (12, 4)
    """Distance from any step at which islands begin. Chosen: a gap of 24 px in a step that changes by 0.006
    rad per pixel looks like none at a noise of 0.03 rad; the second one is for what is narrower."""
    window_reach: float = 2.0
    """The same in standard deviations of a window that made the phase, in addition. Chosen: a step spreads
    over two on either side."""
    corner_px: int = 2  # pixels at corners of an island that are given up (chosen: blur reaches as far)
    hole_px: int = 1  # distance from pixels that are not measured at which islands begin (chosen)
    min_pixels: int = 100  # pixels of an island (chosen: a smaller one is a scrap beside a step)
    min_border_px: int = 25  # sound links that join two islands (chosen: more than such a gap has)
    sound_share: float = 0.8  # share of the links of their border that must be sound (chosen)
    agreeing_share: float = 0.99  # share of the sound ones that must tell the same order (chosen)
    inside_share: float = 0.99
    """Share of an island's pixels that must lie within the possible coordinates. Chosen: edges of surfaces
    blur."""
    outside_share: float = 0.05
    """Share of an island's pixels beyond them by which an order is excluded. Chosen: five times what may lie
    there of the right one."""
    beyond_sigmas: float = 5.0  # how far beyond them noise may take a pixel (chosen)
    max_off_turns: float = 0.25
    """How far a known coordinate may be from the island's, in periods. Chosen, as that of
    `GuidedAxisLimits`."""


class OneFrameLimits(NamedTuple):
    """Limits of the fringes of one frame."""

    window_periods: float = 0.6
    """Standard deviation of the window in periods of the carrier. Chosen: a fringe that is wider or narrower
    by a third keeps four fifths of its modulation in the first fit."""
    window_reach: float = 4.0  # standard deviations at which the window ends (chosen)
    min_window_share: float = 0.99
    """Share of a window that must lie on usable pixels. Chosen: its middle is then off by 0.03 of its
    standard deviation."""
    max_rest_ratio: float = 1.5
    """Mean square of what a fit leaves, beside that of noise at its level, up to which a window holds one
    surface. Chosen: noise scatters by a tenth at most, a step of a twentieth of a period leaves more."""
    rest_freedom: int = 100
    """Degrees of freedom of that mean square. Chosen: the pixels of the narrowest window."""
    min_periods: float = 4.0  # periods across the image of the widest carrier (chosen)
    min_period_px: float = 3.0  # period of the finest carrier in px (chosen: two are no wave)
    min_peak_ratio: float = 100.0
    """Power of the carrier beside the median of waves of similar length. Chosen: noise reaches 20."""
    ridge: float = 1e-9
    """Added to the normal equations, whose greatest terms are 1. Chosen: keeps them solvable where no pixel
    is usable."""


class PlaneLimits(NamedTuple):
    """Limits of heights over a reference plane."""

    known_turns: float = 0.4
    """How far the fringes on a plate may lie from where the stated geometry puts them, in periods. Chosen: up
    to half a period its order is the nearest one."""


class FinePlanLimits(NamedTuple):
    """How a plan of fine fringes alone is chosen."""

    min_period_px: float = 4.0
    """Period of the finest fringes in projector px. Chosen: of 3 px, lens and mirrors leave a third."""
    blur_px: float = 0.6
    """Blur of fringes in focus, as a standard deviation in projector px. Measured: half a mirror of the lens,
    and the camera's share."""
    steps: tuple[int, int, int] = (4, 6, 26)
    """Images of the sets, fewest stripes first. Chosen: as many as the usual plans have; the finest measures,
    the others tell orders, and the first, which is bent most, has little weight."""
    beat_share: float = 0.8
    """What the depth range leaves possible, as a share of the period of the beat. Chosen: the rest is for
    noise and for light that bends phases."""
    max_beat_share: float = 0.125
    """Greatest beat as a share of the finest stripes. Chosen: the second set stays as fine as the first."""
    max_order_ratio: float = 40.0
    """Greatest ratio of the finest stripes to the beat. Derived: noise of 0.01 rad in both sets is then a
    tenth of a period."""
    error_power: float = 1.5
    """By which power of the period walls are bent. Derived: the share of a wall that is near the other one,
    within some periods, grows with the period, and its error in mm as well; the root of their mean square."""
    grid: int = 5  # rays of the camera along each side that are followed (chosen)
    margin_px: float = 0.5  # that decoding adds to each end of what is possible


class DisagreementLimits(NamedTuple):
    """When the disagreement of fine sets widens the uncertainty."""

    window_px: int = 9
    """Side of the square whose pixels' disagreement is averaged. Chosen: chance then changes the mean by 6 %
    with two degrees of freedom in each pixel."""
    min_ratio: float = 1.3
    """Least root mean square of the disagreement, in units of noise. Derived: five times that chance."""
    max_stripes_ratio: float = 4.0
    """Greatest ratio of the stripes of two sets. Chosen: what bends much wider fringes says little of the
    finest."""


ORDERS = OrderLimits()
OUTSIDE = OutsideLimits()
NOISE = PhaseNoiseLimits()
EXPOSURES = ExposureMergeLimits()
COMMON_ERRORS = CommonErrorLimits()
BENT_PHASES = BentPhaseLimits()
BIASED_ORDERS = BiasedOrderLimits()
LAG = LagLimits()
DRIFT = DriftLimits()
NEIGHBOURS = NeighbourLimits()
MOTION = PartMotionLimits()
EDGES = EdgeLimits()
CODES = CodeLimits()
ISLANDS = IslandLimits()
ONE_FRAME = OneFrameLimits()
PLANE = PlaneLimits()
FINE_PLAN = FinePlanLimits()
DISAGREEMENT = DisagreementLimits()
