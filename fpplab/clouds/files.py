"""Clouds and meshes in files: PLY, XYZ and NPZ; STL, PLY and OBJ."""

from __future__ import annotations

import io
import logging
import re
import warnings
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fpplab.clouds import ply
from fpplab.clouds.cloud import SIGMAS, Cloud
from fpplab.core.archives import load_arrays
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.file_kinds import naming_other_kinds, other_kind
from fpplab.core.files import no_such_file, open_regular, write_large
from fpplab.core.foreign import read_apart
from fpplab.core.session_names import CLOUD

if TYPE_CHECKING:
    import trimesh

_log = logging.getLogger(__name__)

CLOUD_SUFFIXES = (".ply", ".xyz", ".npz")  # of files that `load_cloud` reads and `save_cloud` writes
TEXT_SUFFIXES = (".xyz", ".csv", ".txt", ".pts", ".asc")  # of tables of points, which `load_cloud` reads
READ_SUFFIXES = tuple(dict.fromkeys((*CLOUD_SUFFIXES, *TEXT_SUFFIXES)))
MESH_SUFFIXES = (".stl", ".ply", ".obj")  # of files that `load_mesh` reads
MIN_SIZE_MM = 1.0
"""Below which a cloud or mesh seems to be in another unit (chosen: parts are of 1 mm to 2 m)"""
FAR_MM = 8192.0  # coordinate from which steps of 32-bit numbers reach 1 µm


@dataclass(frozen=True)
class PlaceholderLimits:
    """When a value that comes again and again stands for points that were not measured."""

    sample: int = 4096  # points that are looked at: a placeholder of 1 % of them comes some 40 times
    min_repeats: int = 20  # in the sample (chosen: fewer hardly change a result)
    min_over_next: int = 5  # times as often as the next value: rounding makes many come about as often


PLACEHOLDERS = PlaceholderLimits()


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
        With the suffix `.ply`, `.npz`, or of a table: `.xyz`, `.csv`, `.txt`, `.pts`, `.asc`; in mm. Or a
        session that holds its cloud.

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
    if path.is_dir():
        path = _cloud_of_session(path)
    readers = {".ply": _read_ply, ".npz": _read_npz}
    with naming_other_kinds(path, "cloud"):
        suffix = _known_suffix(path, READ_SUFFIXES)
        try:
            return readers.get(suffix, _read_xyz)(path)
        except DataError as error:
            raise DataError(f"{path}: {error}") from error
        except FileNotFoundError as error:
            raise DataError(no_such_file(path, *READ_SUFFIXES)) from error
        except OSError as error:
            raise DataError(f"{path}: cannot be read ({error.strerror or error})") from error
        except (ValueError, KeyError, IndexError, TypeError) as error:
            raise DataError(f"{path}: is no readable {suffix[1:].upper()} cloud ({error})") from error


def _cloud_of_session(path: Path) -> Path:
    if (sentence := other_kind(path, "session")) and not (path / CLOUD).is_file():
        raise DataError(sentence)
    if not (path / CLOUD).is_file():
        raise DataError(f"{path}: is a session without {CLOUD}; `fpplab reconstruct` writes it")
    return path / CLOUD


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
    with naming_other_kinds(path, "mesh"):
        return _read_mesh(path)


def _read_mesh(path: Path) -> trimesh.Trimesh:
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
        raise DataError(f"{path}: holds no faces; give a mesh of the true shape")
    vertices, faces = parts["vertices"], parts["faces"]
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise DataError(
            f"{path}: a face names corner {faces.max() if faces.min() >= 0 else faces.min()}, but there are "
            f"corners 0 to {len(vertices) - 1}; export it again"
        )
    if not np.isfinite(vertices).all():
        raise DataError(f"{path}: has corners that are not finite; export it again")
    import trimesh  # half a second that measuring does not need

    if kind == "stl":
        _warn_of_steps(path, _middle(vertices))
    _warn_of_size(path, vertices)
    return _wound_alike(trimesh.Trimesh(vertices, faces), path)


def _middle(points: NDArray[Any]) -> Floats:
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2.0 if len(points) else np.zeros(3))


