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
from numpy.typing import NDArray

from fpplab.phase.chunks import compiled_lean, lean_part

LANES = 64  # codes that are correlated at a time (chosen: four vectors, whose sums overlap)
BATCH = 64  # pixels whose scores are kept, for the rest to be computed of many at a time (chosen: the cache)
_SMALL = 1e-30  # what keeps quotients finite (chosen)
_VECTOR = 16  # likelihoods that are computed at a time (chosen: one vector)
BESIDE = 2  # neighbours of a candidate to either side (chosen: those that noise takes for it)
_NARROW = 4.0 - 1.0 / 12.0  # variance in squares of grid points (derived: two, less that within a point)
_ROUNDING = 2e-6  # of a correlation in float32, as a share of the levels' length (chosen)
_HALVINGS = 6  # of an exponent, for a polynomial to give its power (chosen: 2e-3 of likelihoods at 5 sigma)
_LARGEST_PART = 1.596  # where the polynomial that stands for exp(-part) is least; it grows beyond


_AT, _LEFT, _RIGHT = 0, BATCH, 2 * BATCH  # where rows of `Memory.points` begin
# Rows of `Memory.fit` lie at distances that the compiler knows, for it to compute several pixels at a time.
FIGURES = 17
(_POWER, _TOP, _BEST, _ALONG, _SCALE, _STEEPNESS, _OTHER, _SHIFT, _SQUARE, _PEAK, _VARIANCE, _GAP) = (
    BATCH * row for row in range(12)
)
_LOW, _HIGH, _TOTAL, _AWAY, _SPREAD = (BATCH * row for row in range(12, FIGURES))


class Memory(NamedTuple):
    """Room that compiled functions work in: levels of pixels, scores, and what is known of each pixel."""

    levels: NDArray[np.float32]  # (BATCH, K)
    scores: NDArray[np.float32]  # of candidates
    values: NDArray[np.float32]  # (1, N), of the grid points of a lobe
    others: NDArray[np.float32]  # of the grid points of other candidates
    beside: NDArray[np.float32]  # (BATCH, N), of the grid points beside the best candidate
    points: NDArray[np.int64]  # (3 BATCH,): best grid point, first one of `beside`, and one behind the last
    fit: NDArray[np.float64]  # (FIGURES BATCH,)
    means: NDArray[np.float32]  # (BATCH,), of the levels
    ends: NDArray[np.int64]  # (2, BATCH), of the possible grid points; none where both are the same


class SearchLimits(NamedTuple):
    """Noise of the levels, and how far it may lead."""

    constant: float  # variance at level 0
    per_level: float  # increase of the variance per level
    hull_chi2: float  # χ² up to which a coordinate is possible
    certain_chi2: float  # χ² beyond which a runner-up is not looked for
    surprising: float  # mean square that residuals hardly ever exceed by chance, in units of the variance


