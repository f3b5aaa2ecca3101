"""The likeliest fringe order of each pixel, and the probability that it is wrong: compiled functions.

A pixel's phases could also have come from a shifted position (`fpplab.phase.alternatives`). With Gaussian
noise the odds of the two are `exp(-(χ²_shifted - χ²)/2)`, and the probability that the chosen order is wrong
follows from the sum of the odds over all shifts, each weighted by the share of its distribution that lies
within the possible positions. Where a shifted position is likelier, it is taken. Nearly all pixels are far
from any doubt, which a bound shows without looking at a single shift.
"""

import math
from typing import Any

import numpy as np

from fpplab.phase.chunks import HIGH, LOW, compiled_part
from fpplab.phase.fusion import CHI2, DOUBT, FINEST, LEAST, POSITION, fuse_axis
from fpplab.phase.limits import ORDERS

TO_EXPLAIN = 0.5
"""Mark of a pixel whose step by step order is refused, between those of good pixels, 1, and bad ones, 0:
measured only if the likeliest order suits."""

UNEXPLAINED = 255  # cause of a pixel that is not measured because noise explains none of its orders

_f, _u = np.float32, np.uintp
_HALF, _ONE = _f(0.5), _f(1)


@compiled_part
def settle_orders(
    axis: int,
    recipe: Any,
    unwrapping: Any,
    fusion: Any,
    offsets: Any,
    weights: Any,
    shares: Any,
    good: Any,
    pixel_count: int,
    coordinate: Any,
    sigma: Any,
    common: Any,
    chi2: Any,
    cause: Any,
) -> None:
    """Choose the likeliest order along one axis, and mask the pixels where it is too uncertain."""
    # Unwrapping goes step by step, and so its order is not always the likeliest of all sets together. A pixel
    # whose steps disagree by more than the allowed share or lead out of the possible positions, or whose
    # order is changed here, is measured only if the likeliest position is a possible one and noise explains
    # χ².
    # unwrapping, fusion: working buffers; offsets from the finest set, weights, shares (S, n); good (n,);
    # coordinate, sigma, common, chi2 (n,); cause (n,)
    first, last = recipe.alternatives[axis], recipe.alternatives[axis + 1]
    if first == last or recipe.wrong_order_max > 1.0:
        return
    separation, edge_shift = recipe.least_separation[axis], recipe.edge_shift[axis]
    margin = recipe.order_margin[axis]
    min_log_odds = math.log(2.0 * (last - first) / recipe.wrong_order_max)
    # A pixel that the bound clears has a separation of at least twice `min_log_odds`: at most this noise.
    finest, freedom = recipe.finest[axis], np.sum(recipe.axis == axis) - 1
    unit = recipe.set_stripes[finest] * recipe.set_stripes[finest] / recipe.phase_noise[finest]
    reach = margin + ORDERS.beyond_sigmas * math.sqrt(separation / (2.0 * min_log_odds * unit))
    uncleared = _mark_and_count_uncleared(
        unwrapping, fusion, good, pixel_count, _f(separation), _f(edge_shift), _f(reach), _f(min_log_odds)
    )
    if uncleared == 0:
        return
    for i in range(pixel_count):
        if fusion[_u(i) + DOUBT] == 0.0:
            continue
        limits = (unwrapping[_u(i) + LOW] - margin, unwrapping[_u(i) + HIGH] + margin)
        odds, likeliest, sign, which = _compare_shifts(
            axis, recipe, unwrapping, fusion, offsets, weights, shares, i, limits
        )
        moves = 0
        while likeliest > 1.0 and moves < ORDERS.max_moves:
            _shift_order(axis, recipe, unwrapping, offsets, i, sign, which)
            odds, likeliest, sign, which = _compare_shifts(
                axis, recipe, unwrapping, fusion, offsets, weights, shares, i, limits
            )
            moves += 1
        if moves > 0:
            _fuse_pixel_again(
                axis, recipe, unwrapping, fusion, offsets, weights, shares, i, coordinate, sigma, common, chi2
            )
        if moves > 0 or good[i] < 1.0:
            is_explained = fusion[_u(i) + CHI2] <= ORDERS.agreeing_sigmas**2 * freedom
            outside = max(limits[0] - unwrapping[_u(i)], unwrapping[_u(i)] - limits[1])
            is_possible = outside <= ORDERS.edge_sigmas / math.sqrt(fusion[_u(i) + FINEST])
            good[i] = 1.0 if is_explained and is_possible else 0.0
            cause[i] = 0 if good[i] > 0.0 else UNEXPLAINED
        if good[i] > 0.0 and odds / (1.0 + odds) > recipe.wrong_order_max:
            good[i] = 0.0
            cause[i] = 1 + recipe.causes[which]


