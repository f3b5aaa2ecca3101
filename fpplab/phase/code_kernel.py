"""Compiled search of the likeliest code at every pixel; codes are those of a `CodeTable`.

With A and B fitted, the sum of squares that a code c leaves of a pixel's levels x is
`|x|² - (x·c)²` for codes of unit length, both without their means: the likeliest code is the one with the
greatest correlation x·c. Offset and modulation cost two of the K images.

Best code and runner-up are those of the whole grid, though most of it is not visited: angles between unit
vectors obey the triangle inequality. A code lies within a known angle of its candidate's, so that the
candidate's correlation bounds its own; and codes outside of the range about a code lie at least a known angle
from it, so that none of them needs a visit where it fits well. What is near the pixel before is tried first.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fpplab.phase.chunks import compiled_lean

LANES = 64  # scores that are compared at a time (chosen: those beside a candidate, without a branch)
_CODES = 32  # codes that are correlated at a time (chosen: two to four vectors)
_NEAR = 16  # candidates to either side of that of the pixel before that are tried first (chosen)
_EXACT = 8  # grid points to either side of the best one whose spread is bounded quickly (chosen)
_BESIDE = 2  # neighbours of a candidate to either side (chosen: those that noise takes for it)
_NARROW = 4.0 - 1.0 / 12.0  # variance in squares of grid points (derived: two, less that within a point)
_ROUNDING = 2e-6  # of a correlation in float32, as a share of the levels' length (chosen)


class SearchLimits(NamedTuple):
    """Noise of the levels, and how far it may lead."""

    constant: float  # variance at level 0
    per_level: float  # increase of the variance per level
    hull_chi2: float  # χ² up to which a coordinate is possible
    certain_chi2: float  # χ² beyond which a runner-up is not looked for
    surprising: float  # mean square that residuals hardly ever exceed by chance, in units of the variance


@compiled_lean
def _whole(first: int, last: int) -> int:
    """End of a range of whole vectors."""
    return first + (last - first + LANES - 1) // LANES * LANES


def _everywhere(builder: Any, number: Any, size: int) -> Any:
    """Vector of one number."""
    nowhere = ir.Constant(ir.VectorType(number.type, size), ir.Undefined)
    vector = builder.insert_element(nowhere, number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), size), None)
    return builder.shuffle_vector(vector, nowhere, zeros)


@intrinsic
def _correlate_block(_typing: Any, x: Any, codes: Any, scores: Any, images: Any, row: Any) -> Any:
    """Correlate with `_CODES` codes; addresses of levels, first code and first score, length of rows."""

    # Written as vectors, because the compiler makes none of ranges that are short.
    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        number, vector = ir.FloatType(), ir.VectorType(ir.FloatType(), _CODES)
        levels, first = (builder.inttoptr(each, number.as_pointer()) for each in arguments[:2])
        into = builder.inttoptr(arguments[2], vector.as_pointer())
        total = cgutils.alloca_once_value(builder, ir.Constant(vector, None))  # type: ignore[no-untyped-call]
        with cgutils.for_range(builder, arguments[3]) as image:
            level = _everywhere(builder, builder.load(builder.gep(levels, [image.index])), _CODES)
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
    for n in range(first, last, _CODES):
        code, score = codes.ctypes.data + n * size, scores.ctypes.data + n * size
        addresses = np.uintp(x.ctypes.data), np.uintp(code), np.uintp(score)
        _correlate_block(*addresses, len(x), codes.shape[1])  # type: ignore[call-arg]
    scores[last : _whole(first, last)] = np.float32(0)


@intrinsic
def _greatest_of(_typing: Any, scores: Any, blocks: Any) -> Any:
    """Greatest of blocks of `LANES` scores at an address; 0 without a positive one."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        number, vector = ir.FloatType(), ir.VectorType(ir.FloatType(), LANES)
        first = builder.inttoptr(arguments[0], vector.as_pointer())
        most = cgutils.alloca_once_value(builder, ir.Constant(vector, None))  # type: ignore[no-untyped-call]
        with cgutils.for_range(builder, arguments[1]) as block:
            values, before = builder.load(builder.gep(first, [block.index]), align=4), builder.load(most)
            builder.store(builder.select(builder.fcmp_ordered(">", values, before), values, before), most)
        name, kind = f"llvm.vector.reduce.fmax.v{LANES}f32", ir.FunctionType(number, [vector])
        reduce = cgutils.get_or_insert_function(builder.module, kind, name)  # type: ignore[no-untyped-call]
        return builder.call(reduce, [builder.load(most)], fastmath=("nnan", "nsz"))

    return types.float32(types.uintp, types.intp), generate