def _everywhere(builder: Any, number: Any) -> Any:
    """Vector of one number."""
    nowhere = ir.Constant(ir.VectorType(number.type, LANES), ir.Undefined)
    vector = builder.insert_element(nowhere, number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
    return builder.shuffle_vector(vector, nowhere, zeros)


def _reduced(builder: Any, operation: str, vector: Any) -> Any:
    """One number of a vector."""
    kind = "f32" if isinstance(vector.type.element, ir.FloatType) else "i32"
    function = cgutils.get_or_insert_function(  # type: ignore[no-untyped-call]
        builder.module,
        ir.FunctionType(vector.type.element, [vector.type]),
        f"llvm.vector.reduce.{operation}.v{LANES}{kind}",
    )
    return builder.call(function, [vector], fastmath=("nnan", "nsz") if kind == "f32" else ())


@intrinsic
def _correlate_all(_typing: Any, x: Any, codes: Any, row: Any, images: Any, count: Any, scores: Any) -> Any:
    """Correlate with codes, by addresses; 0 up to the end of the last vector. The greatest score's index."""

    # Written as vectors, because the compiler makes none of ranges that are short.
    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        number, integer, many = ir.FloatType(), ir.IntType(32), ir.VectorType(ir.FloatType(), LANES)
        levels, codes = (builder.inttoptr(each, number.as_pointer()) for each in arguments[:2])
        row, images, count = arguments[2:5]
        into = builder.inttoptr(arguments[5], many.as_pointer())
        indices = ir.VectorType(integer, LANES)
        nothing, lane = ir.Constant(many, None), ir.Constant(indices, list(range(LANES)))
        most, where, total = (
            cgutils.alloca_once_value(builder, value)  # type: ignore[no-untyped-call]
            for value in (nothing, ir.Constant(indices, None), nothing)
        )
        wide = ir.Constant(row.type, LANES)
        blocks = builder.udiv(builder.add(count, ir.Constant(row.type, LANES - 1)), wide)
        with cgutils.for_range(builder, blocks) as block:
            builder.store(nothing, total)
            before = builder.mul(block.index, wide)
            first = builder.gep(codes, [before])
            with cgutils.for_range(builder, images) as image:
                level = _everywhere(builder, builder.load(builder.gep(levels, [image.index])))
                at = builder.gep(first, [builder.mul(image.index, row)])
                code = builder.load(builder.bitcast(at, many.as_pointer()), align=4)
                product = builder.fmul(level, code, flags=("contract",))
                builder.store(builder.fadd(builder.load(total), product, flags=("contract",)), total)
            index = builder.add(_everywhere(builder, builder.trunc(before, integer)), lane)
            valid = builder.icmp_signed("<", index, _everywhere(builder, builder.trunc(count, integer)))
            values = builder.select(valid, builder.load(total), nothing)
            builder.store(values, builder.gep(into, [block.index]), align=4)
            better = builder.fcmp_ordered(">", values, builder.load(most))
            builder.store(builder.select(better, values, builder.load(most)), most)
            builder.store(builder.select(better, index, builder.load(where)), where)

        greatest = _reduced(builder, "fmax", builder.load(most))
        is_best = builder.fcmp_ordered("==", builder.load(most), _everywhere(builder, greatest))
        never = ir.Constant(indices, [2**31 - 1] * LANES)
        best = _reduced(builder, "umin", builder.select(is_best, builder.load(where), never))
        return builder.zext(best, ir.IntType(64))

    address, integer = types.uintp, types.intp
    return types.int64(address, address, integer, integer, integer, address), generate


@lean_part
def _correlate(x: Any, codes: Any, first: int, last: int, scores: Any, into: int) -> int:
    """Correlate the levels of one pixel with a range of codes, and give the best of them."""
    size = codes.itemsize
    code, score = codes.ctypes.data + first * size, scores.ctypes.data + into * size
    addresses = np.uintp(x.ctypes.data), np.uintp(code)
    count, into_address = last - first, np.uintp(score)
    best: int = _correlate_all(*addresses, codes.shape[1], len(x), count, into_address)  # type: ignore[call-arg]
    return first + best


@intrinsic
def _span_of(_typing: Any, scores: Any, least: Any) -> Any:
    """First and last of `LANES` scores at an address that are as great; `LANES` and -1 where none is."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        integer, vector = ir.IntType(64), ir.VectorType(ir.FloatType(), LANES)
        values = builder.load(builder.inttoptr(arguments[0], vector.as_pointer()), align=4)
        reached = builder.fcmp_ordered(">=", values, _everywhere(builder, arguments[1]))
        mask, no = builder.bitcast(reached, ir.IntType(LANES)), ir.Constant(ir.IntType(1), 0)
        first, after = (builder.zext(count(mask, no), integer) for count in (builder.cttz, builder.ctlz))
        last = builder.sub(ir.Constant(integer, LANES - 1), after)
        return context.make_tuple(builder, signature.return_type, (first, last))

    both = types.UniTuple(types.int64, 2)  # type: ignore[no-untyped-call]
    return both(types.uintp, types.float32), generate


@lean_part
def _reaching(scores: Any, least: Any, first: int, last: int) -> tuple[int, int]:
    """First and last index of the scores that are as great; the ends the other way round without any."""
    # Whole vectors are read as they were written, which the processor need not wait for.
    low, high = last, first - 1
    for n in range(first, last, LANES):
        address = np.uintp(scores.ctypes.data + n * scores.itemsize)
        left, right = _span_of(address, least)  # type: ignore[call-arg, var-annotated]
        low, high = min(low, n + left) if left < LANES else low, n + right if right >= 0 else high
    return low, high


@lean_part
def _square(correlation: Any) -> Any:
    return np.float64(correlation) * correlation if correlation > 0.0 else 0.0


@lean_part
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


@lean_part
def _least_score(square: float, power: float, table: Any) -> Any:
    """Score below which no code of a candidate has a correlation whose square is as great."""
    square = min(max(square, 0.0), power)
    bound = np.sqrt(square) * table.cosine - np.sqrt(power - square) * table.sine
    return bound - _ROUNDING * np.sqrt(power)


@lean_part
def _variance(lost: float, mean: float, images: int, limits: Any) -> float:
    # A pixel's own misfit tells its variance only where chance hardly explains it.
    freedom, expected = max(images - 3, 1), limits.constant + limits.per_level * mean
    return lost / freedom if lost > limits.surprising * freedom * expected else expected


@lean_part
def _keep(p: int, at: int, left: int, right: int, top: Any, table: Any, work: Any) -> None:
    """Store the best grid point of a pixel, its correlations, and what its fit needs."""
    points, fit, x = work.points, work.fit, work.levels[p]
    best, along = 0.0, 0.0
    for k in range(len(x)):
        best += np.float64(x[k]) * table.rows[at, k]
        along += np.float64(x[k]) * table.slope[at, k]
    points[_AT + p], points[_LEFT + p], points[_RIGHT + p] = at, left, right
    fit[_TOP + p], fit[_BEST + p], fit[_ALONG + p], fit[_SCALE + p] = top, best, along, table.scale[at]
    fit[_STEEPNESS + p], fit[_OTHER + p] = table.steepness[at], table.beside[at] + _ROUNDING


@lean_part
def _fit(first: int, last: int, means: Any, step: float, limits: Any, images: int, fit: Any) -> None:
    """Fit pixels by one step of Newton's from their best grid points."""
    for p in range(first, last):
        best, along, steepness = fit[_BEST + p], fit[_ALONG + p], fit[_STEEPNESS + p]
        modulation = best / max(fit[_SCALE + p], _SMALL)
        square = steepness * modulation * modulation
        shift = along * modulation / max(square, _SMALL)
        square = square if abs(shift) <= 2.0 * step else 0.0
        peak = best * best + shift * shift * square
        fit[_SHIFT + p], fit[_SQUARE + p], fit[_PEAK + p] = shift, square, peak
        fit[_VARIANCE + p] = _variance(fit[_POWER + p] - peak, float(means[p]), images, limits)


@lean_part
def _prove(count: int, limits: Any, fit: Any) -> None:
    """Leave a correlation of 0 where another code than that beside a candidate may matter."""
    for p in range(count):
        power, other = max(fit[_POWER + p], _SMALL), fit[_OTHER + p]
        # The cosine of the difference of two angles, of which the first must be the greater one.
        own = min(fit[_BEST + p] / np.sqrt(power), 1.0)
        greatest = own * other + np.sqrt(max((1.0 - own * own) * (1.0 - other * other), 0.0))
        reach = fit[_PEAK + p] - limits.certain_chi2 * fit[_VARIANCE + p]
        proven = (own > other) & (power * greatest * greatest < reach)
        fit[_BEST + p] = fit[_BEST + p] if proven else 0.0
        fit[_GAP + p] = limits.certain_chi2


@lean_part
def _searched(pixel: Any, lobe: Any, c: int, grid: Any, table: Any, limits: Any, work: Any) -> Any:
    """Likeliest grid point of a lobe, and the ends of the grid points that noise may not exclude."""
    x, mean, power = pixel
    scores, values = work.scores, work.values[0]
    low, high = lobe
    lower, upper = max(c - 1, low), min(c + 2, high)
    for widened in range(2):
        left, right = max(table.start[lower], grid[0]), min(table.start[upper], grid[1])
        at = _correlate(x, table.unit, left, right, values, 0)
        if widened:
            break
        square = _square(values[at - left])
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


@lean_part
def _runner_up(
    pixel: Any, square: float, least: float, part: Any, lobe: Any, grid: Any, table: Any, work: Any
) -> Any:
    """Square of the greatest correlation elsewhere than in a lobe, and its candidate if it is the best."""
    x, _, power = pixel
    scores, values = work.scores, work.others
    greatest, best, enough = least, -1, np.float32(_least_score(least, power, table))
    scores[lobe[0] : lobe[1]] = np.float32(0)
    for block in range(part[0], part[1], LANES):
        low, high = _reaching(scores, enough, block, block + LANES)
        for r in range(low, min(high + 1, part[1])):
            if scores[r] < enough or lobe[0] <= r < lobe[1]:
                continue
            left, right = max(table.start[r], grid[0]), min(table.start[r + 1], grid[1])
            value = _square(values[_correlate(x, table.unit, left, right, values, left)])
            if value > greatest:
                greatest, enough = value, np.float32(_least_score(value, power, table))
                best = r if value > square * (1.0 + 2.0 * _ROUNDING) else best
    return greatest, best


@lean_part
def _search_everywhere(p: int, mean: float, grid: Any, table: Any, limits: Any, work: Any) -> None:
    """Find the best grid point of a pixel among all candidates, and the runner-up."""
    x, fit, c = work.levels[p], work.fit, -1
    pixel = x, mean, fit[_POWER + p]
    part = table.owner[grid[0]], table.owner[grid[1] - 1] + 1
    step = table.coordinate[1] - table.coordinate[0]
    while True:
        top = _correlate(x, table.candidates, part[0], part[1], work.scores, part[0])
        c = top if c < 0 else c
        lobe = _lobe(work.scores, c, part[0], part[1])
        at, left, right = _searched(pixel, lobe, c, grid, table, limits, work)
        _keep(p, at, left, right, work.values[0, at - left], table, work)
        best = fit[_BEST + p]
        if best <= 0.0:
            return
        _fit(p, p + 1, work.means, step, limits, len(x), fit)
        peak, variance = fit[_PEAK + p], fit[_VARIANCE + p]
        least = max(peak - limits.certain_chi2 * variance, 0.0)
        runner_up, c = _runner_up(pixel, best * best, least, part, lobe, grid, table, work)
        if c < 0:
            fit[_GAP + p] = (peak - runner_up) / variance
            return


@compiled_lean
def measure_beside(table: Any, work: Any) -> None:
    """Fill in what correlation each code has at most with one that is no neighbour of its candidate."""
    x, scores, count = work.levels[0], work.scores, len(table.middle)
    for own in range(count):
        lobe = max(0, own - BESIDE), min(count, own + BESIDE + 1)
        for n in range(table.start[own], table.start[own + 1]):
            for k in range(len(x)):
                x[k] = table.rows[n, k]
            _correlate(x, table.candidates, 0, count, scores, 0)
            least = np.float32(0)
            for c in range(count):
                least = least if lobe[0] <= c < lobe[1] else max(least, scores[c])
            pixel = x, 0.0, 1.0
            square, _ = _runner_up(
                pixel, 1.0, _square(least), (0, count), lobe, (0, len(table.scale)), table, work
            )
            table.beside[n] = np.sqrt(square)


@lean_part
def _search_beside(count: int, near: int, table: Any, work: Any) -> int:
    """Find the best grid points of pixels near that of the one before, or the best of every second code."""
    scores, fit, owner = work.scores, work.fit, table.owner
    for p in range(count):
        x, values, grid = work.levels[p], work.beside[p], (work.ends[0, p], work.ends[1, p])
        if grid[0] == grid[1]:
            continue
        ends, good = (owner[grid[0]], owner[grid[1] - 1] + 1), np.float32(np.sqrt(fit[_POWER + p]))
        for guess in range(2):
            if guess:
                near = 2 * _correlate(x, table.every_second, ends[0] // 2, (ends[1] + 1) // 2, scores, 0)
            low = max(min(near - LANES // 2, ends[1] - LANES), ends[0])
            high = min(low + LANES, ends[1])
            c = _correlate(x, table.candidates, low, high, scores, low)
            inside = (low < c - BESIDE or low == ends[0]) and (c + BESIDE < high - 1 or high == ends[1])
            if inside and scores[c] > good * table.beside[table.middle[c]]:
                break
            inside = False
        if not inside:
            continue
        near = top = c
        for _ in range(2):
            first, last = max(ends[0], c - BESIDE), min(ends[1], c + BESIDE + 1)
            left, right = max(table.start[first], grid[0]), min(table.start[last], grid[1])
            at = _correlate(x, table.unit, left, right, values, 0)
            if owner[at] == c:
                break
            c = owner[at]
        # Where no valley is between the candidates, none of them is a runner-up.
        inside = owner[at] == c and low <= first and last <= high
        for r in range(max(low, first), min(high, last) - 1):
            inside &= (scores[r] - scores[r + 1]) * (r - top + np.float32(0.5)) >= np.float32(0)
        if inside:
            _keep(p, at, left, right, values[at - left], table, work)
    return near


@lean_part
def _describe(begin: int, end: int, scores: Any, limits: Any, work: Any) -> None:
    """Hulls and moments of the likelihoods of grid points, by their scores."""
    points, fit, f32 = work.points, work.fit, np.float32
    for p in range(begin, end):
        if fit[_BEST + p] <= 0.0:
            continue
        values, left, peak, variance = (
            scores[p - begin],
            points[_LEFT + p],
            fit[_PEAK + p],
            fit[_VARIANCE + p],
        )
        at, count, best = points[_AT + p] - left, points[_RIGHT + p] - left, f32(fit[_BEST + p])
        hull = np.sqrt(max(peak - limits.hull_chi2 * variance, 0.0))
        top, scale = f32(fit[_TOP + p]), f32(0.5 / variance)
        least = f32(hull - fit[_BEST + p]) + top
        low, high = _reaching(values, least, 0, count)
        low, high = min(low, at), max(min(high, count - 1), at)
        offset = f32(peak - fit[_BEST + p] * fit[_BEST + p]) * scale
        total, first, second = f32(0), f32(0), f32(0)
        for block in range(low, high + 1, _VECTOR):
            for n in range(_VECTOR):
                value, away = values[block + n], f32(block + n - at)
                drop = top - value
                part = (offset + scale * drop * (best + best - drop)) * f32(0.5**_HALVINGS)
                part = min(part, f32(_LARGEST_PART))
                weight = f32(1) - part * (
                    f32(1) - part * (f32(1 / 2) - part * (f32(1 / 6) - part * f32(1 / 24)))
                )
                for _ in range(_HALVINGS):
                    weight *= weight
                inside = (block + n <= high) & ((value >= least) | (block + n == at))
                weight = weight if inside else f32(0)
                total += weight
                first += weight * away
                second += weight * away * away
        mean = first / total
        fit[_LOW + p], fit[_HIGH + p], fit[_TOTAL + p] = low + left, high + left, total
        fit[_AWAY + p], fit[_SPREAD + p] = mean, second / total - mean * mean


@lean_part
def _write(count: int, means: Any, table: Any, limits: Any, work: Any, out: Any) -> None:
    """Give the figures of pixels as `search_codes` does."""
    fit, freedom = work.fit, max(work.levels.shape[1] - 3, 1)
    start, step = table.coordinate[0], table.coordinate[1] - table.coordinate[0]
    for p in range(count):
        square, variance = max(fit[_SQUARE + p], _SMALL), fit[_VARIANCE + p]
        # A peak may be too sharp for the grid.
        sharp = (variance < step * step * square) & (fit[_SPREAD + p] < _NARROW)
        bound = variance / square if sharp else (fit[_SPREAD + p] + 1.0 / 12.0) * step * step
        fit[_SHIFT + p] = fit[_SHIFT + p] if sharp else fit[_AWAY + p] * step
        fit[_TOTAL + p] = np.sqrt(2.0 * np.pi * bound) if sharp else fit[_TOTAL + p] * step
        fit[_SPREAD + p] = bound
        expected = max(limits.constant + limits.per_level * float(means[p]), 1e-9)
        fit[_VARIANCE + p] = max(fit[_POWER + p] - fit[_PEAK + p], 0.0) / (freedom * expected)
    for p in range(count):
        fitted, at = fit[_BEST + p] > 0.0, work.points[_AT + p]
        out[0, p], out[1, p] = start + at * step + fit[_SHIFT + p] if fitted else np.nan, fit[_SPREAD + p]
        out[2, p] = 0.5 * fit[_BEST + p] / fit[_SCALE + p]
        out[4, p], out[5, p], out[8, p] = fit[_VARIANCE + p], fit[_GAP + p], fit[_TOTAL + p]
        out[6, p], out[7, p] = start + (fit[_LOW + p] - 0.5) * step, start + (fit[_HIGH + p] + 0.5) * step
        if not fitted:
            out[:, p] = np.nan


@lean_part
def _search_batch(
    levels: Any, lower: Any, upper: Any, near: int, table: Any, limits: Any, work: Any, out: Any
) -> int:
    fit, ends, means, (images, count) = work.fit, work.ends, work.means, levels.shape
    start, step = table.coordinate[0], table.coordinate[1] - table.coordinate[0]
    fit[:], work.points[:] = 0.0, 0
    for k in range(images):
        for p in range(count):
            work.levels[p, k] = levels[k, p]
            fit[_POWER + p] += np.float64(levels[k, p]) * levels[k, p]
    for p in range(count):
        means[p] = out[3, p]
        usable = lower[p] < upper[p] and fit[_POWER + p] > 0.0
        ends[0, p] = max(np.int64(np.floor((lower[p] - start) / step)), 0) if usable else 0
        last = min(np.int64(np.ceil((upper[p] - start) / step)) + 1, len(table.scale))
        ends[1, p] = last if usable else 0
    near = _search_beside(count, near, table, work)
    _fit(0, count, means, step, limits, images, fit)
    _prove(count, limits, fit)
    _describe(0, count, work.beside, limits, work)
    for p in range(count):
        if fit[_BEST + p] <= 0.0 and ends[0, p] < ends[1, p]:
            _search_everywhere(p, float(means[p]), (ends[0, p], ends[1, p]), table, limits, work)
            _describe(p, p + 1, work.values, limits, work)
    _write(count, means, table, limits, work, out)
    return near


@compiled_lean
def search_codes(levels: Any, lower: Any, upper: Any, table: Any, limits: Any, work: Any, out: Any) -> None:
    """Find the likeliest coordinate of P pixels.

    levels (K, P) grey levels without their means, which are in out[3]; lower, upper (P,) ends of the possible
    coordinates in px; out (9, P) becomes coordinate, its variance, modulation, offset, misfit's χ², χ² by
    which the runner-up is worse (at most the limit), the ends of the interval of coordinates whose χ² is
    within the hull's, and the width in px of the likelihood.
    """
    near = 0
    for begin in range(0, levels.shape[1], BATCH):
        part = slice(begin, min(begin + BATCH, levels.shape[1]))
        near = _search_batch(
            levels[:, part], lower[part], upper[part], near, table, limits, work, out[:, part]
        )
