"""Compiled decoder, one pass over the pixels: frames -> phase, modulation, coordinate, uncertainty, mask.

The code is written for the processor's cache and vector units. A chunk of pixels is small enough that its
sums stay in the cache while every frame is read once, four frames at a time; all
sums lie in ONE buffer at constant distances, because only then can the compiler
prove that they do not overlap and use vector instructions; constants are float32,
because one float64 among them would halve the vectors; there are no branches, and
what is not measured becomes NaN at the very end. Phases are counted in turns.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import carray, njit, types  # type: ignore[attr-defined]
from numba.extending import intrinsic
from numpy.typing import NDArray

from fpplab.phase.noise import LEAST_SPREAD, QUANTISATION, repeated_rounding
from fpplab.phase.saturation import fit_unsaturated

CHUNK = 2048
"""Pixels whose sums are kept in the cache at a time."""

GROUP = 4
"""Frames summed per visit of a chunk; every set's list of frames is padded to a multiple."""

EDGE_SIGMAS = 1.5
"""How many standard deviations of its noise a coordinate may lie beyond the projector's edge."""

APART = 9.0
"""Least difference of χ² by which two hypotheses are distinguished."""

APART_LEAST = 1e-5
"""Least difference of their costs, the weighted sums of squared disagreements in periods, which rounding
does not reach.
"""

_f = np.float32
_u = np.uintp
_ZERO, _QUARTER, _HALF, _ONE = _f(0), _f(0.25), _f(0.5), _f(1)
_TINY, _FAR = _f(1e-30), _f(100)
_TWELFTH, _LEAST_SPREAD = _f(QUANTISATION), _f(LEAST_SPREAD)
_SIGMAS, _APART, _APART_LEAST = _f(EDGE_SIGMAS), _f(APART), _f(APART_LEAST)

# Rows lie a little more than a chunk apart: at multiples of a memory page the processor
# takes a row's element for the one it has just stored in another row, and waits.
_ROW = CHUNK + 48
# Rows of the buffer of sums, at constant distances.
_COS, _MEAN, _SQUARE, _PEAK = _u(_ROW), _u(2 * _ROW), _u(3 * _ROW), _u(4 * _ROW)
_SUM_ROWS = 5
# … and behind them the greatest raw values of all sets and chunks, which are never cleared.
_HIGHEST = _u(_SUM_ROWS * _ROW)
# Rows of the buffer of unwrapping: two hypotheses of position, cost and worst disagreement.
_COST, _WORST = _u(_ROW), _u(2 * _ROW)
_OTHER, _OTHER_COST, _OTHER_WORST, _PHASE = _u(3 * _ROW), _u(4 * _ROW), _u(5 * _ROW), _u(6 * _ROW)
_UNWRAP_ROWS = 7


def _arctangent() -> tuple[np.float32, ...]:
    """Coefficients in z = q² of atan(q)/(2π q) on [0, 1]: interpolation at Chebyshev's nodes.

    Degree 9 leaves 4e-9 rad, so that the rounding of float32 alone limits the phase.
    """

    def function(z: NDArray[np.float64]) -> NDArray[np.float64]:
        q = np.sqrt(z)
        return np.asarray(np.arctan(q) / (2 * np.pi * q))

    series: Any = np.polynomial.Chebyshev.interpolate(  # type: ignore[no-untyped-call]
        function, 9, domain=[0, 1]
    )
    return tuple(np.float32(c) for c in series.convert(kind=np.polynomial.Polynomial).coef)


_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9 = _arctangent()


