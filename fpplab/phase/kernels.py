"""Compiled decoder, one pass over the pixels: frames -> phase, modulation, coordinate, uncertainty, mask.

The code is written for the processor's cache and vector units. A chunk of pixels is small enough that its
sums stay in the cache while every frame is read once, four frames at a time; all
sums lie in ONE buffer at constant distances, because only then can the compiler
prove that they do not overlap and use vector instructions; constants are float32,
because one float64 among them would halve the vectors; there are no branches, and
what is not measured becomes NaN at the very end. Phases are counted in turns.
"""

from typing import Any

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]
from numba.extending import intrinsic
from numpy.typing import NDArray

from fpplab.phase.chunks import CHUNK, HIGH, LOW, ROW, compiled, compiled_part
from fpplab.phase.fusion import FUSION_ROWS, find_repeated, fuse_axis, weigh
from fpplab.phase.limits import ORDERS
from fpplab.phase.saturation import fit_unsaturated
from fpplab.phase.tables import Maps, Recipe
from fpplab.phase.wrong_order import TO_EXPLAIN, UNEXPLAINED, settle_orders

_BYTES, _WORDS = np.empty(0, np.uint8), np.empty(0, np.uint16)  # types of pixels
GROUP = 4  # frames summed per visit of a chunk (chosen); every set's list of frames is padded to a multiple


_f = np.float32
_u = np.uintp
_ZERO, _QUARTER, _HALF, _ONE = _f(0), _f(0.25), _f(0.5), _f(1)
_TINY, _FAR, _TO_EXPLAIN = _f(1e-30), _f(100), _f(TO_EXPLAIN)
_EDGE_SIGMAS, _MIN_CHI2_DIFFERENCE = _f(ORDERS.edge_sigmas), _f(ORDERS.min_chi2_difference)
_MIN_COST_DIFFERENCE = _f(ORDERS.min_cost_difference)

# Rows of the buffer of sums, at constant distances.
_COS, _MEAN, _SQUARE, _PEAK = _u(ROW), _u(2 * ROW), _u(3 * ROW), _u(4 * ROW)
_SUM_ROWS = 5
# … and behind them the greatest raw values of all sets and chunks, which are never cleared.
_HIGHEST = _u(_SUM_ROWS * ROW)
# Rows of the buffer of unwrapping: two hypotheses of position, cost and worst disagreement.
_COST, _WORST = _u(ROW), _u(2 * ROW)
_OTHER, _OTHER_COST, _OTHER_WORST, _PHASE = _u(3 * ROW), _u(4 * ROW), _u(5 * ROW), _u(6 * ROW)
_UNWRAP_ROWS = 9


def _arctangent_coefficients() -> tuple[np.float32, ...]:
    """Coefficients in z = q² of atan(q)/(2π q) on [0, 1]: interpolation at Chebyshev's nodes."""
    # Degree 9 leaves 4e-9 rad, so that the rounding of float32 alone limits the phase.

    def function(z: NDArray[np.float64]) -> NDArray[np.float64]:
        q = np.sqrt(z)
        return np.asarray(np.arctan(q) / (2 * np.pi * q))

    series: Any = np.polynomial.Chebyshev.interpolate(  # type: ignore[no-untyped-call]
        function, 9, domain=[0, 1]
    )
    return tuple(np.float32(c) for c in series.convert(kind=np.polynomial.Polynomial).coef)


_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9 = _arctangent_coefficients()


