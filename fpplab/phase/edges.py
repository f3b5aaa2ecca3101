"""What blur does where reflectivity changes: coordinates are drawn to the brighter side, and corrected.

A camera pixel sees its surroundings too, with a point spread P. Fringes of a coordinate u that changes evenly
and of a modulation B then have the phase of `u + ∇u·(Q * B) / (P * B)` with Q(t) = -t P(t), and P * B is the
modulation that is measured. A Gaussian of variance s² has Q = s² ∇P, however steep the edge, so that the
error is `s² ∇u·∇B / B` of the measured B. The point spread has a core, the lens and the pixel, and a wide
tail, light that goes round in the lens or under the surface: `Q * B = s² ∇B + t² ∇(G * B)` with a wide
Gaussian G. Projectors' blur comes before reflection and draws nothing.

s² and t² follow from the frames themselves: least squares beside smooth surfaces, in tiles spread over the
image. Their scatter from tile to tile is their uncertainty; what it may be 0 by is not corrected.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from fpplab.core.conventions import Axis, Floats, Map, Mask
from fpplab.core.robust import robust_spread
from fpplab.patterns.recording import Recording
from fpplab.phase.chunks import compiled, compiled_part
from fpplab.phase.limits import EDGES

_ROWS = 256  # rows that one thread takes at a time (chosen)
_REACH = 4  # px over which slopes of the coordinate are taken (chosen: beyond the core's reach)
_BIN = 4  # px of a pixel of the map of the tail (chosen: as the tail is wide)
_f = np.float32
_ZERO = _f(0)


@dataclass(frozen=True, eq=False)
class EdgeBlur:
    """Strengths of core and tail of the point spread, and what they cost beside edges."""

    strengths: Floats  # (2,) s² and t² in px², by which coordinates were corrected; 0 where they may be none
    covariance: Floats  # (2, 2) of them
    share: float = 0.0  # of the measured pixels whose error counts beside their noise in a mean of many
    rms_px: float = 0.0  # error at these, in projector px

    @property
    def is_corrected(self) -> bool:
        """Whether the frames tell the strengths; otherwise the uncertainty alone holds the error."""
        return bool(self.strengths.any())


def correct_edges(
    coordinates: Mapping[Axis, Map],
    modulation: Map,
    sigma: Map,
    phase_error: Map,
    recording: Recording,
    blur_px2: float,
) -> EdgeBlur | None:
    """Correct the coordinates in place, and add to the first one's error; None where there are no edges."""
    # Maps (height, width), in px but modulation. `blur_px2`: what neighbouring pixels show of the blur, 0 if
    # nothing; it is not separated from the surface's shape, so that it counts as uncertainty alone.
    frames = recording.finest()[1]
    if len(frames) == 3:  # their modulation ripples with the second harmonic of a bent response
        mean = recording.light(np.mean(frames, axis=0, dtype=_f)) * _f(recording.grey)
        modulation = np.where(np.isfinite(modulation), mean, _f(np.nan))
    places = _tiles_with_edges(modulation)
    if not places and blur_px2 == 0.0:
        return None
    light = _light(modulation, mean if len(frames) == 3 else recording.mean_image())
    tail, maps = _tail(light), list(coordinates.values())
    normal, right = _normal_equations(maps, light, modulation, tail, places)
    if not len(normal) and blur_px2 == 0.0:
        return None
    blur = _fitted(normal, right) if len(normal) >= EDGES.min_tiles else None
    if blur is None:
        blur = EdgeBlur(np.zeros(2), np.diag([max(EDGES.unknown_px2, abs(blur_px2)) ** 2, 0.0]))
    strengths = blur.strengths.astype(_f)
    spread = np.linalg.cholesky(blur.covariance + 1e-12 * np.eye(2)).astype(_f)
    before, changes = phase_error[::4, ::4].copy(), np.zeros((len(maps), *light.shape), _f)
    first, last = maps[0], maps[-1]
    work = partial(_correct, first, last, light, tail, strengths, spread, changes, phase_error)
    with ThreadPoolExecutor() as pool:
        list(pool.map(work, range(0, len(light), _ROWS)))
    for coordinate, change in zip(maps, changes, strict=True):
        np.subtract(coordinate, change, out=coordinate)
    few = sigma[::4, ::4]
    size = np.sqrt(np.square(phase_error[::4, ::4]) - np.square(before))
    if blur.is_corrected:
        size = np.abs(changes[0, ::4, ::4])
    felt = size[size > EDGES.felt_share * few]
    rms_px = float(np.sqrt(np.mean(np.square(felt)))) if felt.size else 0.0
    return replace(blur, share=felt.size / max(1, np.isfinite(few).sum()), rms_px=rms_px)


