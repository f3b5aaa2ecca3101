"""The coordinate from all fringe sets of an axis: compiled functions on a chunk of pixels.

Once the fringe orders are known, every set gives a position of its own, `p_k = (φ_k + n_k)/s_k` with phase
φ_k in turns, order n_k and s_k stripes, and a weight `w_k`, the inverse of its variance. The coordinate is
their inverse-variance mean, which reaches the Cramér–Rao bound of all images; its variance is `1/Σ w_k`. A
set that lies further from the finest than noise explains, because its order is another or its phase is
biased, does not take part. χ² counts all sets.
"""

from typing import Any

import numpy as np
from numba import njit

from fpplab.phase.chunks import ROW, compiled_part
from fpplab.phase.limits import NOISE, ORDERS
from fpplab.phase.noise import QUANTISATION, repeated_rounding

_f, _u = np.float32, np.uintp
_ZERO, _HALF, _ONE, _TINY = _f(0), _f(0.5), _f(1), _f(1e-30)
_AGREEING = _f(ORDERS.agreeing_sigmas**2)
_ROUNDING = _f(ORDERS.rounding_turns**2)
_REST_ROUNDING = _f(ORDERS.rest_rounding)
_TWELFTH, _MIN_SPREAD = _f(QUANTISATION), _f(NOISE.min_spread)
_rounding: Any = njit(inline="always")(repeated_rounding)
# Rows of the buffer of sums: of the sets that take part, then of all.
_FUSED_MOMENT, _ALL, _ALL_MOMENT, _ALL_SQUARE = _u(ROW), _u(2 * ROW), _u(3 * ROW), _u(4 * ROW)
LEAST, CHI2 = _u(5 * ROW), _ALL_SQUARE
"""Rows that stay: the least (B/u_I)² of all sets, and χ² once the fusion is finished."""
POSITION, FINEST, DOUBT = _u(6 * ROW), _u(7 * ROW), _u(8 * ROW)
"""Rows with the position of the finest set and its weight; the last is for `fpplab.phase.wrong_order`."""
_OWN = _u(9 * ROW)
FUSION_ROWS = 10  # rows of the working buffer


@compiled_part
def find_repeated(offset: Any, repeated: Any, recipe: Any, pixel_count: int) -> None:
    """Give the part of the variance that repeats, because levels are rounded."""
    # offset (n,); repeated (n,)
    constant, per_level = recipe.noise_constant, recipe.noise_per_level
    step_squared = recipe.step * recipe.step
    per_step_squared = _ONE / step_squared
    for j in range(pixel_count):
        i = _u(j)
        spread = (constant + per_level * offset[i]) * per_step_squared - _TWELFTH
        repeated[i] = step_squared * _rounding(max(spread, _MIN_SPREAD))


@compiled_part
def weigh(
    modulation: Any,
    offset: Any,
    share: Any,
    loss: Any,
    bent: Any,
    repeated: Any,
    rest: Any,
    s: int,
    recipe: Any,
    pixel_count: int,
) -> None:
    """Turn the offsets of one set into its weights, the inverse variances of its positions."""
    # The variance is that of noise and that of the errors that all pixels of one phase share. Where nothing
    # tells the second, noise alone counts. Where a pixel's images contradict a sinusoid by more than all of
    # these explain, its variance is that of its own residuals.
    # modulation (n,); offset (n,); share (n,); loss (n,); bent (n,); repeated (n,); rest (n,)
    constant, per_level = recipe.noise_constant, recipe.noise_per_level
    noise, rising = recipe.phase_noise[s], recipe.error_rising[s]
    square = recipe.set_stripes[s] * recipe.set_stripes[s]
    per_freedom, surprising, explained = recipe.misfit[s, 0], recipe.misfit[s, 1], recipe.misfit[s, 2]
    for j in range(pixel_count):
        i = _u(j)
        power, level = modulation[i] * modulation[i], offset[i]
        variance, observed = constant + per_level * level, per_freedom * rest[i]
        expected = surprising * (variance + explained * power) + _REST_ROUNDING * (level * level + power)
        excess = observed - variance if observed > expected else _ZERO
        own = noise * loss[i] * (variance - repeated[i]) + _ROUNDING * power + _TINY
        common = noise * (loss[i] * (repeated[i] + rising * level * level + excess) + bent[i] * power)
        per_total = _ONE / (own + max(_ZERO, common))
        share[i] = own * per_total
        offset[i] = square * power * per_total