class Recipe(NamedTuple):
    """Everything that the compiled decoder needs to know about frames, plan, rules and noise.

    F is the padded number of frames, S of fringe sets, R of synthetic wavelengths over both axes.

    Attributes
    ----------
    addresses : ndarray of uintp, (F,)
        Address of every frame's first pixel.
    weights : ndarray of float32, (F, 3)
        Weights of every frame for sine, cosine and mean, with the grey scale in them.
    first : ndarray of int64, (S + 1,)
        Where each set starts among the F frames.
    origin : ndarray of float32, (S,)
        Phase origin of each set, in turns.
    coefficients : ndarray of float32, (R, S)
        Integer combination of phases of each synthetic wavelength, x's before y's, coarse to fine.
    stripes : ndarray of float32, (R,)
        Stripes of each synthetic wavelength.
    trust : ndarray of float32, (R,)
        Weight of each wavelength's squared disagreement with the one before, see `WavelengthSequence.trust`.
    wavelengths : ndarray of int64, (3,)
        Where each axis starts among the R wavelengths.
    finest : ndarray of int64, (2,)
        The set that gives each axis its coordinate, -1 if none.
    length : ndarray of float32, (2,)
        Projector width and height in px.
    spread : ndarray of float32, (2,)
        Standard uncertainty of each axis' coordinate in px per unit of u_I/B.
    reference : int
        The set whose modulation is reported.
    grey : float32
        8-bit grey levels per raw unit.
    full_scale : float32
        Raw value from which on a sample is saturated.
    modulation_min, contrast_min, residual_max, disagreement_max : float32
        As in `MaskRules`, in 8-bit grey levels.
    edge_margin : float32
        How far beyond the projector's edge a coordinate may lie besides its noise, in px.
    noise_constant, noise_per_level : float32
        Variance of a grey level, `noise_constant + noise_per_level * level`, in 8-bit grey levels squared.
    step : float32
        Smallest difference of two levels, in 8-bit grey levels.
    images : ndarray of float32, (S,)
        Number of images of each set.
    error_constant, error_harmonic, error_rising : ndarray of float32, (S,)
        Mean square phase error that is common to the pixels of a phase, `constant + rising (A/B)²` of offset
        and modulation, where the variance of the phase for u_I = B is one; `error_harmonic` is the part of
        the constant that is the response's. NaN where nothing tells it.
    harmonics : ndarray of float32, (S, K)
        Harmonics of the response from the second on, as shares of the fringe.
    shift : ndarray of float32, (F, 2)
        Cosine and sine of every frame's phase shift; both 0 for padding.
    """

    addresses: NDArray[np.uintp]
    weights: NDArray[np.float32]
    first: NDArray[np.int64]
    origin: NDArray[np.float32]
    coefficients: NDArray[np.float32]
    stripes: NDArray[np.float32]
    trust: NDArray[np.float32]
    wavelengths: NDArray[np.int64]
    finest: NDArray[np.int64]
    length: NDArray[np.float32]
    spread: NDArray[np.float32]
    reference: int
    grey: np.float32
    full_scale: np.float32
    modulation_min: np.float32
    contrast_min: np.float32
    residual_max: np.float32
    disagreement_max: np.float32
    edge_margin: np.float32
    noise_constant: np.float32
    noise_per_level: np.float32
    step: np.float32
    images: NDArray[np.float32]
    error_constant: NDArray[np.float32]
    error_harmonic: NDArray[np.float32]
    error_rising: NDArray[np.float32]
    harmonics: NDArray[np.float32]
    shift: NDArray[np.float32]


class Maps(NamedTuple):
    """Flat float32 maps of the camera's P pixels that the compiled decoder fills.

    An empty map of `u`, `v`, `doubt_u` or `doubt_v` is left out.

    Attributes
    ----------
    u, v : ndarray of float32, (P,)
        Projector coordinates in px, NaN where the pixel is not measured.
    modulation : ndarray of float32, (P,)
        Fringe amplitude B of the reference set, in 8-bit grey levels.
    sigma : ndarray of float32, (P,)
        Standard uncertainty of the coordinate of the first coded axis by noise, in px.
    phase_error : ndarray of float32, (P,)
        The same by errors that are common to the pixels of a phase.
    disagreement : ndarray of float32, (P,)
        Disagreement of the fringe sets: the root of χ² per degree of freedom.
    doubt_u, doubt_v : ndarray of float32, (P,)
        Greatest disagreement of the chosen hypothesis along each axis, in periods.
    """

    u: NDArray[np.float32]
    v: NDArray[np.float32]
    modulation: NDArray[np.float32]
    sigma: NDArray[np.float32]
    phase_error: NDArray[np.float32]
    disagreement: NDArray[np.float32]
    doubt_u: NDArray[np.float32]
    doubt_v: NDArray[np.float32]