@intrinsic
def _pointer(_typing: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.voidptr(types.uintp), generate


@compiled_part
def _pixels(address: Any, start: int, pixel_count: int, like: Any) -> Any:
    """Pixels of a frame from its `start`th on, as an array of the type of `like`."""
    at: Any = address + _u(start * like.itemsize)
    return carray(_pointer(at), (pixel_count,), like.dtype)  # type: ignore[call-arg]


@compiled_part
def _accumulate_four_frames(
    a: Any, b: Any, c: Any, d: Any, weights: Any, accumulators: Any, pixel_count: int
) -> None:
    s0, s1, s2, s3 = weights[0, 0], weights[1, 0], weights[2, 0], weights[3, 0]
    c0, c1, c2, c3 = weights[0, 1], weights[1, 1], weights[2, 1], weights[3, 1]
    m0, m1, m2, m3 = weights[0, 2], weights[1, 2], weights[2, 2], weights[3, 2]
    for j in range(pixel_count):
        i = _u(j)
        x, y, z, w = _f(a[i]), _f(b[i]), _f(c[i]), _f(d[i])
        mx, my, mz, mw = m0 * x, m1 * y, m2 * z, m3 * w
        accumulators[i] += s0 * x + s1 * y + s2 * z + s3 * w
        accumulators[i + _COS] += c0 * x + c1 * y + c2 * z + c3 * w
        accumulators[i + _MEAN] += mx + my + mz + mw
        accumulators[i + _SQUARE] += mx * x + my * y + mz * z + mw * w
        accumulators[i + _PEAK] = max(accumulators[i + _PEAK], x, y, z, w)


@compiled_part
def _accumulate_eight_frames(
    a: Any,
    b: Any,
    c: Any,
    d: Any,
    e: Any,
    f: Any,
    g: Any,
    h: Any,
    weights: Any,
    accumulators: Any,
    pixel_count: int,
) -> None:
    """As `_accumulate_four_frames` twice, which reads and writes the sums twice."""
    s0, s1, s2, s3 = weights[0, 0], weights[1, 0], weights[2, 0], weights[3, 0]
    c0, c1, c2, c3 = weights[0, 1], weights[1, 1], weights[2, 1], weights[3, 1]
    m0, m1, m2, m3 = weights[0, 2], weights[1, 2], weights[2, 2], weights[3, 2]
    s4, s5, s6, s7 = weights[4, 0], weights[5, 0], weights[6, 0], weights[7, 0]
    c4, c5, c6, c7 = weights[4, 1], weights[5, 1], weights[6, 1], weights[7, 1]
    m4, m5, m6, m7 = weights[4, 2], weights[5, 2], weights[6, 2], weights[7, 2]
    for j in range(pixel_count):
        i = _u(j)
        x, y, z, w = _f(a[i]), _f(b[i]), _f(c[i]), _f(d[i])
        p, q, r, t = _f(e[i]), _f(f[i]), _f(g[i]), _f(h[i])
        mx, my, mz, mw = m0 * x, m1 * y, m2 * z, m3 * w
        mp, mq, mr, mt = m4 * p, m5 * q, m6 * r, m7 * t
        accumulators[i] += (s0 * x + s1 * y + s2 * z + s3 * w) + (s4 * p + s5 * q + s6 * r + s7 * t)
        accumulators[i + _COS] += (c0 * x + c1 * y + c2 * z + c3 * w) + (c4 * p + c5 * q + c6 * r + c7 * t)
        accumulators[i + _MEAN] += (mx + my + mz + mw) + (mp + mq + mr + mt)
        accumulators[i + _SQUARE] += (mx * x + my * y + mz * z + mw * w) + (mp * p + mq * q + mr * r + mt * t)
        accumulators[i + _PEAK] = max(accumulators[i + _PEAK], x, y, z, w, p, q, r, t)


@compiled
def _arctangent_in_turns(s: Any, c: Any) -> Any:
    """atan2(s, c)/2π in [0, 1] in float32, without a branch; see `_arctangent_coefficients`."""
    a, b = abs(s), abs(c)
    q = min(a, b) / max(a, b, _TINY)
    z = q * q
    p = _C5 + z * (_C6 + z * (_C7 + z * (_C8 + z * _C9)))
    p = q * (_C0 + z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * p)))))
    p = _QUARTER - p if a > b else p
    p = _HALF - p if c < _ZERO else p
    return _ONE - p if s < _ZERO else p