def _warn_of_steps(path: Path, middle: Floats) -> None:
    """Warn of points about `middle` (3,) in 32 bits, so far from 0 that these round them."""
    reach = np.abs(middle).max()
    if reach > FAR_MM:
        _log.warning(
            "%s: its coordinates have steps of %.2g mm so far from 0; write them as text or double",
            path,
            np.spacing(np.float32(reach)),
        )


def _warn_of_size(path: Path, points: Floats) -> None:
    """Warn of points (N, 3) that lie as if they were in m."""
    size_mm = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    if 0.0 < size_mm < MIN_SIZE_MM:
        _log.warning(
            "%s: is %.3g mm across; lengths must be in mm: of m, multiply all coordinates by 1000",
            path,
            size_mm,
        )


def _wound_alike(mesh: trimesh.Trimesh, path: Path) -> trimesh.Trimesh:
    """Turn the faces of a closed mesh outwards where they are wound this way and that."""
    if mesh.is_winding_consistent or not mesh.is_watertight:
        return mesh
    import igl

    faces, part = igl.bfs_orient(np.ascontiguousarray(mesh.faces, np.int64))
    turned = mesh.copy()
    turned.faces = faces
    if part.any() or not turned.is_winding_consistent:  # what is inside of several shells is not known
        return mesh
    if turned.volume < 0.0:
        turned.invert()
    _log.warning("%s: its faces are not wound consistently; they are turned outwards", path)
    return turned


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
    points = arrays.pop("points")
    if "origin_mm" in arrays:
        points = points + arrays.pop("origin_mm")
    size = arrays.pop("size").tolist() if "size" in arrays else None
    return _cloud(path, points, arrays, None if size is None else (int(size[0]), int(size[1])))


def _write_xyz(cloud: Cloud, stream: BinaryIO) -> None:
    np.savetxt(stream, cloud.coordinates, fmt="%.5f")


def _read_xyz(path: Path) -> Cloud:
    with warnings.catch_warnings(), open_regular(path) as stream:
        warnings.simplefilter("ignore", UserWarning)  # an empty file is refused as a cloud without points
        content = stream.read().removeprefix(BOM_UTF8)
        if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
            content = content.decode("utf-16").encode()
        try:
            table = np.loadtxt(io.BytesIO(content), np.float64, ndmin=2, comments=("#", "//"))
        except ValueError:  # other dialects take five times as long
            return _read_dialect(content.splitlines(), path)
    if not len(table):
        raise ValueError("it holds no points")
    if table.shape[1] < 3:
        raise ValueError(f"its lines have {table.shape[1]} values, and a point three")
    if table.shape[1] > 3:
        _log.warning(_FURTHER_COLUMNS, path, table.shape[1])
    return _cloud(path, table[:, :3], {})


_COMMENT = re.compile(rb"(#|//).*")
_DECIMAL_COMMA = re.compile(rb"[-+]?\d+,\d+([eE][-+]?\d+)?")
_FURTHER_COLUMNS = "%s: has %d columns; only x, y, z are read"


def _read_dialect(lines: list[bytes], path: Path) -> Cloud:
    rows = ply.numbered_rows((_COMMENT.sub(b"", line) for line in lines), 1)
    rows = _with_decimal_points(rows)
    last = rows[-1][1]
    separator = next((each for each in (b";", b",") if each in b"".join(last)), None)
    if separator:
        rows = [(n, [*map(bytes.strip, b" ".join(values).split(separator))]) for n, values in rows]
    if rows[0][1] == [b"%d" % (len(rows) - 1)]:
        del rows[0]
    columns, width = [0, 1, 2], len(rows[-1][1])
    if re.search(rb"[A-Za-z]", b"".join(rows[0][1])) and not any(map(ply.is_number, rows[0][1])):
        columns = _named_columns([value.decode("utf-8", "replace") for value in rows.pop(0)[1]])
    ply.check_widths(rows, max(width, 3))
    if width > 3:
        _log.warning(_FURTHER_COLUMNS, path, width)
    return _cloud(path, ply.parse_rows([(n, [values[i] for i in columns]) for n, values in rows], 3), {})


