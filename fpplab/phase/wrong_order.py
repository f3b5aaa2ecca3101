"""The probability of a wrong fringe order at each pixel: compiled functions on a chunk of pixels.

A pixel's phases could also have come from a shifted position (`fpplab.phase.alternatives`). With Gaussian
noise the odds of the two are `exp(-(χ²_shifted - χ²)/2)`, and the probability that the chosen order is wrong
follows from the sum of the odds over all shifts, each weighted by the share of its distribution that lies
within the possible positions. Nearly all pixels are far from any doubt, which a bound shows without looking
at a single shift.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fpplab.phase.chunks import HIGH, LOW, compiled
from fpplab.phase.fusion import CHI2, DOUBT, FINEST, LEAST, POSITION

FARTHEST_SIGMAS = 5.0
"""How many standard deviations beyond the possible positions a shifted one is still considered."""
LIKELIEST = 50.0
"""Logarithm of the odds beyond which they are not told apart: the order is certainly wrong."""

_f, _u = np.float32, np.uintp
_HALF = _f(0.5)


@compiled
def mask_wrong_orders(
    axis: int, recipe: Any, rows: Any, off: Any, weights: Any, sums: Any, good: Any, n: int, cause: Any
) -> None:
    """Mask the pixels whose order along one axis is wrong with more than the allowed probability.

    Parameters
    ----------
    axis : int
        0 or 1.
    recipe : Recipe
        With the shifts.
    rows : ndarray of float32
        Buffer of unwrapping, with the interval of possible positions.
    off : ndarray of float32, (S, n)
        Distance of every other set from the finest, as a share of the projector's length.
    weights : ndarray of float32, (S, n)
        Inverse variances of the sets' positions.
    sums : ndarray of float32
        Buffer of the finished fusion.
    good : ndarray of float32, (n,)
        Whether each pixel is measured, 0 or 1; set to 0 where it is masked.
    n : int
        Number of pixels.
    cause : ndarray of uint8, (n,)
        Set to 1 + the index of the fringe set whose noise leaves the order uncertain, where masked.
    """
    first, last = recipe.alternatives[axis], recipe.alternatives[axis + 1]
    if first == last or recipe.wrong_order_max >= 1.0:
        return
    least, edge = recipe.least_separation[axis], recipe.edge_shift[axis]
    margin = recipe.order_margin[axis]
    enough = math.log(2.0 * (last - first) / recipe.wrong_order_max)
    # A pixel that the bound clears has at least the separation of twice `enough`, and so at most this noise.
    finest = recipe.finest[axis]
    unit = recipe.set_stripes[finest] * recipe.set_stripes[finest] / recipe.phase_noise[finest]
    reach = margin + FARTHEST_SIGMAS * math.sqrt(least / (2.0 * enough * unit))
    if _mark_doubtful(rows, sums, good, n, _f(least), _f(edge), _f(reach), _f(enough)) == 0:
        return
    for i in range(n):
        if sums[_u(i) + DOUBT] == 0.0:
            continue
        position, low, high = sums[_u(i) + POSITION], rows[_u(i) + LOW], rows[_u(i) + HIGH]
        tolerance = margin + FARTHEST_SIGMAS / math.sqrt(sums[_u(i) + FINEST])
        ends = (low - margin - position, high + margin - position)
        best, inside = _evidence(axis, recipe, off, weights, i, 0.0, first, ends)
        odds, likeliest, which = 0.0, -1.0, 0
        for r in range(first, last):
            for sign in (-1.0, 1.0):
                moved = position + sign * recipe.shifts[r]
                if low - tolerance <= moved <= high + tolerance:
                    other, share = _evidence(axis, recipe, off, weights, i, sign, r, ends)
                    own = math.exp(min(0.5 * (best - other), LIKELIEST)) * share / max(inside, 1e-9)
                    odds += own
                    if own > likeliest:
                        likeliest, which = own, r
        if odds / (1.0 + odds) > recipe.wrong_order_max:
            good[i] = 0.0
            cause[i] = 1 + recipe.causes[which]


@compiled
def _mark_doubtful(
    rows: Any, sums: Any, good: Any, n: int, least: Any, edge: Any, tolerance: Any, enough: Any
) -> Any:
    """Mark the pixels that the bound does not clear, and count them; without a branch, as in the decoder.

    With the separation d² of the nearest shift, its odds are at most `exp(-d (d/2 - χ))`.
    """
    count = _f(0)
    for j in range(n):
        i = _u(j)
        square = sums[i + LEAST] * least
        surplus = _HALF * square - enough
        span = max(sums[i + POSITION] - rows[i + LOW], rows[i + HIGH] - sums[i + POSITION])
        doubt = _f(0) if surplus * abs(surplus) >= square * sums[i + CHI2] else good[i]
        doubt = doubt if span + tolerance < edge else good[i]
        sums[i + DOUBT] = doubt
        count += doubt
    return count


@compiled
def _evidence(
    axis: int, recipe: Any, off: Any, weights: Any, i: int, sign: float, r: int, ends: Any
) -> tuple[float, float]:
    """χ² of one pixel's sets with the orders of a shifted position, and how much of it is possible.

    That is the share of the mean's distribution that lies between the ends, counted from the position.
    """
    shift = sign * recipe.shifts[r]
    total, moment, square = 0.0, 0.0, 0.0
    for s in range(len(recipe.axis)):
        if recipe.axis[s] == axis:
            stripes = recipe.set_stripes[s]
            from_finest = 0.0 if s == recipe.finest[axis] else off[s, i] * stripes
            turn = from_finest - sign * recipe.shift_turns[r, s]
            distance = (turn - math.floor(turn + 0.5)) / stripes
            weight = weights[s, i]
            total += weight
            moment += weight * distance
            square += weight * distance * distance
    mean, per_sigma = shift + moment / total, math.sqrt(0.5 * total)
    share = 0.5 * (math.erfc((ends[0] - mean) * per_sigma) - math.erfc((ends[1] - mean) * per_sigma))
    return square - moment * moment / total, share