@compiled_part
def _demodulate(
    accumulators: Any,
    turns: Any,
    modulation: Any,
    offset: Any,
    good: Any,
    pixel_count: int,
    set_index: int,
    recipe: Any,
) -> None:
    """Compute phase, modulation and offset of one set, its masks, and the greatest raw values so far."""
    # The sum of squares becomes the mean square of what the fringe leaves.
    grey, full = recipe.grey, recipe.full_scale
    modulation_min, contrast = recipe.modulation_min, recipe.contrast_min
    origin, misfit = recipe.origin[set_index], recipe.misfit_max[set_index]
    for j in range(pixel_count):
        i = _u(j)
        s, c, mean = accumulators[i], accumulators[i + _COS], accumulators[i + _MEAN]
        power = s * s + c * c
        b = np.sqrt(power)
        p = _arctangent_in_turns(s, c) - origin
        # What of the mean square is neither offset nor fringe is misfit (Parseval).
        rest = accumulators[i + _SQUARE] * grey - mean * mean - _HALF * power
        kept = good[i]
        kept = kept if b >= modulation_min else _ZERO
        kept = kept if b >= contrast * mean else _ZERO
        kept = kept if rest <= misfit * power else _ZERO
        kept = kept if accumulators[i + _PEAK] < full else _ZERO
        turns[i] = p - np.floor(p)
        accumulators[i + _SQUARE] = rest
        modulation[i] = b
        offset[i] = mean
        good[i] = kept if b > _ZERO else _ZERO
        accumulators[i + _HIGHEST] = max(accumulators[i + _HIGHEST], accumulators[i + _PEAK])


@compiled_part
def _only_set_in(coefficients: Any) -> int:
    """The set whose phase is that of a wavelength by itself; -1 where several are combined."""
    alone = -1
    for s in range(len(coefficients)):
        if coefficients[s] == _ONE and alone < 0:
            alone = s
        elif coefficients[s] != _ZERO:
            return -1
    return alone


@compiled_part
def _combined_phase(rows: Any, turns: Any, coefficients: Any, pixel_count: int) -> None:
    """Combine measured phases into the wrapped phase of a synthetic wavelength, in turns."""
    alone = _only_set_in(coefficients)
    if alone >= 0:  # a phase that is measured is wrapped already
        measured = turns[alone]
        for j in range(pixel_count):
            rows[_u(j) + _PHASE] = measured[_u(j)]
        return
    for j in range(pixel_count):
        rows[_u(j) + _PHASE] = _ZERO
    for s in range(len(coefficients)):
        k = coefficients[s]
        if k != _ZERO:
            measured = turns[s]
            for j in range(pixel_count):
                i = _u(j)
                rows[i + _PHASE] += k * measured[i]
    for j in range(pixel_count):
        i = _u(j)
        rows[i + _PHASE] -= np.floor(rows[i + _PHASE])


@compiled_part
def _start_hypotheses(rows: Any, pixel_count: int, stripes: Any) -> None:
    """Start both hypotheses: the period of the base nearest to the middle, and the next nearest one."""
    period = _ONE / stripes
    for j in range(pixel_count):
        i = _u(j)
        middle = _HALF * (rows[i + LOW] + rows[i + HIGH])
        p = (rows[i + _PHASE] + np.floor(middle * stripes - rows[i + _PHASE] + _HALF)) * period
        rows[i] = p
        rows[i + _OTHER] = p - period if p > middle else p + period
        rows[i + _COST] = rows[i + _WORST] = rows[i + _OTHER_COST] = rows[i + _OTHER_WORST] = _ZERO


@compiled_part
def _refine_hypotheses(rows: Any, pixel_count: int, stripes: Any, trust: Any) -> None:
    """Take both hypotheses to the next finer wavelength; disagreement is counted in its periods."""
    period = _ONE / stripes
    for j in range(pixel_count):
        i = _u(j)
        measured = rows[i + _PHASE]
        d = rows[i] * stripes - measured
        order = np.floor(d + _HALF)
        d -= order
        rows[i] = (order + measured) * period
        rows[i + _COST] += trust * d * d
        rows[i + _WORST] = max(rows[i + _WORST], abs(d))
        d = rows[i + _OTHER] * stripes - measured
        order = np.floor(d + _HALF)
        d -= order
        rows[i + _OTHER] = (order + measured) * period
        rows[i + _OTHER_COST] += trust * d * d
        rows[i + _OTHER_WORST] = max(rows[i + _OTHER_WORST], abs(d))


@compiled_part
def _count_saturated(accumulators: Any, pixel_count: int, full_scale: Any) -> Any:
    """How many pixels have saturated samples; a sum, which unlike the maximum becomes vector instructions."""
    count = _ZERO
    for j in range(pixel_count):
        count += _ONE if accumulators[_u(j) + _PEAK] >= full_scale else _ZERO
    return count