@compiled_part
def _start_fusion(sums: Any, positions: Any, finest: Any, share: Any, unit: Any, pixel_count: int) -> None:
    """Begin with the finest set, from whose position all others are counted."""
    per_unit = _ONE / unit
    for j in range(pixel_count):
        i = _u(j)
        sums[i] = sums[i + _ALL] = sums[i + FINEST] = finest[i]
        sums[i + POSITION] = positions[i]
        sums[i + _OWN] = finest[i] * share[i]
        sums[i + LEAST] = finest[i] * per_unit
        sums[i + _FUSED_MOMENT] = sums[i + _ALL_MOMENT] = sums[i + _ALL_SQUARE] = _ZERO


@compiled_part
def _add_set(
    sums: Any, turns: Any, weights: Any, share: Any, stripes: Any, unit: Any, pixel_count: int
) -> None:
    """Add another set, in the order that brings it nearest to the finest one."""
    period, per_unit = _ONE / stripes, _ONE / unit
    for j in range(pixel_count):
        i = _u(j)
        w, of_finest = weights[i], sums[i + FINEST]
        off = turns[i] - sums[i + POSITION] * stripes
        off = (off - np.floor(off + _HALF)) * period
        moment = w * off
        square = moment * off
        # The difference of two positions has the variance 1/w + 1/w_finest.
        agrees = square * of_finest <= _AGREEING * (w + of_finest)
        sums[i] += w if agrees else _ZERO
        sums[i + _OWN] += w * share[i] if agrees else _ZERO
        sums[i + _FUSED_MOMENT] += moment if agrees else _ZERO
        sums[i + _ALL] += w
        sums[i + _ALL_MOMENT] += moment
        sums[i + _ALL_SQUARE] += square
        sums[i + LEAST] = min(sums[i + LEAST], w * per_unit)
        turns[i] = off


@compiled_part
def _finish_fusion(
    sums: Any, length: Any, pixel_count: int, coordinate: Any, sigma: Any, common: Any, chi2: Any
) -> None:
    """Write the coordinate and its uncertainties, and add the axis' χ²."""
    for j in range(pixel_count):
        i = _u(j)
        weight = max(sums[i], _TINY)
        variance = _ONE / weight
        coordinate[i] = (sums[i + POSITION] + sums[i + _FUSED_MOMENT] * variance) * length - _HALF
        own = sums[i + _OWN] * variance
        sigma[i] = length * np.sqrt(own * variance)
        common[i] = length * np.sqrt((_ONE - min(own, _ONE)) * variance)
        moment = sums[i + _ALL_MOMENT]
        of_axis = max(sums[i + _ALL_SQUARE] - moment * moment / max(sums[i + _ALL], _TINY), _ZERO)
        sums[i + CHI2] = of_axis
        chi2[i] += of_axis


@compiled_part
def _weight_at_unit_noise(recipe: Any, s: int) -> Any:
    """Weight of a set's position where u_I/B is one."""
    return recipe.set_stripes[s] * recipe.set_stripes[s] / recipe.phase_noise[s]


@compiled_part
def fuse_axis(
    axis: int,
    recipe: Any,
    rows: Any,
    sums: Any,
    turns: Any,
    weights: Any,
    shares: Any,
    pixel_count: int,
    coordinate: Any,
    sigma: Any,
    common: Any,
    chi2: Any,
) -> int:
    # turns (S, n); weights, shares (S, n); coordinate, sigma, common (n,) px; chi2 (n,)
    finest, count = recipe.finest[axis], 0
    _start_fusion(
        sums, rows, weights[finest], shares[finest], _weight_at_unit_noise(recipe, finest), pixel_count
    )
    for s in range(len(recipe.axis)):
        count += recipe.axis[s] == axis
        if recipe.axis[s] == axis and s != finest:
            stripes, unit = recipe.set_stripes[s], _weight_at_unit_noise(recipe, s)
            _add_set(sums, turns[s], weights[s], shares[s], stripes, unit, pixel_count)
    _finish_fusion(sums, recipe.length[axis], pixel_count, coordinate, sigma, common, chi2)
    return count
