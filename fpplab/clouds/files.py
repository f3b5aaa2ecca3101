"""Clouds and meshes in files: PLY, XYZ and NPZ; STL, PLY and OBJ."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fpplab.clouds import ply
from fpplab.clouds.cloud import SIGMAS, Cloud, CloudPoints
from fpplab.core.archives import load_arrays
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import no_such_file, open_regular, write_large
from fpplab.core.foreign import read_apart

if TYPE_CHECKING:
    import trimesh

CLOUD_SUFFIXES = (".ply", ".xyz", ".npz")
"""Of files that `load_cloud` reads and `save_cloud` writes."""
MESH_SUFFIXES = (".stl", ".ply", ".obj")
"""Of files that `load_mesh` reads."""


def save_cloud(cloud: Cloud, path: Path | str, approve: Callable[[], object] | None = None) -> None:
    """Write a cloud in the format of the path's suffix, atomically: the file is complete or unchanged.

    Parameters
    ----------
    cloud : Cloud
        What to write.
    path : path or str
        With the suffix `.ply` (binary), `.xyz` (text, points only) or `.npz`.
    approve : callable, optional
        Called once everything is written, before the file takes its name; what it raises leaves the file
        unchanged.

    Raises
    ------
    ConfigError
        The path has another suffix.
    DataError
        The file cannot be written.
    """
    path = Path(path)
    writers = {".ply": _write_ply, ".xyz": _write_xyz, ".npz": _write_npz}
    suffix = _known_suffix(path, CLOUD_SUFFIXES)
    write_large(path, lambda stream: writers[suffix](cloud, stream), approve)


def load_cloud(path: Path | str) -> Cloud:
    """Read a cloud in the format of the path's suffix.

    Parameters
    ----------
    path : path or str
        With the suffix `.ply`, `.xyz` or `.npz`; written by fpplab or another program, in mm.

    Returns
    -------
    Cloud
        Attributes that the file does not hold are None.

    Raises
    ------
    ConfigError
        The path has another suffix.
    DataError
        The file is missing or damaged.
    """
    path = Path(path)
    readers = {".ply": _read_ply, ".xyz": _read_xyz, ".npz": _read_npz}
    suffix = _known_suffix(path, CLOUD_SUFFIXES)
    try:
        return readers[suffix](path)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
    except FileNotFoundError as error:
        raise DataError(no_such_file(path, *CLOUD_SUFFIXES)) from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise DataError(f"{path}: is no readable {suffix[1:].upper()} cloud ({error})") from error


def load_mesh(path: Path | str) -> trimesh.Trimesh:
    """Read the mesh of a true shape.

    Only the faces are read, without colours or texture; corners that coincide are joined.

    Parameters
    ----------
    path : path or str
        STL, PLY or OBJ file in mm.

    Returns
    -------
    trimesh.Trimesh
        Corners in mm in the frame of the file.

    Raises
    ------
    ConfigError
        The path has another suffix.
    DataError
        The file is missing, damaged, no mesh, or has corners that are not finite.
    """
    path = Path(path)
    kind = _known_suffix(path, MESH_SUFFIXES)[1:]
    try:
        parts = read_apart(kind, path)
    except FileNotFoundError as error:
        raise DataError(no_such_file(path, *MESH_SUFFIXES)) from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise DataError(f"{path}: is no readable {kind.upper()} mesh ({error}); export it again") from error
    if not parts or not len(parts["faces"]):
        if not path.stat().st_size:
            raise DataError(f"{path}: is empty; export the mesh again")
        raise DataError(
            f"{path}: holds no faces; give a mesh of the true shape as {kind.upper()}, not a cloud"
        )
    vertices, faces = parts["vertices"], parts["faces"]
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise DataError(
            f"{path}: a face names corner {faces.max() if faces.min() >= 0 else faces.min()}, but there are "
            f"corners 0 to {len(vertices) - 1}; export it again"
        )
    if not np.isfinite(vertices).all():
        raise DataError(f"{path}: has corners that are not finite; export it again")
    import trimesh  # half a second that measuring does not need

    return trimesh.Trimesh(vertices, faces)


def _known_suffix(path: Path, suffixes: tuple[str, ...]) -> str:
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        raise ConfigError(f"{path}: the suffix must be one of {', '.join(suffixes)}")
    return suffix


def _write_npz(cloud: Cloud, stream: BinaryIO) -> None:
    parts = {f.name: getattr(cloud, f.name) for f in fields(cloud)}
    np.savez(stream, **{name: values for name, values in parts.items() if values is not None})


def _read_npz(path: Path) -> Cloud:
    arrays = load_arrays(path, [f.name for f in fields(Cloud)])
    if "points" not in arrays:
        raise ValueError("it has no 'points'")
    if "size" not in arrays:
        return Cloud(**arrays)  # type: ignore[arg-type]
    width, height = arrays.pop("size").tolist()
    return Cloud(**arrays, size=(int(width), int(height)))


def _write_xyz(cloud: Cloud, stream: BinaryIO) -> None:
    np.savetxt(stream, cloud.points, fmt="%.5f")


def _read_xyz(path: Path) -> Cloud:
    with warnings.catch_warnings(), open_regular(path) as stream:
        warnings.simplefilter("ignore", UserWarning)  # an empty file is refused as a cloud without points
        values = np.loadtxt(stream, np.float32, ndmin=2, comments=("#", "//"), usecols=(0, 1, 2))
    return Cloud(np.ascontiguousarray(values))


_XYZ, _NORMAL, _RGB, _PIXEL = (
    ("x", "y", "z"),
    ("nx", "ny", "nz"),
    ("red", "green", "blue"),
    ("pixel_u", "pixel_v"),
)
_SIZE = "camera_size"
_SIGMAS_EXPLAINED = (
    "sigma_noise_mm is independent from point to point, sigma_calibration_mm common to all",
    "sigma_phase_error_mm is common to all points of one phase, so that averaging does not lessen it",
    "sigma_form_mm is what the best rigid motion of all points leaves of sigma_calibration_mm",
    "sigma_mm is noise, phase error and calibration together: root mean square distance from the true point",
)


def _write_ply(cloud: Cloud, stream: BinaryIO) -> None:
    columns: dict[str, NDArray[Any]] = {}
    parts = [(_XYZ, cloud.points), (_NORMAL, cloud.normals), (_PIXEL, cloud.pixels)]
    for names, values in parts:
        if values is not None:
            columns |= dict(zip(names, np.asarray(values).T, strict=True))
    if cloud.colour is not None:
        columns |= dict.fromkeys(_RGB, cloud.colour)
    for name in (*SIGMAS, "sigma_mm"):
        if (sigma := getattr(cloud, name)) is not None:
            columns[name] = sigma
    if cloud.epipolar_px is not None:
        columns["epipolar"] = cloud.epipolar_px
    comments = ["points in mm in the camera's frame"]
    if cloud.sigma_calibration_mm is not None:
        comments += _SIGMAS_EXPLAINED
    if cloud.size is not None:
        comments.append(f"{_SIZE} {cloud.size[0]} {cloud.size[1]}")
    ply.write(columns, comments, stream)


def _read_ply(path: Path) -> Cloud:
    table, comments = ply.read(path)
    sizes = [text.split()[1:] for text in comments if text.split()[:1] == [_SIZE]]
    size = (int(sizes[0][0]), int(sizes[0][1])) if sizes else None
    points = _columns(table, _XYZ, np.float32)
    if points is None:
        raise ValueError("a vertex has no x, y, z")
    rgb = _columns(table, _RGB, np.uint8)
    return Cloud(
        points=points,
        pixels=_columns(table, _PIXEL, np.int32) if size else None,
        size=size,
        normals=_columns(table, _NORMAL, np.float32),
        colour=None if rgb is None else np.rint(rgb.mean(axis=1)).astype(np.uint8),
        **{name: _column(table, name) for name in SIGMAS},
        epipolar_px=_column(table, "epipolar"),
    )


def _columns(table: ply.VertexTable, names: tuple[str, ...], dtype: Any) -> NDArray[Any] | None:
    if not set(names) <= set(table.dtype.names or ()):
        return None
    return np.asarray(np.stack([table[name] for name in names], axis=1), dtype)


def _column(table: ply.VertexTable, name: str) -> CloudPoints | None:
    return np.asarray(table[name], np.float32) if name in (table.dtype.names or ()) else None