@compiled_part
def _compare_shifts(
    axis: int,
    recipe: Any,
    unwrapping: Any,
    fusion: Any,
    offsets: Any,
    weights: Any,
    shares: Any,
    pixel: int,
    limits: Any,
) -> tuple[float, float, float, int]:
    """Odds of all shifted positions of one pixel together; of the likeliest its own, its sign and index."""
    first, last = recipe.alternatives[axis], recipe.alternatives[axis + 1]
    position = unwrapping[_u(pixel)]
    beyond = ORDERS.beyond_sigmas / math.sqrt(fusion[_u(pixel) + FINEST])
    low, high = limits[0] - position, limits[1] - position
    best, mean, total = _chi2_of_shift(axis, recipe, offsets, weights, shares, pixel, 0.0, first)
    inside = max(_share_within(mean, total, low, high), ORDERS.min_share_inside)
    odds, likeliest, direction, which = 0.0, -1.0, 0.0, first
    for r in range(first, last):
        for sign in (-1.0, 1.0):
            if low - beyond <= sign * recipe.shifts[r] <= high + beyond:
                other, mean, total = _chi2_of_shift(axis, recipe, offsets, weights, shares, pixel, sign, r)
                if other - best > 2.0 * ORDERS.max_log_odds:
                    continue
                share = _share_within(mean, total, low, high)
                own = math.exp(min(0.5 * (best - other), ORDERS.cap_log_odds)) * share / inside
                odds += own
                if own > likeliest:
                    likeliest, direction, which = own, sign, r
    return odds, likeliest, direction, which


@compiled_part
def _shift_order(
    axis: int, recipe: Any, unwrapping: Any, offsets: Any, pixel: int, sign: float, shift_index: int
) -> None:
    unwrapping[_u(pixel)] += sign * recipe.shifts[shift_index]
    for s in range(len(recipe.axis)):
        if recipe.axis[s] == axis and s != recipe.finest[axis]:
            turn = offsets[s, pixel] * recipe.set_stripes[s] - sign * recipe.shift_turns[shift_index, s]
            offsets[s, pixel] = (turn - math.floor(turn + 0.5)) / recipe.set_stripes[s]


@compiled_part
def _fuse_pixel_again(
    axis: int,
    recipe: Any,
    unwrapping: Any,
    fusion: Any,
    offsets: Any,
    weights: Any,
    shares: Any,
    pixel: int,
    coordinate: Any,
    sigma: Any,
    common: Any,
    chi2: Any,
) -> None:
    """Repeat the fusion of one pixel, from its present position."""
    for s in range(len(recipe.axis)):
        if recipe.axis[s] == axis and s != recipe.finest[axis]:
            offsets[s, pixel] = (offsets[s, pixel] + unwrapping[_u(pixel)]) * recipe.set_stripes[s]
    chi2[pixel] -= fusion[_u(pixel) + CHI2]
    this = slice(pixel, pixel + 1)
    fuse_axis(
        axis,
        recipe,
        unwrapping[pixel:],
        fusion[pixel:],
        offsets[:, this],
        weights[:, this],
        shares[:, this],
        1,
        coordinate[this],
        sigma[this],
        common[this],
        chi2[this],
    )


@compiled_part
def _mark_and_count_uncleared(
    unwrapping: Any,
    fusion: Any,
    good: Any,
    pixel_count: int,
    min_separation: Any,
    edge_shift: Any,
    reach: Any,
    min_log_odds: Any,
) -> Any:
    """Mark the pixels that the bound does not clear, and count them; without a branch, as in the decoder."""
    # With the separation d² of the nearest shift, its odds are at most `exp(-d (d/2 - χ))`. Pixels whose step
    # by step order is refused are all marked.
    count = _f(0)
    for j in range(pixel_count):
        i = _u(j)
        square = fusion[i + LEAST] * min_separation
        surplus = _HALF * square - min_log_odds
        span = max(fusion[i + POSITION] - unwrapping[i + LOW], unwrapping[i + HIGH] - fusion[i + POSITION])
        doubt = _f(0) if surplus * abs(surplus) >= square * fusion[i + CHI2] else good[i]
        doubt = doubt if span + reach < edge_shift else good[i]
        doubt = doubt if good[i] == _ONE else good[i]
        fusion[i + DOUBT] = doubt
        count += doubt
    return count


@compiled_part
def _chi2_of_shift(
    axis: int, recipe: Any, offsets: Any, weights: Any, shares: Any, pixel: int, sign: float, shift_index: int
) -> tuple[float, float, float]:
    """χ² of one pixel's sets with the orders of a shifted position, their mean, and its inverse variance."""
    # The mean is counted from the position.
    shift = sign * recipe.shifts[shift_index]
    total, moment, square = 0.0, 0.0, 0.0
    for s in range(len(recipe.axis)):
        if recipe.axis[s] == axis:
            stripes = recipe.set_stripes[s]
            from_finest = 0.0 if s == recipe.finest[axis] else offsets[s, pixel] * stripes
            turn = from_finest - sign * recipe.shift_turns[shift_index, s]
            distance = (turn - math.floor(turn + 0.5)) / stripes
            noise = shares[s, pixel]
            weight = weights[s, pixel] / (noise + recipe.counted_share[axis] * (1.0 - noise))
            total += weight
            moment += weight * distance
            square += weight * distance * distance
    return square - moment * moment / total, shift + moment / total, total


@compiled_part
def _share_within(mean: float, total: float, low: float, high: float) -> float:
    """Share of a Gaussian distribution of inverse variance `total` that lies between two ends."""
    per_sigma = math.sqrt(0.5 * total)
    return 0.5 * (math.erfc((low - mean) * per_sigma) - math.erfc((high - mean) * per_sigma))