rounding = njit(inline="always")(repeated_rounding)

# NaN and infinity keep their meaning: only what cannot hide them is relaxed.
_compiled = njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


@intrinsic
def _pointer(_typing: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.voidptr(types.uintp), generate


@_compiled
def _pixels(address: Any, start: int, n: int, like: Any) -> Any:
    """`n` pixels of a frame from its `start`th on, as an array of the type of `like`."""
    at: Any = address + _u(start * like.itemsize)
    return carray(_pointer(at), (n,), like.dtype)  # type: ignore[call-arg]


@_compiled
def _add_four(a: Any, b: Any, c: Any, d: Any, weights: Any, sums: Any, n: int) -> None:
    s0, s1, s2, s3 = weights[0, 0], weights[1, 0], weights[2, 0], weights[3, 0]
    c0, c1, c2, c3 = weights[0, 1], weights[1, 1], weights[2, 1], weights[3, 1]
    m0, m1, m2, m3 = weights[0, 2], weights[1, 2], weights[2, 2], weights[3, 2]
    for j in range(n):
        i = _u(j)
        x, y, z, w = _f(a[i]), _f(b[i]), _f(c[i]), _f(d[i])
        mx, my, mz, mw = m0 * x, m1 * y, m2 * z, m3 * w
        sums[i] += s0 * x + s1 * y + s2 * z + s3 * w
        sums[i + _COS] += c0 * x + c1 * y + c2 * z + c3 * w
        sums[i + _MEAN] += mx + my + mz + mw
        sums[i + _SQUARE] += mx * x + my * y + mz * z + mw * w
        sums[i + _PEAK] = max(sums[i + _PEAK], x, y, z, w)


@_compiled
def _turns(s: Any, c: Any) -> Any:
    """atan2(s, c)/2π in [0, 1] in float32, without a branch; see `_arctangent`."""
    a, b = abs(s), abs(c)
    q = min(a, b) / max(a, b, _TINY)
    z = q * q
    p = _C5 + z * (_C6 + z * (_C7 + z * (_C8 + z * _C9)))
    p = q * (_C0 + z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * p)))))
    p = _QUARTER - p if a > b else p
    p = _HALF - p if c < _ZERO else p
    return _ONE - p if s < _ZERO else p


@_compiled
def _demodulate(
    sums: Any, turns: Any, modulation: Any, offset: Any, good: Any, n: int, origin: Any, recipe: Any
) -> None:
    """Compute phase, modulation and offset of one set, its masks, and the greatest raw values so far."""
    grey, full = recipe.grey, recipe.full_scale
    least, contrast = recipe.modulation_min, recipe.contrast_min
    misfit = recipe.residual_max * recipe.residual_max
    for j in range(n):
        i = _u(j)
        s, c, mean = sums[i], sums[i + _COS], sums[i + _MEAN]
        power = s * s + c * c
        b = np.sqrt(power)
        p = _turns(s, c) - origin
        # What of the mean square is neither offset nor fringe is misfit (Parseval).
        rest = sums[i + _SQUARE] * grey - mean * mean - _HALF * power
        kept = good[i]
        kept = kept if b >= least else _ZERO
        kept = kept if b >= contrast * mean else _ZERO
        kept = kept if rest <= misfit * power else _ZERO
        kept = kept if sums[i + _PEAK] < full else _ZERO
        turns[i] = p - np.floor(p)
        modulation[i] = b
        offset[i] = mean
        good[i] = kept if b > _ZERO else _ZERO
        sums[i + _HIGHEST] = max(sums[i + _HIGHEST], sums[i + _PEAK])


@_compiled
def _combined_phase(rows: Any, turns: Any, coefficients: Any, n: int) -> None:
    """Combine measured phases into the wrapped phase of a synthetic wavelength, in turns."""
    for j in range(n):
        rows[_u(j) + _PHASE] = _ZERO
    for s in range(len(coefficients)):
        k = coefficients[s]
        if k != _ZERO:
            measured = turns[s]
            for j in range(n):
                i = _u(j)
                rows[i + _PHASE] += k * measured[i]
    for j in range(n):
        i = _u(j)
        rows[i + _PHASE] -= np.floor(rows[i + _PHASE])