def _tiles_with_edges(modulation: Map) -> list[tuple[int, int]]:
    """First rows and columns of tiles with edges, of those that are spread over the image."""
    side = EDGES.tile_px + 2 * EDGES.margin_px
    counts = [min(EDGES.tiles_along, size // side) for size in modulation.shape]
    tops, lefts = (
        (size * (np.arange(n) + 0.5) / max(n, 1) - 0.5 * side).astype(int).tolist()
        for size, n in zip(modulation.shape, counts, strict=True)
    )
    every = ((top, left) for top in tops for left in lefts)
    return [
        (top + EDGES.margin_px, left + EDGES.margin_px)
        for top, left in every
        if _has_edges(modulation[top : top + side, left : left + side])
    ]


def _normal_equations(
    coordinates: Sequence[Map], light: Map, modulation: Map, tail: Map, places: Sequence[tuple[int, int]]
) -> tuple[Floats, Floats]:
    """Normal equations (T, 2, 2) and (T, 2) of the strengths in tiles."""

    def fits(place: tuple[int, int]) -> list[tuple[Floats, Floats]]:
        tile = np.s_[place[0] : place[0] + EDGES.tile_px, place[1] : place[1] + EDGES.tile_px]
        values = np.empty((len(coordinates), 3, EDGES.tile_px, EDGES.tile_px), _f)
        _fill_terms(coordinates[0], coordinates[-1], light, tail, *place, values)
        fits_of_tile = (_fit_tile(each, np.nan_to_num(modulation[tile])) for each in values)
        return [fit for fit in fits_of_tile if fit is not None]

    with ThreadPoolExecutor() as pool:
        fitted = [fit for fits_of_tile in pool.map(fits, places) for fit in fits_of_tile]
    normal, right = zip(*fitted, strict=True) if fitted else ((), ())
    return np.array(normal), np.array(right)


def _has_edges(modulation: Map) -> bool:
    known = modulation[::4, ::4]
    known = known[np.isfinite(known)]
    if 16 * known.size < EDGES.min_share * modulation.size:
        return False
    return bool(known.std() > EDGES.min_contrast * known.mean())


def _fitted(normal: Floats, right: Floats) -> EdgeBlur | None:
    """Strengths of all tiles together, of those terms that they determine, and their scatter."""
    # normal (T, 2, 2); right (T, 2)
    agreeing = _agreeing(normal, right)
    normal, right = normal[agreeing], right[agreeing]
    used, whole = np.array([True, True]), normal.sum(axis=0)
    while used.any():
        strengths, covariance, kept = np.zeros(2), np.zeros((2, 2)), np.ix_(used, used)
        inverse = np.linalg.pinv(whole[kept], hermitian=True)
        strengths[used] = inverse @ right.sum(axis=0)[used]
        rest = (right - normal @ strengths)[:, used]
        covariance[kept] = inverse @ (rest.T @ rest + whole[kept]) @ inverse
        ratio = strengths[used] / np.sqrt(np.diag(covariance)[used])
        clear = -stdtrit(len(right) - used.sum(), ndtr(-EDGES.significance))  # few tiles scatter little
        if ratio.min() < -clear or np.any(strengths > EDGES.max_strengths_px2):
            return None  # shapes and shadows that look like edges
        if ratio.min() > clear:
            return EdgeBlur(strengths, covariance)
        used[np.flatnonzero(used)[ratio.argmin()]] = False
    return None


def _agreeing(normal: Floats, right: Floats) -> Mask:
    """Find tiles that agree, all if few do; one over a border holds two surfaces, and tells no blur."""
    weight, inverse = np.ones(len(right)), np.linalg.pinv(normal, hermitian=True)
    for _ in range(EDGES.agreement_rounds):
        whole = np.linalg.pinv(np.tensordot(weight, normal, 1), hermitian=True)
        rest = right - normal @ (whole @ (weight @ right))
        size = np.sqrt(np.einsum("ti,tij,tj->t", rest, inverse, rest))
        weight = 1.0 / np.maximum(size, 1.0)
    spread = np.median(size) / np.sqrt(2.0 * np.log(2.0))  # of normal errors in two strengths
    agreeing = np.asarray(size < EDGES.outlier_sigmas * max(1.0, float(spread)))
    return agreeing if agreeing.mean() > EDGES.min_agreeing else np.ones_like(agreeing)


def _fit_tile(values: Map, weight: Map) -> tuple[Floats, Floats] | None:
    """Normal equations of the strengths in one tile, per variance of what they leave."""
    # values (3, side, side): the coordinate and its two terms
    used = np.isfinite(values.sum(axis=0)) & (weight > 0.0)
    for _ in range(EDGES.fit_passes):
        if used.mean() < EDGES.min_share:
            return None
        rest = np.where(used, weight * _without_surface(values, used), _ZERO).reshape(3, -1)
        products = (rest @ rest.T).astype(np.float64)
        normal, right = products[1:, 1:], products[1:, 0]
        left = np.abs(rest[0] - (np.linalg.pinv(normal, hermitian=True) @ right).astype(_f) @ rest[1:])
        count, spread = used.sum(), robust_spread(left[used.ravel()][::7])
        if left @ left / count < (EDGES.clean_ratio * spread) ** 2:
            break
        used &= left.reshape(used.shape) < EDGES.outlier_sigmas * spread
    return normal / spread**2, right / spread**2


@cache
def _polynomials() -> tuple[Map, Map, Mask]:
    """Orthonormal ones along a tile's side, their products by pairs, and which go together along both."""
    ticks = np.vander(np.linspace(-1, 1, EDGES.tile_px), EDGES.degree + 1)[:, ::-1]
    basis, orders = np.linalg.qr(ticks)[0].astype(_f), np.arange(EDGES.degree + 1)
    pairs = (basis[:, :, None] * basis[:, None]).reshape(len(basis), -1)
    return basis, pairs, np.add.outer(orders, orders) <= EDGES.degree


def _without_surface(values: Map, used: Mask) -> Map:
    """Take smooth surfaces off maps (K, side, side), fitted to what is used."""
    basis, pairs, keep = _polynomials()
    level = values - np.mean(values, axis=(1, 2), where=used, keepdims=True)
    right = (basis.T @ (np.where(used, level, _ZERO) @ basis))[:, keep]
    normal = (pairs.T @ (used.astype(_f) @ pairs)).reshape(keep.shape * 2).swapaxes(1, 2)[keep][:, keep]
    strengths = np.zeros((len(values), *keep.shape), _f)
    strengths[:, keep] = np.linalg.solve(normal, right.T).T
    return np.asarray(level - basis @ strengths @ basis.T)


def _light(modulation: Map, mean: NDArray[Any]) -> Map:
    """The modulation, and where it is not measured what the mean of the frames tells of it."""
    known = np.isfinite(modulation)
    few = known[::4, ::4]
    some, of = (each[::4, ::4][few].astype(np.float64) for each in (modulation, mean))
    ratio = some @ of / (of @ of) if some.size else 0.0
    return np.where(known, modulation, _f(ratio) * mean)


def _tail(light: Map) -> Map:
    """Gradient of the light of the wide tail, in bins: (2, height, width)."""
    height, width = (size // _BIN for size in light.shape)
    bins = cv2.resize(light[: height * _BIN, : width * _BIN], (width, height), interpolation=cv2.INTER_AREA)
    wide = cv2.GaussianBlur(bins, (0, 0), EDGES.tail_px / _BIN)
    return np.stack([cv2.Sobel(wide, -1, *by, ksize=1, scale=0.5 / _BIN) for by in ((0, 1), (1, 0))])


@compiled_part
def _slope(coordinate: Any, v: int, u: int, down: int, across: int) -> float:
    """Slope over some px, of the flatter side where both differ, as beside a jump."""
    before = coordinate[v, u] - coordinate[v - down, u - across]
    behind = coordinate[v + down, u + across] - coordinate[v, u]
    if before != before:
        before = behind
    if behind != behind:
        behind = before
    if before != before:
        return _ZERO  # type: ignore[return-value]
    lesser: float = before if abs(before) < abs(behind) else behind
    mean: float = _f(0.5) * (before + behind)
    return mean if abs(mean - lesser) < abs(lesser) else lesser


@compiled_part
def _step(light: Any, v: int, u: int, down: int, across: int) -> float:
    """Derivative of light: the harmonic mean of both differences, 0 at an extremum."""
    before = light[v, u] - light[v - down, u - across]
    behind = light[v + down, u + across] - light[v, u]
    product = before * behind
    return _f(2) * product / (before + behind) if product > _ZERO else _ZERO  # type: ignore[return-value]


@compiled_part
def _tail_at(tail: Any, k: int, v: int, u: int) -> float:
    """Gradient of the light of the tail, interpolated between bins."""
    y, x = (_f(v) + _f(0.5)) / _f(_BIN) - _f(0.5), (_f(u) + _f(0.5)) / _f(_BIN) - _f(0.5)
    row, column = min(int(y), tail.shape[1] - 2), min(int(x), tail.shape[2] - 2)
    y, x = y - _f(row), x - _f(column)
    upper = tail[k, row, column] * (_f(1) - x) + tail[k, row, column + 1] * x
    lower = tail[k, row + 1, column] * (_f(1) - x) + tail[k, row + 1, column + 1] * x
    gradient: float = upper * (_f(1) - y) + lower * y
    return gradient


@compiled_part
def _brightening(light: Any, tail: Any, v: int, u: int) -> Any:
    """Relative gradient of the light along rows and columns: two of the core's, two of the tail's."""
    core_v, core_u = _step(light, v, u, 1, 0), _step(light, v, u, 0, 1)
    own = _f(1) / light[v, u]
    return own * core_v, own * core_u, own * _tail_at(tail, 0, v, u), own * _tail_at(tail, 1, v, u)


@compiled_part
def _terms_at(coordinate: Any, brightening: Any, v: int, u: int) -> tuple[float, float]:
    """What core and tail of strength 1 add to the coordinate."""
    core_v, core_u, tail_v, tail_u = brightening
    along_v = _slope(coordinate, v, u, _REACH, 0) * _f(1 / _REACH)
    along_u = _slope(coordinate, v, u, 0, _REACH) * _f(1 / _REACH)
    return along_v * core_v + along_u * core_u, along_v * tail_v + along_u * tail_u


@compiled
def _fill_terms(
    first: Any, last: Any, light: Any, tail: Any, top: int, left: int, values: Any
) -> None:  # fmt: skip
    """Fill a tile with the coordinates and the terms of each."""
    for v in range(values.shape[2]):
        for u in range(values.shape[3]):
            at = _brightening(light, tail, top + v, left + u)
            values[0, 0, v, u] = first[top + v, left + u]
            values[0, 1, v, u], values[0, 2, v, u] = _terms_at(first, at, top + v, left + u)
            if len(values) > 1:
                values[1, 0, v, u] = last[top + v, left + u]
                values[1, 1, v, u], values[1, 2, v, u] = _terms_at(last, at, top + v, left + u)


@compiled
def _correct(
    first: Any, last: Any, light: Any, tail: Any, strengths: Any, spread: Any, changes: Any, error: Any,
    top: int,
) -> None:  # fmt: skip
    height, width = light.shape
    for v in range(max(top, _REACH), min(top + _ROWS, height - _REACH)):
        for u in range(_REACH, width - _REACH):
            if first[v, u] != first[v, u] and last[v, u] != last[v, u]:
                continue
            at = _brightening(light, tail, v, u)
            if len(changes) > 1 and last[v, u] == last[v, u]:
                core, wide = _terms_at(last, at, v, u)
                shift = strengths[0] * core + strengths[1] * wide
                if abs(shift) < _f(EDGES.max_change_px):
                    changes[1, v, u] = shift
            if first[v, u] != first[v, u]:
                continue
            core, wide = _terms_at(first, at, v, u)
            shift, left = strengths[0] * core + strengths[1] * wide, _f(EDGES.model_share)
            if abs(shift) < _f(EDGES.max_change_px):
                changes[0, v, u] = shift
            else:  # as at jumps and in the dark
                left = _f(1)
            one = spread[0, 0] * core + spread[1, 0] * wide
            other, model = spread[1, 1] * wide, left * shift
            square = error[v, u] * error[v, u] + one * one + other * other + model * model
            error[v, u] = np.sqrt(square)
