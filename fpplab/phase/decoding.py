"""Frames -> projector coordinates with mask and uncertainty. Conventions: `fpplab.core.conventions`."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import (
    TWO_PI,
    Axis,
    Floats,
    Image,
    Map,
    Mask,
    axis_length,
    full_scale,
    phase_steps,
    raw_per_grey,
)
from fpplab.core.errors import DataError
from fpplab.core.files import write_atomic
from fpplab.core.progress import Progress, no_progress
from fpplab.patterns.plan import FringeSet, Plan
from fpplab.phase.kernels import GROUP, KernelMaps, Recipe, decode_pixels
from fpplab.phase.quality import NoiseModel, coordinate_uncertainty, fit_noise, phase_uncertainty
from fpplab.phase.unwrapping import DOUBTFUL, WavelengthSequence, unwrap, vote_orders, wavelength_sequence

EDGE_MARGIN_PX = 0.05
"""How near the projector's edge, in px and besides its noise, a coordinate may come before
stripes that repeat there leave it open which of the two edges is meant."""

_BLOCK = 1 << 18
_SAMPLE_ROWS, _SAMPLE_PIXELS = 32, 16_000


@dataclass(frozen=True, eq=False)
class Wrapped:
    """One demodulated fringe set: float32 maps [v, u] in the grey levels of its frames.

    phase: of `2π stripes (u + 0.5)/W`, in [0, 2π) rad. modulation: B. offset: the mean.
    misfit: RMS of what the sinusoid leaves. peak: the greatest value in any frame.
    """

    phase: Map
    modulation: Map
    offset: Map
    misfit: Map
    peak: Map


@dataclass(frozen=True, eq=False)
class Decoded:
    """What every camera pixel saw of the projector: float32 maps [v, u], NaN where invalid.

    u, v: projector coordinates in px; all NaN (and then read-only) where the axis is not
    coded. modulation: B of the finest set of the first coded axis (x before y), in 8-bit
    grey levels. sigma: 1-sigma of that axis' coordinate in projector px. v_per_u: how many times
    greater v's sigma is than u's where both are coded, from the plan: their modulations are alike.
    disagreement: how much the fringe sets contradict one another, in units of what noise explains: the root
    of χ² per degree of freedom; 0 where nothing can contradict, None where it is not known.
    removed: uint8, by which rule of the filter (`fpplab.reconstruction.filtering.Rule`) the pixel gives no
    point, 0 by none; None without a filter. The other maps keep what was decoded there.
    """

    u: Map
    v: Map
    modulation: Map
    sigma: Map
    v_per_u: float = 1.0
    disagreement: Map | None = None
    removed: NDArray[np.uint8] | None = None

    @property
    def valid(self) -> Mask:
        """Where the pixel is measured."""
        return np.isfinite(self.sigma)

    def save(self, path: Path | str) -> None:
        """Write an NPZ file with the keys u, v, modulation, sigma, whole or not at all: `DataError`."""
        maps = {name: getattr(self, name) for name in (*_KEYS, *_OPTIONAL)}
        maps = {name: values for name, values in maps.items() if values is not None}
        write_atomic(Path(path), lambda stream: np.savez(stream, **maps, v_per_u=self.v_per_u))

    @classmethod
    def load(cls, path: Path | str) -> Decoded:
        """Read what `save` wrote; `DataError` when the file is missing, damaged or of another kind."""
        try:
            # Opened here, because on a damaged file NumPy forgets to close it.
            with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
                maps = {name: archive[name] for name in _KEYS}
                v_per_u = float(archive["v_per_u"])
                optional = {name: archive[name] for name in _OPTIONAL if name in archive}
        except FileNotFoundError:
            raise DataError(f"{path}: there is no such file; decode a session into it first") from None
        except KeyError as error:
            raise DataError(f"{path}: is no decoded measurement, {error.args[0]}") from error
        except (OSError, ValueError, EOFError, TypeError, AttributeError, zipfile.BadZipFile) as error:
            raise DataError(
                f"{path}: is damaged or no NPZ file ({error}); decode the session again"
            ) from error
        kinds = {(m.shape, m.dtype.name, m.ndim) for m in maps.values()}
        if len(kinds) != 1 or next(iter(kinds))[1:] != ("float32", 2):
            raise DataError(f"{path}: its maps must be float32 images of one size; decode the session again")
        return cls(**maps, v_per_u=v_per_u, **optional)


_KEYS, _OPTIONAL = ("u", "v", "modulation", "sigma"), ("disagreement", "removed")


def wrapped_phase(frames: Sequence[NDArray[np.generic]], fringe: FringeSet) -> Wrapped:
    """Demodulate one fringe set: `φ = atan2(Σ I_n sin δ_n, Σ I_n cos δ_n)` less the phase origin.

    frames: the set's images in order, (height, width) each, of any real type.
    Raises `DataError` when their number is not the set's steps.
    """
    if len(frames) != fringe.steps:
        raise DataError(
            f"a fringe set of {fringe.steps} steps was given {len(frames)} frames; give all, in order"
        )
    shape = np.shape(frames[0])
    s, c, mean, square = (np.zeros(shape) for _ in range(4))
    peak = np.full(shape, -np.inf)
    for frame, shift in zip(frames, phase_steps(fringe.steps), strict=True):
        level = np.asarray(frame, np.float64)
        s += np.sin(fringe.shift_sign * shift) * level
        c += np.cos(shift) * level
        mean += level / fringe.steps
        square += level**2 / fringe.steps
        np.maximum(peak, level, out=peak)
    modulation = 2.0 / fringe.steps * np.hypot(s, c)
    misfit = np.sqrt(np.maximum(square - mean**2 - modulation**2 / 2.0, 0.0))
    phase = ((np.arctan2(s, c) - fringe.phase_origin_rad) % TWO_PI).astype(np.float32)
    # Rounding to float32 must not reach the end of the half-open interval.
    phase[phase >= np.float32(TWO_PI)] = 0.0
    return Wrapped(phase, *(m.astype(np.float32) for m in (modulation, mean, misfit, peak)))


def decode(
    frames: Sequence[Image],
    plan: Plan,
    projector_size: tuple[int, int],
    bits: int = 8,
    source: str = "frames",
    progress: Progress = no_progress,
) -> Decoded:
    """Projector coordinates, modulation and uncertainty of every camera pixel.

    Parameters
    ----------
    frames: in the plan's order, uint8 or uint16 (height, width) each, memory-mapped or not.
    projector_size: (width, height) in px. bits: the camera's depth; full scale is 2^bits - 1.
    source: what the frames are called in messages.
    progress: is told the share done, 0 … 1; what it raises ends the work.

    Raises
    ------
    ConfigError: the plan does not suit the projector or cannot be unwrapped.
    DataError: the frames are not the plan's: wrong number, size, type or depth.

    The frames are read once; besides the result's maps little memory is needed.
    """
    images = _checked(frames, plan, bits, source)
    plan.check_projector(projector_size, source)
    ladders = [wavelength_sequence(plan, axis, source) for axis in plan.axes]
    noise = fit_noise(_sample(images, plan), full_scale(bits), 1.0 / raw_per_grey(bits))
    recipe = _recipe(images, plan, ladders, projector_size, bits, noise)
    shape = images[0].shape
    maps = _allocate(images[0].size, plan)
    highest = _run(recipe, images[0].dtype, images[0].size, maps, progress)
    if highest > full_scale(bits):
        raise DataError(
            f"{source}: holds values up to {highest:g}, above the full scale {full_scale(bits)} of "
            f"{bits} bits; say how many bits the camera gives"
        )
    spread_u, spread_v = recipe.spread
    v_per_u = float(spread_v / spread_u) if spread_u and spread_v else 1.0
    u, v, modulation, sigma, disagreement = (
        _shaped(m, shape) for m in (maps.u, maps.v, maps.modulation, maps.sigma, maps.disagreement)
    )
    decoded = Decoded(u, v, modulation, sigma, v_per_u, disagreement)
    if plan.order_vote is not None:
        for ladder, doubt in ((k, maps.doubt_u if k.axis == "x" else maps.doubt_v) for k in ladders):
            _repair(decoded, images, plan, ladder, projector_size, doubt)
    return decoded


def _checked(frames: Sequence[Image], plan: Plan, bits: int, source: str) -> list[Image]:
    """The frames as contiguous native arrays, or a `DataError`."""
    if len(frames) != plan.images:
        raise DataError(
            f"{source}: holds {len(frames)} frames, but the plan takes {plan.images}; give all of them"
        )
    first = frames[0]
    for n, frame in enumerate(frames):
        if frame.ndim != 2 or frame.size == 0:
            raise DataError(
                f"{source}: frame {n} has the shape {frame.shape}; a grey image (height, width) is needed"
            )
        if frame.shape != first.shape:
            raise DataError(f"{source}: frame {n} is {_size(frame)} pixels, but frame 0 is {_size(first)}")
        if frame.dtype != first.dtype:
            raise DataError(
                f"{source}: frame {n} is {frame.dtype}, but frame 0 is {first.dtype}; use one type"
            )
    if first.dtype.kind != "u" or first.dtype.itemsize > 2:
        raise DataError(f"{source}: frames are {first.dtype}; raw frames are uint8 or uint16")
    depths = (8, 8) if first.dtype.itemsize == 1 else (8, 16)
    if not depths[0] <= bits <= depths[1]:
        raise DataError(
            f"{source}: frames are {first.dtype}, which cannot hold {bits} bits; {depths[0]} to {depths[1]}"
        )
    # Views stay views, memory maps stay on the disk; only foreign byte orders and crops are copied.
    return [cast(Image, np.ascontiguousarray(f, f.dtype.newbyteorder("="))) for f in frames]


def _size(frame: Image) -> str:
    return f"{frame.shape[1]} x {frame.shape[0]}"


def _sample(images: list[Image], plan: Plan) -> list[Floats]:
    """A sparse sample of pixels of each set, (N, P): whole cache lines of a few rows."""
    height, width = images[0].shape
    rows = max(1, height // _SAMPLE_ROWS)
    columns = max(1, height // rows * width // _SAMPLE_PIXELS)
    sampled = np.stack([f[rows // 2 :: rows, ::columns].ravel() for f in images]).astype(np.float64)
    return [sampled[a:b] for a, b in pairwise(plan.set_starts)]


def _allocate(pixels: int, plan: Plan) -> KernelMaps:
    """Maps for what the plan measures; empty ones for what it does not."""
    along = {axis: pixels if axis in plan.axes else 0 for axis in ("x", "y")}
    doubt = {axis: n if plan.order_vote else 0 for axis, n in along.items()}
    sizes = (along["x"], along["y"], pixels, pixels, pixels, doubt["x"], doubt["y"])
    return KernelMaps(*(np.empty(n, np.float32) for n in sizes))


def _shaped(flat: Map, shape: tuple[int, ...]) -> Map:
    return flat.reshape(shape) if flat.size else np.broadcast_to(np.float32(np.nan), shape)


def _recipe(
    images: list[Image],
    plan: Plan,
    ladders: list[WavelengthSequence],
    size: tuple[int, int],
    bits: int,
    noise: NoiseModel,
) -> Recipe:
    """The plan, the rules and the noise as the kernel's tables."""
    addresses, weights, first = _frame_tables(images, plan, 1.0 / raw_per_grey(bits))
    rungs = [rung for ladder in ladders for rung in ladder.rungs]
    coefficients = np.zeros((len(rungs), len(plan.fringes)), np.float32)
    row = 0
    for ladder in ladders:
        for rung in ladder.rungs:
            coefficients[row, list(ladder.sets)] = rung.coefficients
            row += 1
    of_axis: dict[Axis, WavelengthSequence] = {ladder.axis: ladder for ladder in ladders}
    counts = [len(of_axis[axis].rungs) if axis in of_axis else 0 for axis in ("x", "y")]
    finest = [of_axis[axis].finest if axis in of_axis else -1 for axis in ("x", "y")]
    spread = [_spread(plan.fringes[k], size) if k >= 0 else 0.0 for k in finest]
    f32, rules = np.float32, plan.masks
    return Recipe(
        addresses=addresses,
        weights=weights,
        first=first,
        origin=np.array([f.phase_origin_rad / TWO_PI % 1.0 for f in plan.fringes], f32),
        coefficients=coefficients,
        stripes=np.array([rung.stripes for rung in rungs], f32),
        trust=np.array([t for ladder in ladders for t in ladder.trust], f32),
        rungs=np.cumsum([0, *counts]),
        finest=np.array(finest),
        length=np.array(size, f32),
        spread=np.array(spread, f32),
        reference=ladders[0].finest,
        grey=f32(1.0 / raw_per_grey(bits)),
        full_scale=f32(full_scale(bits)),
        modulation_min=f32(rules.modulation_min),
        contrast_min=f32(rules.contrast_min),
        residual_max=f32(rules.residual_max),
        # With a vote, no order is rejected before its neighbours have been heard.
        disagreement_max=f32(1.0 if plan.order_vote else rules.disagreement_max),
        seam=f32(EDGE_MARGIN_PX),
        noise_constant=f32(noise.constant),
        noise_per_level=f32(noise.per_level),
    )