def _with_decimal_points(rows: ply.TextRows) -> ply.TextRows:
    """Replace decimal commas, which are told from separators by blanks or semicolons between the values."""
    lines = [(n, b" ".join(values)) for n, values in rows]
    separated = [line.split(b";" if b";" in line else None) for _, line in lines]
    values = [value.strip() for line in separated for value in line]
    with_comma = [value for value in values if b"," in value]
    if not with_comma or not all(map(_DECIMAL_COMMA.fullmatch, with_comma)):
        return rows
    if any(b"." in value for value in values if ply.is_number(value)):
        return rows
    if all(re.fullmatch(rb"[-+]?[1-9]\d{0,2},\d{3}", value) for value in with_comma):
        value = with_comma[0].decode()
        raise ValueError(f"'{value}' may have a decimal comma or count thousands; write decimals with points")
    return [(n, line.replace(b",", b".").split()) for n, line in lines]


def _named_columns(names: list[str]) -> list[int]:
    plain = [re.sub(r"[\W_]|mm", "", name.lower()) for name in names]
    if any(plain.count(axis) != 1 for axis in "xyz"):
        raise ValueError(f"its first line, '{' '.join(names)[:60]}', names no x, y, z in mm")
    return [plain.index(axis) for axis in "xyz"]


_XYZ, _NORMAL, _PIXEL = ("x", "y", "z"), ("nx", "ny", "nz"), ("pixel_u", "pixel_v")
_RGB = ("red", "green", "blue")
_COLOURS = (
    _RGB,
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    *(("intensity",), ("gray",), ("grey",), ("scalar_intensity",), ("scalar_Intensity",)),
)
"""Properties by which programs give colours or grey levels, the first that is there being taken."""
_WHITE = {"u1": 255.0, "u2": 65535.0, "f4": 1.0, "f8": 1.0}
_SIZE = "camera_size"
_SIGMAS_EXPLAINED = (
    "sigma_noise_mm is independent from point to point, sigma_calibration_mm common to all",
    "sigma_phase_error_mm is common to all points of one phase, so that averaging does not lessen it",
    "sigma_form_mm is what the best rigid motion of all points leaves of sigma_calibration_mm",
    "sigma_mm is noise, phase error and calibration together: root mean square distance from the true point",
)


def _write_ply(cloud: Cloud, stream: BinaryIO) -> None:
    columns: dict[str, NDArray[Any]] = {}
    parts = [(_XYZ, cloud.coordinates), (_NORMAL, cloud.normals), (_PIXEL, cloud.pixels)]
    for names, values in parts:
        if values is not None:
            columns |= dict(zip(names, np.asarray(values).T, strict=True))
    if cloud.colour is not None:
        columns |= dict(zip(_RGB, cloud.colours().T, strict=True))
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
    names = table.dtype.names or ()
    if (capitals := set("XYZ")) <= set(names) and not set(_XYZ) & set(names):
        names = table.dtype.names = tuple(n.lower() if n in capitals else n for n in names)
    if not set(_XYZ) <= set(names):
        raise ValueError(f"a vertex has no x, y, z, but {', '.join(names)}")
    points = np.stack([table[name] for name in _XYZ], axis=1)
    attributes: dict[str, NDArray[Any] | None] = {
        "pixels": _columns(table, _PIXEL, np.int32) if size else None,
        "normals": _columns(table, _NORMAL, np.float32),
        "colour": _colour(table, path),
        "rgb": _columns(table, _RGB, np.uint8) if _is_coloured(table) else None,
    }
    columns = {"epipolar_px": "epipolar", **{name: name for name in SIGMAS}}
    attributes |= {name: _columns(table, (column,), np.float32) for name, column in columns.items()}
    return _cloud(path, points, attributes, size)


def _columns(table: ply.VertexTable, names: tuple[str, ...], dtype: Any) -> NDArray[Any] | None:
    """Give properties (N, names), or (N,) of one, or None where one is missing."""
    if not set(names) <= set(table.dtype.names or ()):
        return None
    if len(names) == 1:
        return np.asarray(table[names[0]], dtype)
    return np.asarray(np.stack([table[name] for name in names], axis=1), dtype)


