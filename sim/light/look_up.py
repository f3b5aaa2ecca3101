"""Looking up the light of samples in mirrors' textures, the loops that every simulated picture goes through.

The samples of a pixel mostly lie between the same mirrors. Their weights on those mirrors are therefore added
up first, in a window of a few texels, and the window is multiplied by the levels of the patterns once instead
of once for every sample.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from fpplab.core.compiled import kernel, kernel_part
from sim.mirror_spread import STEPS, TAPS

WINDOW = TAPS + 2  # texels along a side of the window in which a pixel's weights are added up

_PIXELS = 256
"""Pixels for which one thread allocates its window (chosen); a global, which numba compiles as a constant."""
_FAST = {"contract", "reassoc", "nsz"}


@numba.njit(inline="always", fastmath=_FAST, error_model="numpy")
def _interpolate_taps(
    weights: NDArray[np.float32], level: int, offset: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Interpolate the tabulated weights (TAPS,) at an offset of -0.5 to 0.5 texels."""
    step = (offset + np.float32(0.5)) * np.float32(STEPS)
    n = np.int64(step)
    share = step - np.float32(n)
    rest = np.float32(1.0) - share
    # whole, unsigned places: numba then leaves out its check for places counted from the end
    a = np.uint64((level * (STEPS + 1) + n) * TAPS)
    b = a + np.uint64(TAPS) if n < STEPS else a
    return (
        rest * weights[a] + share * weights[b],
        rest * weights[a + np.uint64(1)] + share * weights[b + np.uint64(1)],
        rest * weights[a + np.uint64(2)] + share * weights[b + np.uint64(2)],
        rest * weights[a + np.uint64(3)] + share * weights[b + np.uint64(3)],
        rest * weights[a + np.uint64(4)] + share * weights[b + np.uint64(4)],
    )


@numba.njit(inline="always", fastmath=_FAST, error_model="numpy")
def _add_row(
    window: NDArray[np.float32],
    start: np.uint64,
    weight: np.float32,
    taps: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
) -> None:
    window[start] += weight * taps[0]
    window[start + np.uint64(1)] += weight * taps[1]
    window[start + np.uint64(2)] += weight * taps[2]
    window[start + np.uint64(3)] += weight * taps[3]
    window[start + np.uint64(4)] += weight * taps[4]