@compiled_part
def _refit_saturated(
    accumulators: Any, at: int, pixel_count: int, s: int, pixel_bytes: int, recipe: Any, loss: Any, bent: Any
) -> None:
    """Put least squares of the unsaturated samples in place of the sums of pixels with saturated ones."""
    first, last, full, grey = recipe.first[s], recipe.first[s + 1], recipe.full_scale, recipe.grey
    count = last - first
    levels, fitted = np.empty(count, np.float32), np.empty(6, np.float64)
    cosine, sine = recipe.shift[first:last, 0], recipe.shift[first:last, 1]
    for j in range(pixel_count):
        i = _u(j)
        if accumulators[i + _PEAK] < full:
            continue
        accumulators[i + _HIGHEST] = max(accumulators[i + _HIGHEST], accumulators[i + _PEAK])
        for k in range(count):
            address = recipe.addresses[first + k]
            levels[k] = _f(
                _pixels(address, at + j, 1, _BYTES)[0]
                if pixel_bytes == 1
                else _pixels(address, at + j, 1, _WORDS)[0]
            )
        if fit_unsaturated(levels, cosine, sine, full, recipe.harmonics[s], fitted):
            offset, c, q = grey * fitted[0], grey * fitted[1], grey * fitted[2]
            rest = grey * grey * fitted[3]
            accumulators[i], accumulators[i + _COS], accumulators[i + _MEAN] = _f(q), _f(c), _f(offset)
            accumulators[i + _SQUARE] = _f((rest + offset * offset + 0.5 * (c * c + q * q)) / grey)
            accumulators[i + _PEAK] = _ZERO
            loss[i] = _f(fitted[4])
            # The gains of the lamp count as noise does; the harmonics are those of these samples.
            lamp = recipe.error_constant[s] - recipe.error_harmonic[s]
            bent[i] = _f(lamp * fitted[4] + 0.5 * recipe.images[s] * fitted[5] * fitted[5])


@compiled_part
def _choose_hypothesis(
    rows: Any, weights: Any, good: Any, pixel_count: int, length: Any, stripes: Any, recipe: Any
) -> None:
    """Choose the hypothesis that lies in the interval of possible positions and agrees better."""
    edge_margin, share = recipe.edge_margin / length, recipe.disagreement_max
    apart = _MIN_CHI2_DIFFERENCE * stripes * stripes
    for j in range(pixel_count):
        i = _u(j)
        variance = _ONE / max(weights[i], _TINY)
        tolerance = edge_margin + _EDGE_SIGMAS * np.sqrt(variance)
        a, b = rows[i], rows[i + _OTHER]
        low, high = rows[i + LOW], rows[i + HIGH]
        out_a = max(low - a, a - high, _ZERO)
        out_b = max(low - b, b - high, _ZERO)
        far_a = _FAR + out_a if out_a > tolerance else _ZERO
        far_b = _FAR + out_b if out_b > tolerance else _ZERO
        cost_a, cost_b = rows[i + _COST] + far_a, rows[i + _OTHER_COST] + far_b
        worst_a, worst_b, kept = rows[i + _WORST], rows[i + _OTHER_WORST], good[i]
        worst = worst_b if cost_b < cost_a else worst_a
        far = far_b if cost_b < cost_a else far_a
        kept = kept if worst <= share and far == _ZERO else kept * _TO_EXPLAIN
        # Where one of them is far their costs differ by far more than this.
        min_difference = max(_MIN_COST_DIFFERENCE, apart * variance)
        good[i] = kept if abs(cost_a - cost_b) > min_difference else _ZERO
        rows[i] = b if cost_b < cost_a else a


