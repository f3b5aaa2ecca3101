"""Compiled search of the likeliest code at every pixel, and its refinement; codes are those of a `CodeTable`.

With A and B fitted, the sum of squares that a code c leaves of a pixel's levels x is
`|x|² - (x·c)²` for codes of unit length, both without their means: the likeliest code is the one with the
greatest correlation x·c. Offset and modulation cost two of the K images.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fpplab.phase.chunks import compiled


@compiled
def _scores(levels: Any, candidates: Any, first: int, last: int, scores: Any) -> None:
    """Correlate the levels of one pixel with the candidates of a range."""
    # Slices, and four images at a time: the compiler then uses vector instructions.
    part = scores[first:last]
    part[:] = np.float32(0)
    images = len(levels)
    for k in range(0, images - 3, 4):
        w, x, y, z = levels[k], levels[k + 1], levels[k + 2], levels[k + 3]
        a, b = candidates[k, first:last], candidates[k + 1, first:last]
        c, d = candidates[k + 2, first:last], candidates[k + 3, first:last]
        for n in range(len(part)):
            part[n] += w * a[n] + x * b[n] + y * c[n] + z * d[n]
    for k in range(images - images % 4, images):
        x, b = levels[k], candidates[k, first:last]
        for n in range(len(part)):
            part[n] += x * b[n]


@compiled
def _best_in(scores: Any, first: int, last: int) -> int:
    part = scores[first:last]
    highest = part[0]
    for n in range(len(part)):
        highest = max(highest, part[n])
    for n in range(len(part)):
        if part[n] >= highest:
            return first + n
    return first


@compiled
def _lobe(scores: Any, best: int, first: int, last: int) -> tuple[int, int]:
    """Range of candidates about the best one down to the valleys beside it."""
    low = best
    while low > first and scores[low - 1] <= scores[low]:
        low -= 1
    high = best
    while high < last - 1 and scores[high + 1] <= scores[high]:
        high += 1
    return low, high + 1


@compiled
def _correlation(levels: Any, at: int, light: Any, scale: Any) -> Any:
    """Correlation with the code of a grid point, of unit length."""
    if scale[at] <= 0.0:
        return 0.0
    total = 0.0
    for k in range(len(levels)):
        total += levels[k] * light[at, k]
    return total / scale[at]


@compiled
def _climbed(levels: Any, at: int, low: int, high: int, light: Any, scale: Any) -> tuple[int, float]:
    """Grid point of the greatest correlation within a range, by steps that become shorter."""
    best, step = _correlation(levels, at, light, scale), max(1, (high - low) // 4)
    while step >= 1:
        moved = False
        for other in (at - step, at + step):
            if low <= other < high:
                value = _correlation(levels, other, light, scale)
                if value > best:
                    at, best, moved = other, value, True
        if not moved:
            step //= 2
    return at, best


@compiled
def _newton(levels: Any, at: int, best: float, light: Any, scale: Any, slope: Any) -> tuple[float, float]:
    """Distance from a grid point to the best coordinate in px, and the square of the slope there."""
    modulation = best / scale[at]
    along, square = 0.0, 0.0
    for k in range(len(levels)):
        along += slope[at, k] * levels[k]
        square += slope[at, k] * slope[at, k]
    square *= modulation * modulation
    return (along * modulation / square if square > 0.0 else 0.0), square


@compiled
def _without_mean(levels: Any, x: Any) -> tuple[float, float]:
    """Take the mean off the levels of one pixel; the mean, and the sum of squares that is left."""
    mean, power = 0.0, 0.0
    for k in range(len(x)):
        mean += levels[k]
    mean /= len(x)
    for k in range(len(x)):
        x[k] = np.float32(levels[k] - mean)
        power += x[k] * x[k]
    return mean, power


@compiled
def _refined(x: Any, c: int, first: int, last: int, scores: Any, start: Any, light: Any, scale: Any) -> float:
    """Greatest correlation about a candidate."""
    if scores[c] <= 0.0:
        return 0.0
    low, high = max(c - 1, first), min(c + 2, last)
    middle = (start[c] + start[c + 1] - 1) // 2
    return _climbed(x, middle, start[low], start[high], light, scale)[1]


@compiled
def _runner_up(
    x: Any, first: int, last: int, low: int, high: int, scores: Any, start: Any, light: Any, scale: Any
) -> float:
    """Greatest correlation elsewhere than in the lobe from `low` to `high`."""
    greatest = 0.0
    if low > first:
        other = _best_in(scores, first, low)
        greatest = _refined(x, other, first, low, scores, start, light, scale)
    if high < last:
        other = _best_in(scores, high, last)
        greatest = max(greatest, _refined(x, other, high, last, scores, start, light, scale))
    return greatest


@compiled
def _hull(scores: Any, c: int, low: int, high: int, reach: float) -> tuple[int, int]:
    """Candidates about the best one from the first to the last that noise does not exclude."""
    while low < c and (scores[low] < 0.0 or scores[low] * scores[low] < reach):
        low += 1
    while high > c + 1 and (scores[high - 1] < 0.0 or scores[high - 1] * scores[high - 1] < reach):
        high -= 1
    return low, high


@compiled
def _moments(
    x: Any, at: int, low: int, high: int, peak: float, hull: float, variance: float, table: Any
) -> tuple[float, float, float]:
    """Sum of the likelihoods over grid points, with the mean distance from one of them and its variance."""
    _, _, coordinate, light, scale, _ = table
    total, first, second = 0.0, 0.0, 0.0
    for n in range(low, high):
        value = _correlation(x, n, light, scale)
        lost = peak - value * value
        if n == at or (value > 0.0 and lost <= hull * variance):
            weight = np.exp(-0.5 * lost / variance)
            away = coordinate[n] - coordinate[at]
            total += weight
            first += weight * away
            second += weight * away * away
    first /= total
    return total, first, second / total - first * first


@compiled
def search_codes(levels: Any, used: Any, ranges: Any, table: Any, noise: Any, out: Any) -> None:
    """Find the likeliest coordinate of P pixels.

    levels (P, K) grey levels; used (P,); ranges (P, 2) of candidates; table (candidates, start, coordinate,
    light, scale, slope); noise (variance at level 0, per level, hull's χ², power of surprising
    residuals); out (P, 9) becomes coordinate, its variance, modulation, offset, misfit's χ², χ² by which the
    runner-up is worse, the ends of the interval of coordinates whose χ² is within the hull's, and the
    logarithm of the likelihood of the code at any coordinate.
    """
    candidates, start, coordinate, light, scale, slope = table
    freedom, step = max(levels.shape[1] - 3, 1), coordinate[1] - coordinate[0]
    scores, x = np.empty(candidates.shape[1], np.float32), np.empty(levels.shape[1], np.float32)
    for p in range(len(levels)):
        out[p, :] = np.nan
        first, last = ranges[p, 0], ranges[p, 1]
        if not used[p] or last <= first:
            continue
        mean, power = _without_mean(levels[p], x)
        _scores(x, candidates, first, last, scores)
        c = _best_in(scores, first, last)
        low, high = _lobe(scores, c, first, last)
        at, best = _climbed(x, (start[c] + start[c + 1] - 1) // 2, start[low], start[high], light, scale)
        if best <= 0.0:
            continue
        runner_up = _runner_up(x, first, last, low, high, scores, start, light, scale)
        shift, square = _newton(x, at, best, light, scale, slope)
        if abs(shift) > 2.0 * step:
            square = 0.0
        peak = best * best + shift * shift * square
        left, expected = max(power - peak, 0.0), noise[0] + noise[1] * mean
        # A pixel's own misfit tells its variance only where chance hardly explains it.
        variance = left / freedom if left > noise[3] * freedom * expected else expected
        begin, end = _hull(scores, c, low, high, peak - noise[2] * variance)
        lower, upper = min(start[begin], at), max(start[end], at + 1)
        total, away, spread = _moments(x, at, lower, upper, peak, noise[2], variance, table)
        spread += step * step / 12.0
        if square > 0.0 and variance / square < step * step and spread < 4.0 * step * step:
            out[p, 0], out[p, 1] = coordinate[at] + shift, variance / square
            volume = np.sqrt(2.0 * np.pi * variance / square)  # of a peak that the grid is too coarse for
        else:
            out[p, 0], out[p, 1] = coordinate[at] + away, spread
            volume = total * step
        out[p, 8] = np.log(volume) - 0.5 * min(left / expected, noise[3] * freedom)
        out[p, 2], out[p, 3] = 0.5 * best / scale[at], mean
        out[p, 4] = left / freedom / max(expected, 1e-9)
        out[p, 5] = (peak - runner_up * runner_up) / variance
        out[p, 6], out[p, 7] = coordinate[lower] - 0.5 * step, coordinate[upper - 1] + 0.5 * step