@_compiled
def _start(rows: Any, n: int, stripes: Any) -> None:
    """Start both hypotheses: the base as measured, and one turn less or more, whichever is nearer."""
    period = _ONE / stripes
    for j in range(n):
        i = _u(j)
        p = rows[i + _PHASE] * period
        rows[i] = p
        rows[i + _OTHER] = p - period if rows[i + _PHASE] > _HALF else p + period
        rows[i + _COST] = rows[i + _WORST] = rows[i + _OTHER_COST] = rows[i + _OTHER_WORST] = _ZERO


@_compiled
def _refine(rows: Any, n: int, stripes: Any, trust: Any) -> None:
    """Take both hypotheses to the next finer wavelength; disagreement is counted in its periods."""
    period = _ONE / stripes
    for j in range(n):
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


@_compiled
def _saturated(sums: Any, n: int, full: Any) -> Any:
    """How many pixels have saturated samples; a sum, which unlike the maximum becomes vector instructions."""
    count = _ZERO
    for j in range(n):
        count += _ONE if sums[_u(j) + _PEAK] >= full else _ZERO
    return count


@_compiled
def _refit_saturated(
    sums: Any, at: int, n: int, s: int, like: Any, recipe: Any, loss: Any, bent: Any
) -> None:
    """Put least squares of the unsaturated samples in place of the sums of pixels with saturated ones."""
    first, last, full, grey = recipe.first[s], recipe.first[s + 1], recipe.full_scale, recipe.grey
    count = last - first
    levels, fitted = np.empty(count, np.float32), np.empty(6, np.float64)
    cosine, sine = recipe.shift[first:last, 0], recipe.shift[first:last, 1]
    for j in range(n):
        i = _u(j)
        if sums[i + _PEAK] < full:
            continue
        sums[i + _HIGHEST] = max(sums[i + _HIGHEST], sums[i + _PEAK])
        for k in range(count):
            levels[k] = _f(_pixels(recipe.addresses[first + k], at + j, 1, like)[0])
        if fit_unsaturated(levels, cosine, sine, full, recipe.harmonics[s], fitted):
            offset, c, q = grey * fitted[0], grey * fitted[1], grey * fitted[2]
            rest = grey * grey * fitted[3]
            sums[i], sums[i + _COS], sums[i + _MEAN] = _f(q), _f(c), _f(offset)
            sums[i + _SQUARE] = _f((rest + offset * offset + 0.5 * (c * c + q * q)) / grey)
            sums[i + _PEAK] = _ZERO
            loss[i] = _f(fitted[4])
            # The gains of the lamp count as noise does; the harmonics are those of these samples.
            lamp = recipe.error_constant[s] - recipe.error_harmonic[s]
            bent[i] = _f(lamp * fitted[4] + 0.5 * recipe.images[s] * fitted[5] * fitted[5])


@_compiled
def _uncertainty(
    modulation: Any,
    offset: Any,
    loss: Any,
    bent: Any,
    rising: Any,
    spread: Any,
    recipe: Any,
    out: Any,
    common: Any,
    total: Any,
    n: int,
) -> None:
    """Compute 1-sigma of a coordinate in px, `spread * u_I/B`: by noise, by common errors, by both."""
    constant, per_level = recipe.noise_constant, recipe.noise_per_level
    squared = recipe.step * recipe.step
    per_squared = _ONE / squared
    for j in range(n):
        i = _u(j)
        level, b = offset[i], max(modulation[i], _TINY)
        per_b = spread / b
        variance = constant + per_level * level
        repeated = squared * rounding(max(variance * per_squared - _TWELFTH, _LEAST_SPREAD))
        lost = loss[i] * per_b * per_b
        own = lost * (variance - repeated)
        shared = lost * (repeated + rising * level * level) + spread * spread * bent[i]
        out[i] = np.sqrt(own)
        common[i] = np.sqrt(shared)
        # Where nothing tells the common errors, noise alone judges orders.
        total[i] = np.sqrt(own + max(_ZERO, shared))


