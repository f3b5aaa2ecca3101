"""How well the sets of one axis agree on a position, in plain NumPy for few pixels.

The compiled decoder (`fpplab.phase.kernels`) does the same arithmetic in one pass over all pixels.
"""

import numpy as np

from fpplab.core.conventions import TWO_PI, Floats
from fpplab.phase.bounds import PositionInterval
from fpplab.phase.demodulation import AxisPhases
from fpplab.phase.limits import ORDERS
from fpplab.phase.unwrapping import WavelengthSequence


def contradiction(measured: AxisPhases, sequence: WavelengthSequence, interval: PositionInterval) -> Floats:
    """Compute by how much a wavelength contradicts coarser ones at most, in its periods and with sign."""
    turns = measured.phases / TWO_PI
    own = [np.tensordot(np.array(w.coefficients, float), turns, axes=1) % 1.0 for w in sequence.wavelengths]
    period = 1.0 / sequence.wavelengths[0].stripes
    low, high = (np.asarray(end, np.float64) for end in interval)
    middle = 0.5 * (low + high)
    near = (own[0] + np.floor(middle / period - own[0] + 0.5)) * period
    other = near + np.where(near > middle, -period, period)
    tolerance = ORDERS.edge_sigmas * measured.position_sigma[-1]
    (cost_near, off_near), (cost_other, off_other) = (
        _cost_and_deviation(position, own, sequence, (low, high), tolerance) for position in (near, other)
    )
    return np.where(cost_other < cost_near, off_other, off_near)


def _cost_and_deviation(
    position: Floats,
    own: list[Floats],
    sequence: WavelengthSequence,
    interval: tuple[Floats, Floats],
    tolerance: Floats,
) -> tuple[Floats, Floats]:
    """Take a position of the base to ever finer wavelengths: what that costs, and the greatest deviation."""
    cost, worst = np.zeros_like(position), np.zeros_like(position)
    for k, wavelength in enumerate(sequence.wavelengths[1:], start=1):
        expected = position * wavelength.stripes - own[k]
        order = np.floor(expected + 0.5)
        off = expected - order
        cost += sequence.trust[k] * off**2
        worst = np.where(np.abs(off) > np.abs(worst), off, worst)
        position = (order + own[k]) / wavelength.stripes
    outside = np.maximum(np.maximum(interval[0] - position, position - interval[1]), 0.0)
    return cost + np.where(outside > tolerance, 100.0 + outside, 0.0), worst  # above every cost inside


def chi2_of_sets(measured: AxisPhases, position: Floats) -> Floats:
    """Weighted squares of all K sets about their mean, at the orders nearest to a position of the finest."""
    stripes = measured.stripes.reshape(-1, *[1] * position.ndim)
    off = measured.phases / TWO_PI - position * stripes
    off = (off - np.floor(off + 0.5)) / stripes
    off[-1] = 0.0
    weight = 1.0 / measured.position_sigma**2
    mean = np.sum(weight * off, axis=0) / np.sum(weight, axis=0)
    return np.asarray(np.sum(weight * (off - mean) ** 2, axis=0))