@compiled_part
def _unwrap_axis(
    axis: int, recipe: Any, rows: Any, turns: Any, weights: Any, good: Any, at: int, pixel_count: int
) -> None:
    """Unwrap one axis to the position of its finest set."""
    low, high = (recipe.low_u, recipe.high_u) if axis == 0 else (recipe.low_v, recipe.high_v)
    _fill_position_limits(low, at, pixel_count, _ZERO, rows[LOW:])
    _fill_position_limits(high, at, pixel_count, _ONE, rows[HIGH:])
    first, last = recipe.wavelengths[axis], recipe.wavelengths[axis + 1]
    _combined_phase(rows, turns, recipe.coefficients[first], pixel_count)
    _start_hypotheses(rows, pixel_count, recipe.stripes[first])
    for r in range(first + 1, last):
        _combined_phase(rows, turns, recipe.coefficients[r], pixel_count)
        _refine_hypotheses(rows, pixel_count, recipe.stripes[r], recipe.trust[r])
    _choose_hypothesis(
        rows, weights, good, pixel_count, recipe.length[axis], recipe.stripes[last - 1], recipe
    )


@compiled_part
def _fill_position_limits(bounds: Any, at: int, pixel_count: int, default: Any, values: Any) -> None:
    """One end of the interval of possible positions of a chunk; `default` where none is known."""
    if len(bounds) > 0:
        _copy(bounds[at:], values, pixel_count)
    else:
        values[:pixel_count] = default


@compiled_part
def _copy(values: Any, out: Any, pixel_count: int) -> None:
    """Copy a chunk; assigning a slice to a slice would take seconds more to compile, at each place."""
    for j in range(pixel_count):
        out[_u(j)] = values[_u(j)]


@compiled_part
def _reduced_root_of_chi2(values: Any, freedom: int, pixel_count: int) -> None:
    """χ² to the root of its share per degree of freedom."""
    share = _f(1.0 / max(freedom, 1))
    for j in range(pixel_count):
        i = _u(j)
        values[i] = np.sqrt(values[i] * share)


@compiled_part
def _erase_invalid(values: Any, good: Any, pixel_count: int) -> None:
    """NaN where a pixel is not measured."""
    for j in range(pixel_count):
        i = _u(j)
        values[i] = values[i] if good[i] > _ZERO else _f(np.nan)


@compiled_part
def _add_frames(accumulators: Any, at: int, pixel_count: int, s: int, pixel_bytes: int, recipe: Any) -> None:
    """Add all frames of a set to the sums of a chunk."""
    if pixel_bytes == 1:
        _add_frames_like(_BYTES, accumulators, at, pixel_count, s, recipe)
    else:
        _add_frames_like(_WORDS, accumulators, at, pixel_count, s, recipe)


@compiled_part
def _add_frames_like(like: Any, accumulators: Any, at: int, pixel_count: int, s: int, recipe: Any) -> None:
    """Add frames eight at a time, and four that are left."""
    k, last = recipe.first[s], recipe.first[s + 1]
    while k + 8 <= last:
        frame = recipe.addresses[k : k + 8]
        _accumulate_eight_frames(
            _pixels(frame[0], at, pixel_count, like),
            _pixels(frame[1], at, pixel_count, like),
            _pixels(frame[2], at, pixel_count, like),
            _pixels(frame[3], at, pixel_count, like),
            _pixels(frame[4], at, pixel_count, like),
            _pixels(frame[5], at, pixel_count, like),
            _pixels(frame[6], at, pixel_count, like),
            _pixels(frame[7], at, pixel_count, like),
            recipe.weights[k : k + 8],
            accumulators,
            pixel_count,
        )
        k += 8
    if k < last:
        frame = recipe.addresses[k : k + 4]
        _accumulate_four_frames(
            _pixels(frame[0], at, pixel_count, like),
            _pixels(frame[1], at, pixel_count, like),
            _pixels(frame[2], at, pixel_count, like),
            _pixels(frame[3], at, pixel_count, like),
            recipe.weights[k : k + 4],
            accumulators,
            pixel_count,
        )


@compiled_part
def _fill_maps(
    maps: Any, at: int, modulation: Any, sigma: Any, common: Any, good: Any, pixel_count: int
) -> None:
    """Enter what was measured of a chunk besides coordinates, and erase what was not."""
    _copy(modulation, maps.modulation[at:], pixel_count)
    _copy(sigma, maps.sigma[at:], pixel_count)
    _copy(common, maps.phase_error[at:], pixel_count)
    for j in range(pixel_count):
        # Coordinates are known where they are measured, and where the order alone is in doubt.
        sigma[_u(j)] = good[_u(j)] if maps.cause[_u(at + j)] == 0 else _ONE
    known = sigma
    for of_known in (maps.u, maps.v, maps.sigma):
        if len(of_known) > 0:
            _erase_invalid(of_known[at:], known, pixel_count)
    for of_good in (maps.disagreement, maps.modulation, maps.phase_error):
        _erase_invalid(of_good[at:], good, pixel_count)