@_compiled
def _choose(
    rows: Any, sigma: Any, good: Any, n: int, length: Any, stripes: Any, recipe: Any, out: Any
) -> None:
    """Choose the hypothesis that lies in the projector and agrees better; write the coordinate in px."""
    edge_margin, share = recipe.edge_margin, recipe.disagreement_max
    apart = _APART * (stripes / length) * (stripes / length)
    for j in range(n):
        i = _u(j)
        tolerance = (edge_margin + _SIGMAS * sigma[i]) / length
        a, b = rows[i], rows[i + _OTHER]
        out_a = max(-a, a - _ONE, _ZERO)
        out_b = max(-b, b - _ONE, _ZERO)
        far_a = _FAR + out_a if out_a > tolerance else _ZERO
        far_b = _FAR + out_b if out_b > tolerance else _ZERO
        cost_a, cost_b = rows[i + _COST] + far_a, rows[i + _OTHER_COST] + far_b
        worst_a, worst_b, kept = rows[i + _WORST], rows[i + _OTHER_WORST], good[i]
        position = b if cost_b < cost_a else a
        worst = worst_b if cost_b < cost_a else worst_a
        far = far_b if cost_b < cost_a else far_a
        kept = kept if worst <= share else _ZERO
        kept = kept if far == _ZERO else _ZERO
        # Where one of them is far their costs differ by far more than this.
        least = max(_APART_LEAST, apart * sigma[i] * sigma[i])
        good[i] = kept if abs(cost_a - cost_b) > least else _ZERO
        rows[i + _WORST] = worst
        rows[i + _COST] = min(cost_a, cost_b)
        out[i] = position * length - _HALF


@_compiled
def _axis(axis: int, recipe: Any, rows: Any, turns: Any, sigma: Any, good: Any, n: int, out: Any) -> None:
    """Unwrap one axis and write its coordinate."""
    first, last = recipe.wavelengths[axis], recipe.wavelengths[axis + 1]
    _combined_phase(rows, turns, recipe.coefficients[first], n)
    _start(rows, n, recipe.stripes[first])
    for r in range(first + 1, last):
        _combined_phase(rows, turns, recipe.coefficients[r], n)
        _refine(rows, n, recipe.stripes[r], recipe.trust[r])
    _choose(rows, sigma, good, n, recipe.length[axis], recipe.stripes[last - 1], recipe, out)


@_compiled
def _add_disagreement(rows: Any, sigma: Any, n: int, period: Any, out: Any) -> None:
    """χ² of the chosen hypothesis: its cost in units of the finest phase's variance."""
    for j in range(n):
        i = _u(j)
        turns = sigma[i] / period
        out[i] += rows[i + _COST] / (turns * turns)


@_compiled
def _reduce(out: Any, freedom: int, n: int) -> None:
    """χ² to the root of its share per degree of freedom."""
    share = _f(1.0 / max(freedom, 1))
    for j in range(n):
        i = _u(j)
        out[i] = np.sqrt(out[i] * share)


@_compiled
def _erase(out: Any, good: Any, n: int) -> None:
    """NaN where a pixel is not measured."""
    for j in range(n):
        i = _u(j)
        out[i] = out[i] if good[i] > _ZERO else _f(np.nan)