@numba.njit(inline="always", fastmath=_FAST, error_model="numpy")
def _tap_slopes(
    weights: NDArray[np.float32], level: int, offset: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Differentiate `_interpolate_taps` by the offset."""
    step = (offset + np.float32(0.5)) * np.float32(STEPS)
    n = np.int64(step) if step < STEPS else np.int64(STEPS - 1)
    a = np.uint64((level * (STEPS + 1) + n) * TAPS)
    b = a + np.uint64(TAPS)
    times = np.float32(STEPS)
    return (
        times * (weights[b] - weights[a]),
        times * (weights[b + np.uint64(1)] - weights[a + np.uint64(1)]),
        times * (weights[b + np.uint64(2)] - weights[a + np.uint64(2)]),
        times * (weights[b + np.uint64(3)] - weights[a + np.uint64(3)]),
        times * (weights[b + np.uint64(4)] - weights[a + np.uint64(4)]),
    )


@numba.njit(inline="always", fastmath=_FAST, error_model="numpy")
def _add_square(
    window: NDArray[np.float32],
    start: np.uint64,
    weight: np.float32,
    across: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
    down: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
) -> None:
    _add_row(window, start, weight * down[0], across)
    _add_row(window, start + np.uint64(WINDOW), weight * down[1], across)
    _add_row(window, start + np.uint64(2 * WINDOW), weight * down[2], across)
    _add_row(window, start + np.uint64(3 * WINDOW), weight * down[3], across)
    _add_row(window, start + np.uint64(4 * WINDOW), weight * down[4], across)


@kernel_part(fastmath=_FAST, error_model="numpy")
def _empty(
    windows: NDArray[np.float32],
    sides: int,
    low: int,
    high: int,
    texels: NDArray[np.float32],
    first: int,
    circle_stride: int,
    stride: int,
    total: NDArray[np.float32],
) -> None:
    """Multiply the windows' weights by the texels below, add that to `total`, and clear the windows."""
    # windows: for each term of two neighbouring circles, `sides` of them in use. low, high: their rows with
    # weights. first: place of the first one's first texel in the flat texels, in which circles and rows
    # follow each other by the strides.
    for term in range(len(windows)):
        for side in range(sides):
            texel = first + side * circle_stride
            _add_products(windows[term, side], low, high, texels, texel, stride, total[term])
            windows[term, side, low * WINDOW : high * WINDOW] = 0


@kernel_part(fastmath=_FAST, error_model="numpy")
def _add_products(
    window: NDArray[np.float32],
    low: int,
    high: int,
    texels: NDArray[np.float32],
    first: int,
    stride: int,
    total: NDArray[np.float32],
) -> None:
    """Go row by row, for each sum is then read and written once for all columns."""
    patterns = np.uint64(len(total))
    for row in range(low, high):
        a = np.uint64(row * WINDOW)
        w0, w1, w2, w3 = (
            window[a],
            window[a + np.uint64(1)],
            window[a + np.uint64(2)],
            window[a + np.uint64(3)],
        )
        w4, w5, w6 = window[a + np.uint64(4)], window[a + np.uint64(5)], window[a + np.uint64(6)]
        t0 = np.uint64(first + row * stride)
        t1 = t0 + patterns
        t2 = t1 + patterns
        t3 = t2 + patterns
        t4 = t3 + patterns
        t5 = t4 + patterns
        t6 = t5 + patterns
        for n in range(patterns):
            near = w0 * texels[t0 + n] + w1 * texels[t1 + n] + w2 * texels[t2 + n] + w3 * texels[t3 + n]
            total[n] += near + w4 * texels[t4 + n] + w5 * texels[t5 + n] + w6 * texels[t6 + n]


@kernel(parallel=True, fastmath=_FAST, error_model="numpy")
def interpolated_light(
    textures: NDArray[np.float32],
    weights: NDArray[np.float32],
    samples: NDArray[np.float32],
    slopes: NDArray[np.float32] | None,
    begin: int,
    left: np.float32,
    top: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Look up samples between mirrors that a lens blurs; with slopes, the light's derivatives as well."""
    # textures (circles, rows, columns, patterns); weights (circles, STEPS + 1, TAPS); samples (views,
    # pixels, 4); slopes (views, pixels, 2); out (patterns, pixels that are looked up, 1 or with slopes 5)
    # Without slopes another kernel is compiled, which has none of the derivatives' instructions.
    _, rows, columns, patterns = textures.shape
    views, pixels, terms = len(samples), out.shape[1], 1 if slopes is None else 5
    texels, table = textures.reshape(-1), weights.reshape(-1)
    share, stride, reach = np.float32(1.0 / views), columns * patterns, WINDOW // 2
    for block in numba.prange((pixels + _PIXELS - 1) // _PIXELS):
        windows = np.zeros((terms, 2, WINDOW * WINDOW), np.float32)
        total = np.zeros((terms, patterns), np.float32)
        for p in range(block * _PIXELS, min((block + 1) * _PIXELS, pixels)):
            total[:] = 0
            level, column, row, first, low, high, sides = -1, 0, 0, 0, WINDOW, 0, 1
            for k in range(views):
                q = begin + p
                x, y, circle = samples[k, q, 0] - left, samples[k, q, 1] - top, samples[k, q, 2]
                i, j = int(np.floor(x + np.float32(0.5))), int(np.floor(y + np.float32(0.5)))
                inside = reach <= i < columns - reach and reach <= j < rows - reach
                if not (samples[k, q, 3] > 0 and inside):
                    continue
                if int(circle) != level or abs(i - column) > 1 or abs(j - row) > 1:
                    if level >= 0:
                        _empty(windows, sides, low, high, texels, first, rows * stride, stride, total)
                    level, column, row, low, high, sides = int(circle), i, j, WINDOW, 0, 1
                    first = ((level * rows + row - reach) * columns + column - reach) * patterns
                upper = j - row + 1
                low, high = min(low, upper), max(high, upper + TAPS)
                start = np.uint64(upper * WINDOW + i - column + 1)
                farther = circle - np.float32(level)
                sides = max(sides, 2 if farther > 0 else 1)
                for side in range(2 if farther > 0 else 1):
                    part = farther if side else np.float32(1.0) - farther
                    weight = samples[k, q, 3] * part
                    across = _interpolate_taps(table, level + side, x - np.float32(i))
                    down = _interpolate_taps(table, level + side, y - np.float32(j))
                    _add_square(windows[0, side], start, weight, across, down)
                    if slopes is not None:
                        steep = _tap_slopes(table, level + side, x - np.float32(i))
                        _add_square(windows[1, side], start, slopes[k, q, 0] * part, across, down)
                        _add_square(windows[2, side], start, slopes[k, q, 1] * part, across, down)
                        _add_square(windows[3, side], start, weight, steep, down)
                        steep = _tap_slopes(table, level + side, y - np.float32(j))
                        _add_square(windows[4, side], start, weight, across, steep)
            if level >= 0:
                _empty(windows, sides, low, high, texels, first, rows * stride, stride, total)
            for n in range(patterns):
                for c in range(terms):
                    out[n, p, c] = total[c, n] * share


@kernel(parallel=True)
def sharp_light(
    textures: NDArray[np.float32],
    samples: NDArray[np.float32],
    left: np.float32,
    top: np.float32,
    fill: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Look up samples on mirrors with sharp edges."""
    # textures (rows, columns, patterns); samples (views, pixels, 4); out (patterns, pixels)
    rows, columns, _ = textures.shape
    views, pixels, _ = samples.shape
    share = np.float32(1.0 / (views * fill * fill))
    half, reach = np.float32(0.5), np.float32(fill / 2)
    for p in numba.prange(pixels):
        for q in range(len(out)):
            out[q, p] = 0
        for k in range(views):
            x, y = samples[k, p, 0] - left, samples[k, p, 1] - top
            shade = samples[k, p, 3]
            i, j = np.floor(x + half), np.floor(y + half)
            if not (shade > 0 and 0 <= i < columns and 0 <= j < rows):
                continue
            if fill == 1 or (abs(x - i) < reach and abs(y - j) < reach):
                for q in range(len(out)):
                    out[q, p] += share * shade * textures[int(j), int(i), q]
