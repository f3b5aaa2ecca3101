"""Maps of the projector's coordinates that another program decoded, in files of arrays."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.archives import array_head, load_arrays
from fpplab.core.conventions import Axis, Floats
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import no_such_file, open_regular
from fpplab.core.foreign import read_apart
from fpplab.core.robust import robust_spread
from fpplab.phase.decoded import Decoded

MIN_SIDE = 16  # of a map in px (chosen: an array that is smaller is a parameter)
MAX_SHARE_OUTSIDE = 0.01
"""Of the pixels, beyond the projector's picture. Chosen: wrong units or periods put most of them there."""
SUFFIXES = (".npy", ".npz", ".mat", ".tif", ".tiff")


@dataclass(frozen=True)
class PhaseMapSource:
    """Files of maps, and what their values mean."""

    projector_size: tuple[int, int]  # (width, height) px
    x: Path | None = None  # along the projector's rows
    y: Path | None = None  # along its columns
    period_px: float | None = None  # of the fringes, where values are phases in rad; else they are px
    sigma_px: float | None = None  # 1-sigma of the coordinates; by default measured from the maps


@dataclass(frozen=True, eq=False)
class ImportedMaps:
    """Coordinates as the pipeline takes them, and what was done to get them."""

    decoded: Decoded
    notes: tuple[str, ...]


def import_phase_maps(source: PhaseMapSource) -> ImportedMaps:
    """Read maps; pixels that are not finite, exactly 0 or just outside of the projector are not measured."""
    # A phase of 0 is at the left and upper edge of the projector's picture, the coordinate (0, 0) at the
    # centre of its first pixel.
    if source.x is None and source.y is None:
        raise ConfigError("--phase: is missing; name the map along x, along y (--phase-y), or both")
    for name, value in (("--period", source.period_px), ("--sigma", source.sigma_px)):
        if value is not None and not value > 0:
            raise ConfigError(f"{name} is {value:g}; it must be more than 0 px")
    notes: list[str] = []
    maps: dict[Axis, Floats] = {}
    files: tuple[tuple[Axis, Path | None, int], ...] = (
        ("x", source.x, source.projector_size[0]),
        ("y", source.y, source.projector_size[1]),
    )
    for axis, path, extent in files:
        if path is not None:
            maps[axis] = _coordinates(path, axis, source.period_px, extent, notes)
    first, *others = maps.values()
    if others and others[0].shape != first.shape:
        raise DataError(
            f"{source.y}: has {others[0].shape[1]} x {others[0].shape[0]} px, {source.x} "
            f"{first.shape[1]} x {first.shape[0]}; both maps must be of one camera"
        )
    measured = np.logical_and.reduce([np.isfinite(values) for values in maps.values()])
    if not measured.any():
        raise DataError(f"{source.x or source.y}: no pixel has a coordinate")
    sigma = {axis: _sigma(values, axis, source.sigma_px, notes) for axis, values in maps.items()}
    nowhere = np.full(first.shape, np.nan, np.float32)
    kept = {axis: np.where(measured, values, np.nan).astype(np.float32) for axis, values in maps.items()}
    of_first = next(iter(sigma.values()))
    decoded = Decoded(
        u=kept.get("x", nowhere),
        v=kept.get("y", nowhere),
        modulation=np.where(measured, 1.0, np.nan).astype(np.float32),
        sigma=np.where(measured, of_first, np.nan).astype(np.float32),
        v_per_u=sigma["y"] / sigma["x"] if others else 1.0,
    )
    return ImportedMaps(decoded, tuple(notes))


