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

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from fpplab.core.conventions import Axis, Floats, Map, Mask
from fpplab.core.robust import robust_spread
from fpplab.patterns.recording import Recording
from fpplab.phase.chunks import compiled
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
        modulation = np.where(np.isfinite(modulation), _mean(frames, recording.grey), _f(np.nan))
    normal, right = _normal_equations(list(coordinates.values()), modulation, recording)
    if not len(normal) and blur_px2 == 0.0:
        return None
    blur = _fitted(normal, right) if len(normal) >= EDGES.min_tiles else None
    if blur is None:
        blur = EdgeBlur(np.zeros(2), np.diag([max(EDGES.unknown_px2, abs(blur_px2)) ** 2, 0.0]))
    light = _light(modulation, recording.mean_image())
    tail, strengths = _tail(light), blur.strengths.astype(_f)
    spread = np.linalg.cholesky(blur.covariance + 1e-12 * np.eye(2)).astype(_f)
    before, error, sizes = phase_error[::4, ::4].copy(), phase_error, []
    bands = [(first, min(first + _ROWS, len(light))) for first in range(0, len(light), _ROWS)]
    for coordinate in coordinates.values():
        change = np.zeros_like(coordinate)
        work = partial(_correct, coordinate, light, tail, strengths, spread, change, error)
        with ThreadPoolExecutor() as pool:
            list(pool.map(lambda band, work=work: work(*band), bands))
        np.subtract(coordinate, change, out=coordinate)
        error = np.empty((0, 0), _f)
        sizes.append(np.abs(change[::4, ::4]))
    few = sigma[::4, ::4]
    size = sizes[0] if blur.is_corrected else np.sqrt(np.square(phase_error[::4, ::4]) - np.square(before))
    felt = size[size > EDGES.felt_share * few]
    rms_px = float(np.sqrt(np.mean(np.square(felt)))) if felt.size else 0.0
    return replace(blur, share=felt.size / max(1, np.isfinite(few).sum()), rms_px=rms_px)


