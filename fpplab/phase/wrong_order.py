"""The likeliest fringe order of each pixel, and the probability that it is wrong: compiled functions.

A pixel's phases could also have come from a shifted position (`fpplab.phase.alternatives`). With Gaussian
noise the odds of the two are `exp(-(χ²_shifted - χ²)/2)`, and the probability that the chosen order is wrong
follows from the sum of the odds over all shifts, each weighted by the share of its distribution that lies
within the possible positions. Where a shifted position is likelier, it is taken. Nearly all pixels are far
from any doubt, which a bound shows without looking at a single shift.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fpplab.phase.chunks import HIGH, LOW, compiled
from fpplab.phase.fusion import CHI2, DOUBT, FINEST, LEAST, POSITION, fuse_axis
from fpplab.phase.limits import ORDERS

TO_EXPLAIN = 0.5
"""Mark of a pixel whose step by step order is refused: measured only if the likeliest order suits."""

_f, _u = np.float32, np.uintp
_HALF, _ONE = _f(0.5), _f(1)


@compiled
def settle_orders(
    axis: int,
    recipe: Any,
    rows: Any,
    sums: Any,
    off: Any,
    weights: Any,
    shares: Any,
    good: Any,
    n: int,
    coordinate: Any,
    sigma: Any,
    common: Any,
    chi2: Any,
    cause: Any,
) -> None:
    """Choose the likeliest order along one axis, and mask the pixels where it is too uncertain.

    Unwrapping goes step by step, and so its order is not always the likeliest of all sets together. A pixel
    whose steps disagree by more than the allowed share or lead out of the possible positions, or whose order
    is changed here, is measured only if the likeliest position is a possible one and noise explains χ².
    """
    # off (S, n); weights, shares (S, n); good (n,); coordinate, sigma, common, chi2 (n,); cause (n,)
    first, last = recipe.alternatives[axis], recipe.alternatives[axis + 1]
    if first == last or recipe.wrong_order_max > 1.0:
        return
    separation, edge = recipe.least_separation[axis], recipe.edge_shift[axis]
    margin = recipe.order_margin[axis]
    enough = math.log(2.0 * (last - first) / recipe.wrong_order_max)
    # A pixel that the bound clears has at least the separation of twice `enough`, and so at most this noise.
    finest, freedom = recipe.finest[axis], np.sum(recipe.axis == axis) - 1
    unit = recipe.set_stripes[finest] * recipe.set_stripes[finest] / recipe.phase_noise[finest]
    reach = margin + ORDERS.beyond_sigmas * math.sqrt(separation / (2.0 * enough * unit))
    if _mark_uncleared(rows, sums, good, n, _f(separation), _f(edge), _f(reach), _f(enough)) == 0:
        return
    for i in range(n):
        if sums[_u(i) + DOUBT] == 0.0:
            continue
        ends = (rows[_u(i) + LOW] - margin, rows[_u(i) + HIGH] + margin)
        odds, likeliest, sign, which = _compare_shifts(axis, recipe, rows, sums, off, weights, i, ends)
        moves = 0
        while likeliest > 1.0 and moves < ORDERS.max_moves:
            _shift(axis, recipe, rows, off, i, sign, which)
            odds, likeliest, sign, which = _compare_shifts(axis, recipe, rows, sums, off, weights, i, ends)
            moves += 1
        if moves > 0:
            _fuse_again(axis, recipe, rows, sums, off, weights, shares, i, coordinate, sigma, common, chi2)
        if moves > 0 or good[i] < 1.0:
            is_explained = sums[_u(i) + CHI2] <= ORDERS.agreeing_sigmas**2 * freedom
            outside = max(ends[0] - rows[_u(i)], rows[_u(i)] - ends[1])
            is_possible = outside <= ORDERS.edge_sigmas / math.sqrt(sums[_u(i) + FINEST])
            good[i] = 1.0 if is_explained and is_possible else 0.0
        if good[i] > 0.0 and odds / (1.0 + odds) > recipe.wrong_order_max:
            good[i] = 0.0
            cause[i] = 1 + recipe.causes[which]


@compiled
def _compare_shifts(
    axis: int, recipe: Any, rows: Any, sums: Any, off: Any, weights: Any, i: int, ends: Any
) -> tuple[float, float, float, int]:
    """Odds of all shifted positions of one pixel together; of the likeliest its own, its sign and index."""
    first, last = recipe.alternatives[axis], recipe.alternatives[axis + 1]
    position = rows[_u(i)]
    beyond = ORDERS.beyond_sigmas / math.sqrt(sums[_u(i) + FINEST])
    low, high = ends[0] - position, ends[1] - position
    best, mean, total = _evidence(axis, recipe, off, weights, i, 0.0, first)
    inside = max(_share_within(mean, total, low, high), ORDERS.min_share_inside)
    odds, likeliest, direction, which = 0.0, -1.0, 0.0, first
    for r in range(first, last):
        for sign in (-1.0, 1.0):
            if low - beyond <= sign * recipe.shifts[r] <= high + beyond:
                other, mean, total = _evidence(axis, recipe, off, weights, i, sign, r)
                if other - best > 2.0 * ORDERS.max_log_odds:
                    continue
                share = _share_within(mean, total, low, high)
                own = math.exp(min(0.5 * (best - other), ORDERS.cap_log_odds)) * share / inside
                odds += own
                if own > likeliest:
                    likeliest, direction, which = own, sign, r
    return odds, likeliest, direction, which


@compiled
def _shift(axis: int, recipe: Any, rows: Any, off: Any, i: int, sign: float, r: int) -> None:
    """Change the order of one pixel by a shift."""
    rows[_u(i)] += sign * recipe.shifts[r]
    for s in range(len(recipe.axis)):
        if recipe.axis[s] == axis and s != recipe.finest[axis]:
            turn = off[s, i] * recipe.set_stripes[s] - sign * recipe.shift_turns[r, s]
            off[s, i] = (turn - math.floor(turn + 0.5)) / recipe.set_stripes[s]


@compiled
def _fuse_again(
    axis: int,
    recipe: Any,
    rows: Any,
    sums: Any,
    off: Any,
    weights: Any,
    shares: Any,
    i: int,
    coordinate: Any,
    sigma: Any,
    common: Any,
    chi2: Any,
) -> None:
    """Repeat the fusion of one pixel, from its present position."""
    for s in range(len(recipe.axis)):
        if recipe.axis[s] == axis and s != recipe.finest[axis]:
            off[s, i] = (off[s, i] + rows[_u(i)]) * recipe.set_stripes[s]
    chi2[i] -= sums[_u(i) + CHI2]
    pixel = slice(i, i + 1)
    fuse_axis(
        axis,
        recipe,
        rows[i:],
        sums[i:],
        off[:, pixel],
        weights[:, pixel],
        shares[:, pixel],
        1,
        coordinate[pixel],
        sigma[pixel],
        common[pixel],
        chi2[pixel],
    )


@compiled
def _mark_uncleared(
    rows: Any, sums: Any, good: Any, n: int, separation: Any, edge: Any, tolerance: Any, enough: Any
) -> Any:
    """Mark the pixels that the bound does not clear, and count them; without a branch, as in the decoder.

    With the separation d² of the nearest shift, its odds are at most `exp(-d (d/2 - χ))`. Pixels whose step
    by step order is refused are all marked.
    """
    count = _f(0)
    for j in range(n):
        i = _u(j)
        square = sums[i + LEAST] * separation
        surplus = _HALF * square - enough
        span = max(sums[i + POSITION] - rows[i + LOW], rows[i + HIGH] - sums[i + POSITION])
        doubt = _f(0) if surplus * abs(surplus) >= square * sums[i + CHI2] else good[i]
        doubt = doubt if span + tolerance < edge else good[i]
        doubt = doubt if good[i] == _ONE else good[i]
        sums[i + DOUBT] = doubt
        count += doubt
    return count


@compiled
def _evidence(
    axis: int, recipe: Any, off: Any, weights: Any, i: int, sign: float, r: int
) -> tuple[float, float, float]:
    """χ² of one pixel's sets with the orders of a shifted position, their mean, and its inverse variance.

    The mean is counted from the position.
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
    return square - moment * moment / total, shift + moment / total, total


@compiled
def _share_within(mean: float, total: float, low: float, high: float) -> float:
    """Share of a Gaussian distribution of inverse variance `total` that lies between two ends."""
    per_sigma = math.sqrt(0.5 * total)
    return 0.5 * (math.erfc((low - mean) * per_sigma) - math.erfc((high - mean) * per_sigma))