def _spread(fringe: FringeSet, size: tuple[int, int]) -> float:
    """1-sigma in px of the coordinate where noise and modulation are equal."""
    sigma = phase_uncertainty(1.0, 1.0, fringe.steps)
    return float(coordinate_uncertainty(sigma, fringe.stripes, axis_length(size, fringe.axis)))


def _frame_tables(
    images: list[Image], plan: Plan, grey: float
) -> tuple[NDArray[np.uintp], NDArray[np.float32], NDArray[np.int64]]:
    """Addresses and weights of the frames, each set's padded with frames of weight zero."""
    addresses, weights, first = [], [], [0]
    for fringe, (start, end) in zip(plan.fringes, pairwise(plan.set_starts), strict=True):
        own = [image.ctypes.data for image in images[start:end]]
        shift = phase_steps(fringe.steps)
        scale = 2.0 * grey / fringe.steps
        table = np.stack(
            [
                scale * fringe.shift_sign * np.sin(shift),
                scale * np.cos(shift),
                np.full(fringe.steps, grey / fringe.steps),
            ],
            axis=1,
        )
        padding = -fringe.steps % GROUP
        addresses += own + own[:1] * padding
        weights.append(np.pad(table, ((0, padding), (0, 0))))
        first.append(len(addresses))
    return np.array(addresses, np.uintp), np.concatenate(weights).astype(np.float32), np.array(first)


