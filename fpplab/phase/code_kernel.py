"""Compiled search of the likeliest code at every pixel; codes are those of a `CodeTable`.

With A and B fitted, the sum of squares that a code c leaves of a pixel's levels x is
`|x|² - (x·c)²` for codes of unit length, both without their means: the likeliest code is the one with the
greatest correlation x·c. Offset and modulation cost two of the K images.

Best code and runner-up are those of the whole grid, though most of it is not visited: angles between unit
vectors obey the triangle inequality. A code lies within a known angle of its candidate's, so that the
candidate's correlation bounds its own; and codes outside of the range about a code lie at least a known angle
from it, so that none of them needs a visit where it fits well. The range of the pixel before is tried first.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fpplab.phase.chunks import compiled_lean

LANES = 32  # numbers that are worked on at a time (chosen: four vectors)
_BESIDE = 4  # candidates beside a range that are searched with it (chosen: the next pixel's best is near)
_ROUNDING = 2e-6  # of a correlation in float32, as a share of the levels' length (chosen)


class SearchLimits(NamedTuple):
    """Noise of the levels, and how far it may lead."""

    constant: float  # variance at level 0
    per_level: float  # increase of the variance per level
    hull_chi2: float  # χ² up to which a coordinate is possible
    certain_chi2: float  # χ² beyond which a runner-up is not looked for
    surprising: float  # mean square that residuals hardly ever exceed by chance, in units of the variance
    min_range: float  # least range of a pixel's levels


@compiled_lean
def _whole(first: int, last: int) -> int:
    """End of a range of whole vectors."""
    return first + (last - first + LANES - 1) // LANES * LANES


@intrinsic
def _correlate_block(_typing: Any, x: Any, codes: Any, scores: Any, images: Any, row: Any) -> Any:
    """Correlate with `LANES` codes; addresses of levels, first code and first score, length of rows."""

    # Written as vectors, because the compiler makes none of ranges that are short.
    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        number, vector = ir.FloatType(), ir.VectorType(ir.FloatType(), LANES)
        levels, first = (builder.inttoptr(each, number.as_pointer()) for each in arguments[:2])
        into = builder.inttoptr(arguments[2], vector.as_pointer())
        total = cgutils.alloca_once_value(builder, ir.Constant(vector, None))  # type: ignore[no-untyped-call]
        nowhere, zeros = ir.Constant(vector, ir.Undefined), ir.VectorType(ir.IntType(32), LANES)
        with cgutils.for_range(builder, arguments[3]) as image:
            level = builder.load(builder.gep(levels, [image.index]))
            level = builder.insert_element(nowhere, level, ir.Constant(ir.IntType(32), 0))
            level = builder.shuffle_vector(level, nowhere, ir.Constant(zeros, None))
            at = builder.gep(first, [builder.mul(image.index, arguments[4])])
            code = builder.load(builder.bitcast(at, vector.as_pointer()), align=4)
            product = builder.fmul(level, code, flags=("contract",))
            builder.store(builder.fadd(builder.load(total), product, flags=("contract",)), total)
        builder.store(builder.load(total), into, align=4)
        return context.get_dummy_value()

    address, integer = types.uintp, types.intp
    return types.void(address, address, address, integer, integer), generate


@compiled_lean
def _correlate(x: Any, codes: Any, first: int, last: int, scores: Any) -> None:
    """Correlate the levels of one pixel with a range of codes; 0 up to the end of the last vector."""
    size = codes.itemsize
    for n in range(first, last, LANES):
        code, score = codes.ctypes.data + n * size, scores.ctypes.data + n * size
        addresses = np.uintp(x.ctypes.data), np.uintp(code), np.uintp(score)
        _correlate_block(*addresses, len(x), codes.shape[1])  # type: ignore[call-arg]
    scores[last : _whole(first, last)] = np.float32(0)


@compiled_lean
def _greatest(scores: Any, first: int, last: int) -> Any:
    """Bits of the greatest score: those of positive numbers have the order of the numbers."""
    # The compiler has vector instructions for maxima of integers alone; 0 without a positive score.
    part, greatest = scores.view(np.int32)[first : _whole(first, last)], np.int32(0)
    for n in range(len(part)):
        greatest = max(greatest, part[n])
    return greatest


@compiled_lean
def _best(scores: Any, first: int, last: int) -> Any:
    """Index of the greatest score, of any where none is positive."""
    part, bits = scores.view(np.int32)[first : _whole(first, last)], _greatest(scores, first, last)
    index, none = np.int32(len(part)), np.int32(len(part))
    for n in range(len(part)):
        index = min(index, np.int32(n) if part[n] == bits else none)
    return min(first + index, last - 1)


@compiled_lean
def _square(correlation: Any) -> Any:
    return np.float64(correlation) * correlation if correlation > 0.0 else 0.0


@compiled_lean
def _lobe(scores: Any, best: int, first: int, last: int) -> tuple[int, int]:
    """Range of candidates about a peak, on which a candidate lies, down to the valleys beside it."""
    while best > first and scores[best - 1] > scores[best]:
        best -= 1
    while best < last - 1 and scores[best + 1] > scores[best]:
        best += 1
    low = high = best
    while low > first and scores[low - 1] <= scores[low]:
        low -= 1
    while high < last - 1 and scores[high + 1] <= scores[high]:
        high += 1
    return low, high + 1


@compiled_lean
def _least_score(square: float, power: float, table: Any) -> Any:
    """Score below which no code of a candidate has a correlation whose square is as great."""
    square = min(max(square, 0.0), power)
    bound = np.sqrt(square) * table.cosine - np.sqrt(power - square) * table.sine
    return bound - _ROUNDING * np.sqrt(power)


@compiled_lean
def _variance(lost: float, mean: float, images: int, limits: Any) -> float:
    # A pixel's own misfit tells its variance only where chance hardly explains it.
    freedom, expected = max(images - 3, 1), limits.constant + limits.per_level * mean
    return lost / freedom if lost > limits.surprising * freedom * expected else expected


@compiled_lean
def _exact(x: Any, at: int, table: Any) -> float:
    """Correlation with the code of a grid point."""
    total = 0.0
    for k in range(len(x)):
        total += np.float64(x[k]) * table.unit[k, at]
    return total


@compiled_lean
def _newton(x: Any, at: int, modulation: float, table: Any) -> tuple[float, float]:
    """Distance from a grid point to the best coordinate in px, and the square of the slope there."""
    along, square = 0.0, 0.0
    for k in range(len(x)):
        along += table.slope[at, k] * x[k]
        square += table.slope[at, k] * table.slope[at, k]
    square *= modulation * modulation
    shift = along * modulation / square if square > 0.0 else 0.0
    return shift, square if abs(shift) <= 2.0 * (table.coordinate[1] - table.coordinate[0]) else 0.0


@compiled_lean
def _searched(pixel: Any, lobe: Any, c: int, grid: Any, table: Any, limits: Any, work: Any) -> Any:
    """Likeliest grid point of a lobe, and the ends of the grid points that noise may not exclude."""
    x, mean, power = pixel
    scores, values, _ = work
    low, high = lobe
    lower, upper = max(c - 1, low), min(c + 2, high)
    for widened in range(2):
        left, right = max(table.start[lower], grid[0]), min(table.start[upper], grid[1])
        _correlate(x, table.unit, left, right, values)
        at = _best(values, left, right)
        if widened:
            break
        square = _square(values[at])
        reach = square - limits.hull_chi2 * _variance(power - square, mean, len(x), limits)
        least = _least_score(reach, power, table)
        while low < lower and scores[low] < least:
            low += 1
        while high > upper and scores[high - 1] < least:
            high -= 1
        if low >= lower and high <= upper:
            break
        lower, upper = min(low, lower), max(high, upper)
    return at, left, right


@compiled_lean
def _runner_up(
    pixel: Any, square: float, least: float, part: Any, lobe: Any, grid: Any, table: Any, work: Any
) -> Any:
    """Square of the greatest correlation elsewhere than in a lobe, and its candidate if it is the best."""
    x, _, power = pixel
    scores, _, values = work
    greatest, best, spare = least, -1, len(scores) - 1
    scores[spare] = _least_score(greatest, power, table)
    scores[lobe[0] : lobe[1]] = np.float32(0)
    for block in range(part[0], part[1], LANES):
        if scores[spare] > 0.0 and _greatest(scores, block, block + LANES) < scores.view(np.int32)[spare]:
            continue
        for r in range(block, min(block + LANES, part[1])):
            if scores[r] < scores[spare] or lobe[0] <= r < lobe[1]:
                continue
            left, right = max(table.start[r], grid[0]), min(table.start[r + 1], grid[1])
            _correlate(x, table.unit, left, right, values)
            value = _square(values[_best(values, left, right)])
            if value > greatest:
                greatest = value
                scores[spare] = _least_score(greatest, power, table)
                best = r if value > square * (1.0 + 2.0 * _ROUNDING) else best
    return greatest, best


@compiled_lean
def _fitted(pixel: Any, part: Any, grid: Any, table: Any, limits: Any, work: Any) -> Any:
    """Best grid point by the scores of a range of candidates, with what its surroundings tell."""
    x, mean, power = pixel
    c = _best(work[0], part[0], part[1])
    while True:
        lobe = _lobe(work[0], c, part[0], part[1])
        at, left, right = _searched(pixel, lobe, c, grid, table, limits, work)
        best = _exact(x, at, table)
        if best <= 0.0:
            return at, left, right, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        shift, square = _newton(x, at, best / table.scale[at], table)
        peak = best * best + shift * shift * square
        variance = _variance(power - peak, mean, len(x), limits)
        least = max(peak - limits.certain_chi2 * variance, 0.0)
        runner_up, c = _runner_up(pixel, best * best, least, part, lobe, grid, table, work)
        if c < 0:
            return at, left, right, best, shift, square, peak, variance, (peak - runner_up) / variance
        _correlate(x, table.candidates, part[0], part[1], work[0])


@compiled_lean
def _hull(values: Any, fit: Any, hull: float) -> tuple[int, int, float]:
    """First and last grid point that noise does not exclude, and the least value of such."""
    low, high, at = fit[1], fit[2] - 1, fit[0]
    least = np.float32(np.sqrt(max(fit[6] - hull * fit[7], 0.0)) - fit[3]) + values[at]
    while low < at and values[low] < least:
        low += 1
    while high > at and values[high] < least:
        high -= 1
    return low, high, least


@compiled_lean
def _moments(values: Any, fit: Any, low: int, high: int, least: float) -> tuple[float, float, float]:
    """Sum of the likelihoods of grid points, with the mean distance from the best one and its variance."""
    at, best, peak, scale = fit[0], fit[3], fit[6], -0.5 / fit[7]
    total, first, second = 0.0, 0.0, 0.0
    for n in range(low, high + 1):
        if n == at or values[n] >= least:
            value = best + np.float64(values[n] - values[at])
            weight, away = np.exp(scale * (peak - value * value)), np.float64(n - at)
            total += weight
            first += weight * away
            second += weight * away * away
    first /= total
    return total, first, second / total - first * first


@compiled_lean
def _levels_of(levels: Any, p: int, x: Any) -> Any:
    """Copy the levels of one pixel without their mean; these, mean and sum of squares, and the range."""
    mean, power, least, most = 0.0, 0.0, levels[0, p], levels[0, p]
    for k in range(len(x)):
        x[k] = levels[k, p]
        mean += x[k]
        least, most = min(least, x[k]), max(most, x[k])
    mean /= len(x)
    for k in range(len(x)):
        x[k] -= np.float32(mean)
        power += np.float64(x[k]) * x[k]
    return (x, mean, power), most - least


@compiled_lean
def measure_ranges(table: Any, memory: Any) -> None:
    """Fill in the range about each candidate, and what correlation codes outside of it have at most."""
    x, scores, work, count = memory[0], memory[1], memory[1:], len(table.middle)
    for own in range(count):
        for k in range(len(x)):
            x[k] = table.candidates[k, own]
        _correlate(x, table.candidates, 0, count, scores)
        lobe = _lobe(scores, own, 0, count)
        table.low[own], table.high[own] = lobe
        for n in range(table.start[own], table.start[own + 1]):
            for k in range(len(x)):
                x[k] = table.unit[k, n]
            _correlate(x, table.candidates, 0, count, scores)
            least = np.float32(0)
            for c in range(count):
                least = least if lobe[0] <= c < lobe[1] else max(least, scores[c])
            pixel = x, 0.0, 1.0
            square, _ = _runner_up(
                pixel, 1.0, _square(least), (0, count), lobe, (0, len(table.scale)), table, work
            )
            table.elsewhere[n] = np.sqrt(square)


@compiled_lean
def _nothing_elsewhere(
    pixel: Any, fit: Any, first: int, last: int, part: Any, table: Any, limits: Any
) -> Any:
    """Whether no candidate from `first` to `last` outside of the range that was searched matters to a fit."""
    at, power, c = fit[0], pixel[2], table.owner[fit[0]]
    if max(first, table.low[c]) < part[0] or min(last, table.high[c]) > part[1]:
        return False
    # The cosine of the difference of two angles, of which the first must be the greater one.
    own, other = min(fit[3] / np.sqrt(power), 1.0), table.elsewhere[at] + _ROUNDING
    greatest = own * other + np.sqrt(max((1.0 - own * own) * (1.0 - other * other), 0.0))
    return own > other and power * greatest * greatest < fit[6] - limits.certain_chi2 * fit[7]


@compiled_lean
def _best_fit(pixel: Any, near: int, grid: Any, table: Any, limits: Any, work: Any) -> Any:
    """Search the range of a candidate, then that of the best one there, then all, until nothing is missed."""
    first, last = table.owner[grid[0]], table.owner[grid[1] - 1] + 1
    for _ in range(2):
        part = max(first, table.low[near] - _BESIDE), min(last, table.high[near] + _BESIDE)
        if not part[0] <= near < part[1]:
            break
        _correlate(pixel[0], table.candidates, part[0], part[1], work[0])
        before, near = near, _best(work[0], part[0], part[1])
        if work[0][near] > np.sqrt(pixel[2]) * table.elsewhere[table.middle[near]]:
            fit = _fitted(pixel, part, grid, table, limits, work)
            if fit[3] > 0.0 and _nothing_elsewhere(pixel, fit, first, last, part, table, limits):
                return fit
        if near == before:
            break
    _correlate(pixel[0], table.candidates, first, last, work[0])
    return _fitted(pixel, (first, last), grid, table, limits, work)


@compiled_lean
def search_codes(levels: Any, lower: Any, upper: Any, table: Any, limits: Any, memory: Any, out: Any) -> None:
    """Find the likeliest coordinate of P pixels.

    levels (K, P) grey levels; lower, upper (P,) ends of the possible coordinates in px; out (9, P) becomes
    coordinate, its variance, modulation, offset, misfit's χ², χ² by which the runner-up is worse (at
    most the limit), the ends of the interval of coordinates whose χ² is within the hull's, and the
    logarithm of the likelihood of the code at any coordinate.
    """
    images, count, near = len(levels), len(table.scale), 0
    start, step, freedom = table.coordinate[0], table.coordinate[1] - table.coordinate[0], max(images - 3, 1)
    x, work = memory[0], memory[1:]
    for p in range(levels.shape[1]):
        out[:, p] = np.nan
        pixel, change = _levels_of(levels, p, x)
        if change < limits.min_range or pixel[2] <= 0.0 or not lower[p] < upper[p]:
            continue
        grid = (
            max(np.int64(np.floor((lower[p] - start) / step)), 0),
            min(np.int64(np.ceil((upper[p] - start) / step)) + 1, count),
        )
        fit = _best_fit(pixel, near, grid, table, limits, work)
        at, _, _, best, shift, square, peak, variance, gap = fit
        if best <= 0.0:
            continue
        near = table.owner[at]
        low, high, least = _hull(work[1], fit, limits.hull_chi2)
        sharp = square > 0.0 and variance / square < step * step
        total, away, spread = 1.0, 0.0, 0.0
        if not sharp or high - low > 3:  # fewer points cannot be spread enough
            total, away, spread = _moments(work[1], fit, low, high, least)
        if sharp and spread < 4.0 - 1.0 / 12.0:
            out[0, p], out[1, p] = start + at * step + shift, variance / square
            volume = np.sqrt(2.0 * np.pi * variance / square)  # of a peak that the grid is too coarse for
        else:
            out[0, p], out[1, p] = start + (at + away) * step, (spread + 1.0 / 12.0) * step * step
            volume = total * step
        mean, lost = pixel[1], max(pixel[2] - peak, 0.0)
        expected = limits.constant + limits.per_level * mean
        out[8, p] = np.log(volume) - 0.5 * min(lost / expected, limits.surprising * freedom)
        out[2, p], out[3, p] = 0.5 * best / table.scale[at], mean
        out[4, p], out[5, p] = lost / freedom / max(expected, 1e-9), gap
        out[6, p], out[7, p] = start + low * step - 0.5 * step, start + high * step + 0.5 * step