def _coordinates(path: Path, axis: Axis, period_px: float | None, extent: int, notes: list[str]) -> Floats:
    """Read a map as coordinates in px, NaN where it has none."""
    values = _load_map(path).astype(np.float64)
    missing = ~np.isfinite(values)
    zero = values == 0.0
    if zero.sum() > 1:
        notes.append(f"{path}: {zero.sum()} pixels are exactly 0, and count as not measured")
        missing |= zero
    values[missing] = np.nan
    some = values[~missing]
    if not some.size:
        raise DataError(f"{path}: has no number that is finite and not 0")
    if period_px is not None:
        if np.ptp(some) <= 2 * np.pi * (1 + 1e-6) and extent > 2 * period_px:
            raise DataError(
                f"{path}: reaches from {some.min():.3g} to {some.max():.3g} rad, which is one period: a "
                "wrapped phase; export the unwrapped, absolute one"
            )
        values = values * period_px / (2 * np.pi) - 0.5
    outside = (values < -0.5) | (values > extent - 0.5)
    share = outside.sum() / some.size
    if share > MAX_SHARE_OUTSIDE:
        raise DataError(
            f"{path}: its coordinates reach from {np.nanmin(values):.4g} to {np.nanmax(values):.4g} px, but "
            f"the projector has {extent} along {axis} ({100 * share:.0f} % lie outside); "
            + ("correct --period" if period_px else "give --period where the values are phases in rad")
            + " or --projector-size"
        )
    if outside.any():
        notes.append(
            f"{path}: {outside.sum()} pixels lie outside of the projector, and count as not measured"
        )
        values[outside] = np.nan
    return values


def _sigma(values: Floats, axis: Axis, stated_px: float | None, notes: list[str]) -> float:
    """1-sigma of coordinates in px: as stated, or by how pixels differ from the mean of their neighbours."""
    if stated_px is not None:
        return stated_px
    bends = np.concatenate([np.diff(values, 2, axis=k).ravel() for k in (0, 1)])
    bends = bends[np.isfinite(bends)]
    # The second difference of independent noise has six times its variance.
    measured = robust_spread(bends, 0.0) / np.sqrt(6.0) if bends.size else 0.0
    if not measured > 0:
        raise DataError(
            f"the noise of the map along {axis} cannot be measured from it; state it with --sigma"
        )
    notes.append(
        f"sigma along {axis} is {measured:.3g} px by how neighbouring pixels differ, which is too small "
        "where a program has smoothed the map; state it with --sigma where it is known"
    )
    return measured


def _load_map(path: Path) -> NDArray[Any]:
    readers: Mapping[bytes, Callable[[Path], Mapping[str, NDArray[Any]]]] = {
        b"\x93NUM": _read_npy,
        b"PK\x03\x04": lambda path: load_arrays(path, None),
        b"MATL": lambda path: read_apart("mat", path),
        b"II*\x00": _read_tiff,
        b"MM\x00*": _read_tiff,
    }
    try:
        with open_regular(path) as stream:
            reader = readers.get(stream.read(4))
        if reader is None:
            raise DataError(
                f"{path}: is no NPY, NPZ, TIFF or MATLAB file by its first bytes; export the map as one "
                "of these"
            )
        arrays = reader(path)
    except FileNotFoundError:
        raise DataError(no_such_file(path, *SUFFIXES)) from None
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read as a map ({error})") from error
    maps = {
        name: values
        for name, values in arrays.items()
        if values.ndim == 2 and min(values.shape) >= MIN_SIDE and values.dtype.kind in "iuf"
    }
    if len(maps) != 1:
        held = ", ".join(f"'{name}'" for name in maps) or "none"
        raise DataError(
            f"{path}: must hold one map, a two-dimensional array of numbers of at least {MIN_SIDE} px a "
            f"side, and holds {held}; export the one that is meant alone"
        )
    return next(iter(maps.values()))


def _read_npy(path: Path) -> Mapping[str, NDArray[Any]]:
    with open_regular(path) as stream:
        shape, _, dtype = array_head(stream)
        if dtype.kind not in "iuf":
            raise ValueError(f"an array of {dtype}, not of numbers")
        if path.stat().st_size - stream.tell() != int(np.prod(shape)) * dtype.itemsize:
            raise ValueError(f"its head announces the shape {shape}, its length another one")
        stream.seek(0)
        return {"map": np.load(stream, allow_pickle=False)}


def _read_tiff(path: Path) -> Mapping[str, NDArray[Any]]:
    import tifffile

    with open_regular(path) as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with tifffile.TiffFile(stream) as tiff:
                pages = len(tiff.pages)
                if pages != 1:
                    raise ValueError(f"{pages} pages, and one map is expected")
                announced = tiff.pages.first.nbytes
                if announced > 100 * max(path.stat().st_size, 1):
                    raise ValueError("it announces 100 times as many bytes as the file has")
                return {"map": tiff.asarray()}
        except (tifffile.TiffFileError, KeyError, IndexError, RuntimeError, MemoryError) as error:
            raise ValueError(str(error)) from error