@_compiled
def decode_pixels(recipe: Any, like: Any, start: int, stop: int, maps: Any) -> Any:
    """Fill the maps for a range of pixels.

    Releases the interpreter's lock, so that threads may share a frame's pixels.

    Parameters
    ----------
    recipe : Recipe
        Frames, plan, rules and noise.
    like : ndarray
        An empty array of the frames' type.
    start, stop : int
        The range of flat pixel indices.
    maps : Maps
        Filled in place, between `start` and `stop`.

    Returns
    -------
    float32
        The greatest raw value in these pixels of all frames.
    """
    sets = len(recipe.origin)
    sums, rows = np.zeros((_SUM_ROWS + 1) * _ROW, np.float32), np.empty(_UNWRAP_ROWS * _ROW, np.float32)
    good, sigma = np.empty(CHUNK, np.float32), np.empty(CHUNK, np.float32)
    own, common = np.empty(CHUNK, np.float32), np.empty(CHUNK, np.float32)
    turns, modulation, offset, loss, bent = (
        np.empty((sets, _ROW), np.float32),
        np.empty((sets, _ROW), np.float32),
        np.empty((sets, _ROW), np.float32),
        np.empty((sets, _ROW), np.float32),
        np.empty((sets, _ROW), np.float32),
    )
    for at in range(start, stop, CHUNK):
        n = min(CHUNK, stop - at)
        good[:] = _ONE
        disagreement, freedom = maps.disagreement[at : at + n], 0
        disagreement[:] = _ZERO
        for s in range(sets):
            sums[: _SUM_ROWS * _ROW] = _ZERO
            for k in range(recipe.first[s], recipe.first[s + 1], 4):
                frame = recipe.addresses[k : k + 4]
                _add_four(
                    _pixels(frame[0], at, n, like),
                    _pixels(frame[1], at, n, like),
                    _pixels(frame[2], at, n, like),
                    _pixels(frame[3], at, n, like),
                    recipe.weights[k : k + 4],
                    sums,
                    n,
                )
            loss[s], bent[s] = _ONE, recipe.error_constant[s]
            if _saturated(sums, n, recipe.full_scale) > _ZERO:
                _refit_saturated(sums, at, n, s, like, recipe, loss[s], bent[s])
            _demodulate(sums, turns[s], modulation[s], offset[s], good, n, recipe.origin[s], recipe)
        for axis in range(1, -1, -1):
            finest = recipe.finest[axis]
            if finest >= 0:
                # x comes last, so that its sigma is the one that stays.
                _uncertainty(
                    modulation[finest],
                    offset[finest],
                    loss[finest],
                    bent[finest],
                    recipe.error_rising[finest],
                    recipe.spread[axis],
                    recipe,
                    own,
                    common,
                    sigma,
                    n,
                )
                out = maps.u[at : at + n] if axis == 0 else maps.v[at : at + n]
                _axis(axis, recipe, rows, turns, sigma, good, n, out)
                count = recipe.wavelengths[axis + 1] - recipe.wavelengths[axis]
                period = recipe.length[axis] / recipe.stripes[recipe.wavelengths[axis + 1] - 1]
                _add_disagreement(rows, sigma, n, period, disagreement)
                freedom += count - 1
                doubt = maps.doubt_u if axis == 0 else maps.doubt_v
                if len(doubt) > 0:
                    doubt[at : at + n] = rows[2 * _ROW : 2 * _ROW + n]
        maps.modulation[at : at + n] = modulation[recipe.reference, :n]
        maps.sigma[at : at + n] = own[:n]
        maps.phase_error[at : at + n] = common[:n]
        if len(maps.u) > 0:
            _erase(maps.u[at : at + n], good, n)
        if len(maps.v) > 0:
            _erase(maps.v[at : at + n], good, n)
        _reduce(disagreement, freedom, n)
        _erase(disagreement, good, n)
        _erase(maps.modulation[at : at + n], good, n)
        _erase(maps.sigma[at : at + n], good, n)
        _erase(maps.phase_error[at : at + n], good, n)
    return sums[_SUM_ROWS * _ROW :].max()


@_compiled
def read_all(addresses: Any, like: Any, start: int, stop: int) -> int:
    """Sum a range of pixels of all frames, to measure the time of reading alone.

    Parameters
    ----------
    addresses : ndarray of uintp, (F,)
        Address of every frame's first pixel.
    like : ndarray
        An empty array of the frames' type.
    start, stop : int
        The range of flat pixel indices.

    Returns
    -------
    int
        The sum.
    """
    total = 0
    for k in range(len(addresses)):
        pixels = _pixels(addresses[k], start, stop - start, like)
        for j in range(stop - start):
            total += np.uint64(pixels[_u(j)])
    return total