@compiled
def decode_pixels(recipe: Recipe, pixel_bytes: int, start: int, stop: int, maps: Maps) -> Any:
    # Releases the interpreter's lock, so that threads may share a frame's pixels.
    sets = len(recipe.origin)
    accumulators, rows = np.zeros((_SUM_ROWS + 1) * ROW, np.float32), np.empty(_UNWRAP_ROWS * ROW, np.float32)
    fusion = np.empty(FUSION_ROWS * ROW, np.float32)
    good, sigma, common = (
        np.empty(CHUNK, np.float32),
        np.empty(CHUNK, np.float32),
        np.empty(CHUNK, np.float32),
    )
    # Each set's offsets become its weights, once they are known.
    turns, modulation = np.empty((sets, ROW), np.float32), np.empty((sets, ROW), np.float32)
    weights, shares = np.empty((sets, ROW), np.float32), np.empty((sets, ROW), np.float32)
    loss, bent = np.empty(CHUNK, np.float32), np.empty(CHUNK, np.float32)
    repeated = np.zeros(CHUNK, np.float32)
    for at in range(start, stop, CHUNK):
        pixel_count = min(CHUNK, stop - at)
        good[:] = _ONE
        disagreement, freedom = maps.disagreement[at : at + pixel_count], 0
        disagreement[:] = _ZERO
        for s in range(sets):
            accumulators[: _SUM_ROWS * ROW] = _ZERO
            _add_frames(accumulators, at, pixel_count, s, pixel_bytes, recipe)
            loss[:], bent[:] = _ONE, recipe.error_constant[s]
            if _count_saturated(accumulators, pixel_count, recipe.full_scale) > _ZERO:
                _refit_saturated(accumulators, at, pixel_count, s, pixel_bytes, recipe, loss, bent)
            _demodulate(accumulators, turns[s], modulation[s], weights[s], good, pixel_count, s, recipe)
            if recipe.rounding_repeats:
                find_repeated(weights[s], repeated, recipe, pixel_count)
            rest = accumulators[_SQUARE:]
            weigh(modulation[s], weights[s], shares[s], loss, bent, repeated, rest, s, recipe, pixel_count)
        for axis in range(1, -1, -1):
            finest = recipe.finest[axis]
            if finest >= 0:
                # x comes last, so that its sigma is the one that stays.
                out = maps.u[at : at + pixel_count] if axis == 0 else maps.v[at : at + pixel_count]
                _unwrap_axis(axis, recipe, rows, turns, weights[finest], good, at, pixel_count)
                fused = (out, sigma, common, disagreement)
                count = fuse_axis(axis, recipe, rows, fusion, turns, weights, shares, pixel_count, *fused)
                freedom += count - 1
                cause = maps.cause[at : at + pixel_count]
                settle_orders(
                    axis, recipe, rows, fusion, turns, weights, shares, good, pixel_count, *fused, cause
                )
        _reduced_root_of_chi2(disagreement, freedom, pixel_count)
        _fill_maps(maps, at, modulation[recipe.reference], sigma, common, good, pixel_count)
    return accumulators[_SUM_ROWS * ROW :].max()


@compiled
def erase_doubtful(maps: Maps) -> None:
    """Erase pixels whose order is in doubt; of those `decode_pixels` keeps the coordinates."""
    cause = maps.cause
    for j in range(len(cause)):
        if cause[_u(j)] > 0:
            for values in maps[:6]:
                if len(values) > 0:
                    values[_u(j)] = np.nan
            if cause[_u(j)] == UNEXPLAINED:
                cause[_u(j)] = 0


@compiled
def read_all(addresses: Any, like: Any, start: int, stop: int) -> int:
    """Sum a range of pixels of all frames, to measure the time of reading alone."""
    # addresses (F,)
    total = 0
    for k in range(len(addresses)):
        pixels = _pixels(addresses[k], start, stop - start, like)
        for j in range(stop - start):
            total += np.uint64(pixels[_u(j)])
    return total
