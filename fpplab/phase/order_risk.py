"""The probability, by noise alone, that the fringe order of a pixel is wrong."""

from collections.abc import Mapping
from contextlib import suppress

import numpy as np
from scipy.special import erfc

from fpplab.core.conventions import Axis, Floats, Map
from fpplab.core.errors import ConfigError
from fpplab.patterns.plan import Plan
from fpplab.phase.alternatives import alternatives_of
from fpplab.phase.coded_axes import axes_by_codes, axes_with_orders, coded_coordinate
from fpplab.phase.decoded import Decoded
from fpplab.phase.limits import CODES
from fpplab.phase.precision import coordinate_spread
from fpplab.phase.unwrapping import wavelength_sequence


def order_risk(
    decoded: Decoded,
    plan: Plan,
    projector_size: tuple[int, int],
    interval_shares: Mapping[Axis, float | None] | None = None,
) -> Map:
    """Estimate the probability that noise gives a pixel a wrong fringe order, from its uncertainty."""
    # projector_size (width, height) px; returns (height, width)
    risk = np.where(decoded.valid, np.float32(0.0), np.float32(np.nan))
    by_codes, with_orders = axes_by_codes(plan, projector_size), axes_with_orders(plan, projector_size)
    for axis in by_codes:  # of the usual pixel; those whose code is uncertain are not valid
        sigma = decoded.sigma if axis == plan.axes[0] else decoded.sigma * np.float32(decoded.v_per_u)
        small = CODES.noise_share
        usual = small * float(np.nanmedian(sigma)) / coded_coordinate(plan, axis, projector_size, small)[0]
        risk = np.maximum(risk, np.float32(coded_coordinate(plan, axis, projector_size, usual)[1]))
    fringes = plan.fringe_part
    for axis in plan.unwrapped_axes:
        if fringes is None or axis in by_codes or axis in with_orders:
            continue
        # Uncertainty of the first coded axis, and from it the noise of a grey level over its modulation.
        sigma = decoded.sigma if axis == plan.axes[0] else decoded.sigma * np.float32(decoded.v_per_u)
        noise = sigma / coordinate_spread(fringes, axis, projector_size)
        of_axis = wrong_order_chance(fringes, axis, noise, (interval_shares or {}).get(axis))
        risk = np.maximum(risk, of_axis.astype(np.float32))
    return risk


def axis_precision(
    plan: Plan, axis: Axis, size: tuple[int, int], noise: float, interval_share: float | None = None
) -> tuple[float, float | None]:
    """Uncertainty in px of a coordinate by noise, and the chance of a wrong order, where noise decides it."""
    # size (width, height) px; noise of a grey level, as a share of the modulation
    if axis in axes_by_codes(plan, size):
        return coded_coordinate(plan, axis, size, noise)
    fringes, chance = plan.fringe_part, None
    assert fringes is not None, "an axis is coded by fringes or by codes"
    if axis in plan.unwrapped_axes and axis not in axes_with_orders(plan, size):
        with suppress(ConfigError):  # orders that need a calibration, or another recording
            chance = float(wrong_order_chance(fringes, axis, np.asarray(noise), interval_share))
    return noise * coordinate_spread(fringes, axis, size), chance


def wrong_order_chance(plan: Plan, axis: Axis, noise: Floats, interval_share: float | None = None) -> Floats:
    """Compute the probability of a wrong order where noise is that share of the modulation."""
    # A shifted position whose phases are χ² = d² away, in units of their noise, is the likelier one with the
    # probability `erfc(d / √8) / 2`; the sum over all shifts, in both directions, bounds the risk from above.
    # Shifts that only pixels near the projector's edges can suffer are not counted.
    alternatives = alternatives_of(plan, wavelength_sequence(plan, axis, "plan", interval_share))
    counted = alternatives.separations[alternatives.separations >= 0.99 * alternatives.least_separation]
    chance = np.zeros(np.shape(noise))
    with np.errstate(divide="ignore"):
        for separation in counted:
            chance += erfc(np.sqrt(separation / 8.0) / noise)
    return np.asarray(np.minimum(chance, 1.0))