def _normal_equations(
    coordinates: Sequence[Map], modulation: Map, recording: Recording
) -> tuple[Floats, Floats]:
    """Normal equations (T, 2, 2) and (T, 2) of the strengths in tiles with edges."""
    frames, margin = recording.finest()[1], EDGES.margin_px
    side = EDGES.tile_px + 2 * margin
    counts = [min(EDGES.tiles_along, size // side) for size in modulation.shape]
    tops, lefts = (
        (size * (np.arange(n) + 0.5) / max(n, 1) - 0.5 * side).astype(int)
        for size, n in zip(modulation.shape, counts, strict=True)
    )
    tiles = [np.s_[top : top + side, left : left + side] for top in tops for left in lefts]

    def fits(tile: tuple[slice, slice]) -> list[tuple[Floats, Floats]]:
        if not _has_edges(modulation[tile]):
            return []
        mean = _mean([frame[tile] for frame in frames], recording.grey)
        light = _light(modulation[tile], mean)
        found = (_fit_tile(coordinate[tile], modulation[tile], light) for coordinate in coordinates)
        return [fit for fit in found if fit is not None]

    with ThreadPoolExecutor() as pool:
        fitted = [fit for found in pool.map(fits, tiles) for fit in found]
    normal, right = zip(*fitted, strict=True) if fitted else ((), ())
    return np.array(normal), np.array(right)


def _mean(frames: Sequence[NDArray[Any]], grey: float) -> Map:
    return np.asarray(np.mean(frames, axis=0, dtype=_f) * _f(grey))


def _has_edges(modulation: Map) -> bool:
    known = modulation[::4, ::4]
    known = known[np.isfinite(known)]
    if 16 * known.size < EDGES.min_share * modulation.size:
        return False
    return bool(known.std() > EDGES.min_contrast * known.mean())


def _fitted(normal: Floats, right: Floats) -> EdgeBlur | None:
    """Strengths of all tiles together, of those terms that they determine, and their scatter."""
    # normal (T, 2, 2); right (T, 2)
    used, whole = np.array([True, True]), normal.sum(axis=0)
    while used.any():
        strengths, covariance, kept = np.zeros(2), np.zeros((2, 2)), np.ix_(used, used)
        inverse = np.linalg.pinv(whole[kept], hermitian=True)
        strengths[used] = inverse @ right.sum(axis=0)[used]
        rest = (right - normal @ strengths)[:, used]
        covariance[kept] = inverse @ (rest.T @ rest + whole[kept]) @ inverse
        ratio = strengths[used] / np.sqrt(np.diag(covariance)[used])
        clear = t.isf(norm.sf(EDGES.significance), len(right) - used.sum())  # few tiles scatter little
        if ratio.min() < -clear or np.any(strengths > EDGES.max_strengths_px2):
            return None  # shapes and shadows that look like edges
        if ratio.min() > clear:
            return EdgeBlur(strengths, covariance)
        used[np.flatnonzero(used)[ratio.argmin()]] = False
    return None


def _fit_tile(coordinate: Map, modulation: Map, light: Map) -> tuple[Floats, Floats] | None:
    """Normal equations of the strengths in one tile with its margin, per variance of what they leave."""
    terms = np.zeros((2, *coordinate.shape), _f)
    _fill_terms(np.ascontiguousarray(coordinate), light, _tail(light), terms)
    inner = slice(EDGES.margin_px, -EDGES.margin_px)
    values = np.concatenate([coordinate[None], terms])[:, inner, inner]
    weight = np.nan_to_num(modulation[inner, inner])
    used = np.isfinite(values).all(axis=0) & (weight > 0.0)
    for _ in range(EDGES.fit_passes):
        if used.mean() < EDGES.min_share:
            return None
        rest, *beside = weight * _without_surface(values, used)
        a = np.stack(beside)[:, used]
        normal, right = np.einsum("ap,bp->ab", a, a), np.einsum("ap,p->a", a, rest[used])
        left = np.abs(rest - np.tensordot(np.linalg.pinv(normal, hermitian=True) @ right, beside, 1))
        spread = robust_spread(left[used][::7])
        if np.square(left[used]).mean() < (EDGES.clean_ratio * spread) ** 2:
            break
        used &= left < EDGES.outlier_sigmas * spread
    return normal / spread**2, right / spread**2


@cache
def _polynomials() -> Map:
    """Orthonormal ones along a tile's side, (side, degree + 1)."""
    ticks = np.vander(np.linspace(-1, 1, EDGES.tile_px), EDGES.degree + 1)[:, ::-1]
    return np.linalg.qr(ticks)[0].astype(_f)


def _without_surface(values: Map, used: Mask) -> Map:
    """Take smooth surfaces off maps (K, side, side); what is not used follows them."""
    basis, orders = _polynomials(), np.arange(EDGES.degree + 1)
    keep = np.add.outer(orders, orders) <= EDGES.degree
    smooth = np.broadcast_to(np.mean(values, axis=(1, 2), where=used, keepdims=True), values.shape)
    for _ in range(EDGES.fill_passes):
        filled = np.where(used, values, smooth)
        smooth = basis @ (keep * (basis.T @ (filled @ basis))) @ basis.T
    return np.asarray(values - smooth)


def _light(modulation: Map, mean: NDArray[Any]) -> Map:
    """The modulation, and where it is not measured what the mean of the frames tells of it."""
    known = np.isfinite(modulation)
    some, of = modulation[known][::7].astype(np.float64), mean[known][::7].astype(np.float64)
    ratio = some @ of / (of @ of) if some.size else 0.0
    return np.where(known, modulation, _f(ratio) * mean)


def _tail(light: Map) -> Map:
    """Gradient of the light of the wide tail, in bins: (2, height, width)."""
    height, width = (size // _BIN for size in light.shape)
    bins = cv2.resize(light[: height * _BIN, : width * _BIN], (width, height), interpolation=cv2.INTER_AREA)
    wide = cv2.GaussianBlur(bins, (0, 0), EDGES.tail_px / _BIN)
    return np.stack([cv2.Sobel(wide, -1, *by, ksize=1, scale=0.5 / _BIN) for by in ((0, 1), (1, 0))])


@compiled
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


@compiled
def _step(light: Any, v: int, u: int, down: int, across: int) -> float:
    """Derivative of light: the harmonic mean of both differences, 0 at an extremum."""
    before = light[v, u] - light[v - down, u - across]
    behind = light[v + down, u + across] - light[v, u]
    product = before * behind
    return _f(2) * product / (before + behind) if product > _ZERO else _ZERO  # type: ignore[return-value]


@compiled
def _terms_at(coordinate: Any, light: Any, tail: Any, v: int, u: int) -> tuple[float, float]:
    """What core and tail of strength 1 add to the coordinate."""
    along_v = _slope(coordinate, v, u, _REACH, 0) * _f(1 / _REACH)
    along_u = _slope(coordinate, v, u, 0, _REACH) * _f(1 / _REACH)
    core = along_v * _step(light, v, u, 1, 0) + along_u * _step(light, v, u, 0, 1)
    y, x = (_f(v) + _f(0.5)) / _f(_BIN) - _f(0.5), (_f(u) + _f(0.5)) / _f(_BIN) - _f(0.5)
    row, column = min(int(y), tail.shape[1] - 2), min(int(x), tail.shape[2] - 2)
    y, x = y - _f(row), x - _f(column)
    wide = _ZERO
    for k, slope in ((0, along_v), (1, along_u)):
        upper = tail[k, row, column] * (_f(1) - x) + tail[k, row, column + 1] * x
        lower = tail[k, row + 1, column] * (_f(1) - x) + tail[k, row + 1, column + 1] * x
        wide += slope * (upper * (_f(1) - y) + lower * y)
    own = _f(1) / light[v, u]
    return core * own, wide * own


@compiled
def _fill_terms(coordinate: Any, light: Any, tail: Any, terms: Any) -> None:
    height, width = coordinate.shape
    for v in range(_REACH, height - _REACH):
        for u in range(_REACH, width - _REACH):
            terms[0, v, u], terms[1, v, u] = _terms_at(coordinate, light, tail, v, u)


@compiled
def _correct(
    coordinate: Any, light: Any, tail: Any, strengths: Any, spread: Any, change: Any, error: Any,
    first: int, end: int,
) -> None:  # fmt: skip
    height, width = coordinate.shape
    for v in range(max(first, _REACH), min(end, height - _REACH)):
        for u in range(_REACH, width - _REACH):
            if coordinate[v, u] != coordinate[v, u]:
                continue
            core, wide = _terms_at(coordinate, light, tail, v, u)
            shift, left = strengths[0] * core + strengths[1] * wide, _f(EDGES.model_share)
            if abs(shift) < _f(EDGES.max_change_px):
                change[v, u] = shift
            else:  # as at jumps and in the dark
                left = _f(1)
            if len(error) > 0:
                one = spread[0, 0] * core + spread[1, 0] * wide
                other, model = spread[1, 1] * wide, left * shift
                square = error[v, u] * error[v, u] + one * one + other * other + model * model
                error[v, u] = np.sqrt(square)