@intrinsic
def _span_of(_typing: Any, scores: Any, least: Any) -> Any:
    """First and last of `LANES` scores at an address that are as great; `LANES` and -1 where none is."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        integer, vector = ir.IntType(64), ir.VectorType(ir.FloatType(), LANES)
        values = builder.load(builder.inttoptr(arguments[0], vector.as_pointer()), align=4)
        reached = builder.fcmp_ordered(">=", values, _everywhere(builder, arguments[1], LANES))
        mask, no = builder.bitcast(reached, ir.IntType(LANES)), ir.Constant(ir.IntType(1), 0)
        first, after = (builder.zext(count(mask, no), integer) for count in (builder.cttz, builder.ctlz))
        last = builder.sub(ir.Constant(integer, LANES - 1), after)
        return context.make_tuple(builder, signature.return_type, (first, last))

    both = types.UniTuple(types.int64, 2)  # type: ignore[no-untyped-call]
    return both(types.uintp, types.float32), generate


@compiled_lean
def _greatest(scores: Any, first: int, last: int) -> Any:
    """Greatest score of whole vectors; 0 without a positive one."""
    address, blocks = scores.ctypes.data + first * scores.itemsize, (last - first + LANES - 1) // LANES
    return _greatest_of(np.uintp(address), blocks)  # type: ignore[call-arg]


@compiled_lean
def _reaching(scores: Any, least: Any, first: int, last: int) -> tuple[int, int]:
    """First and last index of the scores that are as great; the ends the other way round without any."""
    # Whole vectors are read as they were written, which the processor need not wait for.
    low, high = last, first - 1
    for n in range(first, last, LANES):
        address = np.uintp(scores.ctypes.data + n * scores.itemsize)
        left, right = _span_of(address, least)  # type: ignore[call-arg, var-annotated]
        low, high = min(low, n + left) if left < LANES else low, n + right if right >= 0 else high
    return low, high


@compiled_lean
def _best(scores: Any, first: int, last: int) -> Any:
    """Index of the greatest score, of any where none is positive."""
    return min(_reaching(scores, _greatest(scores, first, last), first, last)[0], last - 1)


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
        if scores[spare] > 0.0 and _greatest(scores, block, block + LANES) < scores[spare]:
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
    at = fit[0]
    least = np.float32(np.sqrt(max(fit[6] - hull * fit[7], 0.0)) - fit[3]) + values[at]
    low, high = _reaching(values, least, fit[1], fit[2])
    return min(low, at), max(min(high, fit[2] - 1), at), least


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
def _is_narrow(values: Any, fit: Any, low: int, high: int) -> bool:
    """Whether a peak surely is too narrow for its likelihoods to count, which take exponentials."""
    at, best, scale, spread = fit[0], np.float32(fit[3]), np.float32(0.5 / fit[7]), np.float32(0)
    if low < at - _EXACT or high > at + _EXACT or not _EXACT <= at < len(values) - _EXACT:
        return False
    for n in range(-_EXACT, _EXACT + 1):
        drop = values[at] - values[at + n]
        lost = max(scale * drop * (best + best - drop), np.float32(0))
        away = np.float32(n)
        spread += away * away / (np.float32(1) + lost * (np.float32(1) + np.float32(0.5) * lost))
    return bool(spread < _NARROW)


@compiled_lean
def measure_beside(table: Any, memory: Any) -> None:
    """Fill in what correlation each code has at most with one that is no neighbour of its candidate."""
    x, scores, work, count = memory[0], memory[1], memory[1:], len(table.middle)
    for own in range(count):
        lobe = max(0, own - _BESIDE), min(count, own + _BESIDE + 1)
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
            table.beside[n] = np.sqrt(square)


@compiled_lean
def _fitted_beside(pixel: Any, top: int, ends: Any, grid: Any, table: Any, limits: Any, work: Any) -> Any:
    """Best grid point beside the best candidate; a correlation of 0 where another candidate may matter."""
    x, mean, power = pixel
    values, middle, nothing = work[1], table.middle, (0, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    c = at = -1
    for _ in range(2):
        c = top if at < 0 else table.owner[at]
        low, high = max(ends[0], c - _BESIDE), min(ends[1], c + _BESIDE + 1)
        _correlate(x, table.unit, table.start[low], table.start[high], values)
        # Where no valley is between the candidates, none of them is a runner-up.
        for r in range(low, high - 1):
            if (values[middle[r]] - values[middle[r + 1]]) * (r - top + 0.5) < 0.0:
                return nothing
        left, right = max(table.start[low], grid[0]), min(table.start[high], grid[1])
        at = _best(values, left, right)
        if table.owner[at] == c:
            break
    best = _exact(x, at, table)
    if table.owner[at] != c or best <= 0.0:
        return nothing
    shift, square = _newton(x, at, best / table.scale[at], table)
    peak = best * best + shift * shift * square
    variance = _variance(power - peak, mean, len(x), limits)
    # The cosine of the difference of two angles, of which the first must be the greater one.
    own, other = min(best / np.sqrt(power), 1.0), table.beside[at] + _ROUNDING
    greatest = own * other + np.sqrt(max((1.0 - own * own) * (1.0 - other * other), 0.0))
    if own <= other or power * greatest * greatest >= peak - limits.certain_chi2 * variance:
        return nothing
    return at, left, right, best, shift, square, peak, variance, limits.certain_chi2


@compiled_lean
def _best_fit(pixel: Any, near: int, grid: Any, table: Any, limits: Any, work: Any) -> Any:
    """Try the candidates near one, then those near the best of every second one, then all."""
    first, last = table.owner[grid[0]], table.owner[grid[1] - 1] + 1
    x, scores = pixel[0], work[0]
    for guess in range(2):
        if guess:
            ends = first // 2, (last + 1) // 2
            _correlate(x, table.every_second, ends[0], ends[1], scores)
            near = 2 * _best(scores, ends[0], ends[1])
        part = max(first, near - _NEAR), min(last, near + _NEAR)
        if part[0] < part[1]:
            _correlate(x, table.candidates, part[0], part[1], scores)
            c = _best(scores, part[0], part[1])
            if scores[c] > np.sqrt(pixel[2]) * table.beside[table.middle[c]]:
                fit = _fitted_beside(pixel, c, (first, last), grid, table, limits, work)
                if fit[3] > 0.0:
                    return fit
    _correlate(x, table.candidates, first, last, scores)
    return _fitted(pixel, (first, last), grid, table, limits, work)


@compiled_lean
def search_codes(levels: Any, lower: Any, upper: Any, table: Any, limits: Any, memory: Any, out: Any) -> None:
    """Find the likeliest coordinate of P pixels.

    levels (K, P) grey levels without their means, which are in out[3]; lower, upper (P,) ends of the possible
    coordinates in px; out (9, P) becomes coordinate, its variance, modulation, offset, misfit's χ², χ² by
    which the runner-up is worse (at most the limit), the ends of the interval of coordinates whose χ² is
    within the hull's, and the width in px of the likelihood.
    """
    images, count, near = len(levels), len(table.scale), 0
    start, step, freedom = table.coordinate[0], table.coordinate[1] - table.coordinate[0], max(images - 3, 1)
    x, work = memory[0], memory[1:]
    for p in range(levels.shape[1]):
        power = 0.0
        for k in range(images):
            x[k] = levels[k, p]
            power += np.float64(x[k]) * x[k]
        if power <= 0.0 or not lower[p] < upper[p]:
            out[:, p] = np.nan
            continue
        grid = (
            max(np.int64(np.floor((lower[p] - start) / step)), 0),
            min(np.int64(np.ceil((upper[p] - start) / step)) + 1, count),
        )
        pixel = x, np.float64(out[3, p]), power
        fit = _best_fit(pixel, near, grid, table, limits, work)
        at, _, _, best, shift, square, peak, variance, gap = fit
        if best <= 0.0:
            out[:, p] = np.nan
            continue
        near = table.owner[at]
        low, high, least = _hull(work[1], fit, limits.hull_chi2)
        sharp = square > 0.0 and variance / square < step * step
        total, away, spread = 1.0, 0.0, 0.0
        if not (sharp and _is_narrow(work[1], fit, low, high)):
            total, away, spread = _moments(work[1], fit, low, high, least)
        if sharp and spread < _NARROW:
            out[0, p], out[1, p] = start + at * step + shift, variance / square
            volume = np.sqrt(2.0 * np.pi * variance / square)  # of a peak that the grid is too coarse for
        else:
            out[0, p], out[1, p] = start + (at + away) * step, (spread + 1.0 / 12.0) * step * step
            volume = total * step
        lost, expected = max(power - peak, 0.0), limits.constant + limits.per_level * pixel[1]
        out[2, p], out[8, p] = 0.5 * best / table.scale[at], volume
        out[4, p], out[5, p] = lost / (freedom * max(expected, 1e-9)), gap
        out[6, p], out[7, p] = start + low * step - 0.5 * step, start + high * step + 0.5 * step