def _is_coloured(table: ply.VertexTable) -> bool:
    if not set(_RGB) <= set(table.dtype.names or ()) or any(table.dtype[name] != np.uint8 for name in _RGB):
        return False
    red, green, blue = (table[name] for name in _RGB)
    return bool((red != green).any() or (green != blue).any())


def _colour(table: ply.VertexTable, path: Path) -> NDArray[np.uint8] | None:
    """Give grey levels (N,), whose scale their type states: 255, 65535, or 1 of real numbers."""
    for names in _COLOURS:
        values = _columns(table, names, np.float64)
        if values is None:
            continue
        kinds = {table.dtype[name].str[1:] for name in names}
        white = _WHITE.get(kinds.pop(), 0.0) if len(kinds) == 1 else 0.0
        if white and np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= white:
            grey = values.reshape(len(values), -1).mean(axis=1) * (255.0 / white)
            return np.asarray(np.rint(grey), np.uint8)
        _log.warning(
            "%s: grey levels of %s are left out: they must be of 8 or 16 bits without sign, or 0 … 1",
            path,
            ", ".join(names),
        )
    return None


def _cloud(
    path: Path,
    points: NDArray[Any],
    attributes: Mapping[str, NDArray[Any] | None],
    size: tuple[int, int] | None = None,
) -> Cloud:
    known: dict[str, Any] = {name: values for name, values in attributes.items() if values is not None}
    if points.shape != (len(points), 3) or any(len(values) != len(points) for values in known.values()):
        return Cloud(points, size=size, **known)  # which refuses it
    measured = np.isfinite(points).all(axis=1) & points.any(axis=1)
    why = "0 0 0 or not finite"
    if (repeated := _repeated(points[measured])) is not None:  # such as -9999 -9999 -9999
        measured &= (points != repeated[0]).any(axis=1)
        why = f"{' '.join(f'{value:g}' for value in repeated[0])}, {why}"
    if (z := _depth_placeholder(path, points[measured])) is not None:
        measured &= points[:, 2] != z
        why = f"at z = {z:g}, {why}"
    invalid = len(points) - int(np.count_nonzero(measured))
    if invalid and invalid == len(points):
        raise ValueError(f"all of its {invalid} points are {why}")
    if invalid:
        _log.warning("%s: %d points of %d are %s; they are left out", path, invalid, len(points), why)
        points, known = points[measured], {name: values[measured] for name, values in known.items()}
    middle = _middle(points)
    if points.dtype == np.float32:
        _warn_of_steps(path, middle)
    _warn_of_size(path, points)
    origin = np.where(np.abs(middle) > FAR_MM, np.rint(middle), 0.0)
    near = np.ascontiguousarray(points - origin if origin.any() else points, np.float32)
    return Cloud(near, size=size, origin_mm=tuple(origin.tolist()), **known)


def _depth_placeholder(path: Path, points: NDArray[Any]) -> float | None:
    """Find the z of points whose x and y were kept although nothing was measured there."""
    depth = points[:, 2]
    if (repeated := _repeated(depth[:, None])) is None:
        return None
    (value,), next_repeats = repeated
    others = depth[depth != value]
    # A flat surface of exactly this z has others beside it, or like it; a placeholder lies far from them all.
    is_apart = float(np.abs(others - value).min()) > float(np.ptp(others))
    if is_apart and next_repeats < PLACEHOLDERS.min_repeats:
        return float(value)
    if value == 0.0:
        count = len(depth) - len(others)
        _log.warning(
            "%s: %d points of %d are at exactly z = 0: measured, or missing?", path, count, len(depth)
        )
    return None


def _repeated(points: NDArray[Any]) -> tuple[NDArray[Any], int] | None:
    """Find what comes again and again among values (N, k), and how often the next does in a sample."""
    sample = points
    if len(points) > PLACEHOLDERS.sample:
        sample = points[np.random.default_rng(0).integers(len(points), size=PLACEHOLDERS.sample)]
    values, repeats = np.unique(sample, axis=0, return_counts=True)
    if len(values) < 2:
        return None
    *_, second, first = np.sort(repeats).tolist()
    enough = max(PLACEHOLDERS.min_repeats, PLACEHOLDERS.min_over_next * second)
    return (values[np.argmax(repeats)], second) if first >= enough else None