def _run(
    recipe: Recipe,
    dtype: np.dtype[np.generic],
    pixels: int,
    maps: KernelMaps,
    progress: Progress,
) -> float:
    """The kernel on all processors, block by block; the greatest raw value met."""
    like, highest = np.empty(0, dtype), 0.0
    pool = ThreadPoolExecutor(_processors())
    try:
        blocks = [
            pool.submit(decode_pixels, recipe, like, start, min(start + _BLOCK, pixels), maps)
            for start in range(0, pixels, _BLOCK)
        ]
        for done, block in enumerate(as_completed(blocks), start=1):
            highest = max(highest, float(block.result()))
            progress(done / len(blocks))
    finally:
        # Workers hold bare addresses: nobody may leave before they have stopped.
        pool.shutdown(wait=True, cancel_futures=True)
    return highest


def _processors() -> int:
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def _repair(
    decoded: Decoded,
    images: list[Image],
    plan: Plan,
    ladder: WavelengthSequence,
    size: tuple[int, int],
    doubt: Map,
) -> None:
    """Let neighbours vote on doubtful orders of one axis; reject what they do not back."""
    assert plan.order_vote is not None
    coordinate = decoded.u if ladder.axis == "x" else decoded.v
    length = axis_length(size, ladder.axis)
    pixels = np.flatnonzero(np.isfinite(coordinate.ravel()) & (doubt > DOUBTFUL))
    phases = _phases_at(images, plan, ladder, pixels)
    sigma, seam = decoded.sigma.reshape(-1)[pixels] / length, EDGE_MARGIN_PX / length
    if ladder.axis == "y":
        sigma = sigma * decoded.v_per_u
    found = unwrap(phases, ladder, sigma, seam)
    other = unwrap(phases, ladder, sigma, seam, found.doubted)
    alternative = np.where(other.certain, other.position * length - 0.5, np.nan)
    period = length / plan.fringes[ladder.finest].stripes
    backed = vote_orders(coordinate, pixels, alternative, plan.order_vote.window, period)
    dropped = pixels[~backed & (doubt[pixels] > plan.masks.disagreement_max)]
    for values in (decoded.u, decoded.v, decoded.modulation, decoded.sigma, decoded.disagreement):
        if values is not None and values.flags.writeable:
            values.reshape(-1)[dropped] = np.nan


def _phases_at(
    images: list[Image], plan: Plan, ladder: WavelengthSequence, pixels: NDArray[np.int64]
) -> Floats:
    """Wrapped phases in rad of a few pixels, (K, P), in float64."""
    starts, rows = plan.set_starts, []
    for k in ladder.sets:
        frames = [images[n].reshape(-1)[pixels][None] for n in range(starts[k], starts[k + 1])]
        rows.append(wrapped_phase(frames, plan.fringes[k]).phase[0])
    return np.array(rows, np.float64)
