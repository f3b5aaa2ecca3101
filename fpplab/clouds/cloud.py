"""Measured clouds: points with what is known of each, on disk as PLY, XYZ or NPZ; meshes of true shapes."""

from __future__ import annotations

import warnings
import zipfile
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fpplab.clouds import ply
from fpplab.clouds.pixelgrid import PixelGrid
from fpplab.core.conventions import Mask
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import write_atomic

if TYPE_CHECKING:
    import trimesh

CLOUD_SUFFIXES = (".ply", ".xyz", ".npz")
MESH_SUFFIXES = (".stl", ".ply", ".obj")

CloudPoints = NDArray[np.float32]

_SIGMAS = ("sigma_noise_mm", "sigma_calibration_mm", "sigma_form_mm")


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points in mm in the camera's frame, and what is known of each; None is not known.

    points: float32 (N, 3). pixels: int32 (N, 2) as (u, v) of the camera of `size` (width, height)
    that saw them, at most one point per pixel. normals: float32 (N, 3), unit, facing the camera,
    (0, 0, 0) where unknown. colour: uint8 grey (N,). epipolar_px: float32 (N,), distance from the
    epipolar curve in projector px.

    Standard uncertainties, float32 (N,): sigma_noise_mm, from the fringes' noise, along the ray,
    independent from point to point. sigma_calibration_mm, from the calibration's covariance, common
    to all points; sigma_form_mm, what the best rigid motion of the whole cloud leaves of that. These
    two are root mean square distances (`fpplab.reconstruction.uncertainty`).

    Raises `DataError` when the parts do not fit together.
    """

    points: CloudPoints
    pixels: NDArray[np.int32] | None = None
    size: tuple[int, int] | None = None
    normals: CloudPoints | None = None
    colour: NDArray[np.uint8] | None = None
    sigma_noise_mm: CloudPoints | None = None
    sigma_calibration_mm: CloudPoints | None = None
    sigma_form_mm: CloudPoints | None = None
    epipolar_px: CloudPoints | None = None

    def __post_init__(self) -> None:
        n = len(self.points)
        shapes: dict[str, tuple[int, ...]] = {"points": (n, 3), "pixels": (n, 2), "normals": (n, 3)}
        shapes |= dict.fromkeys(("colour", *_SIGMAS, "epipolar_px"), (n,))
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values is not None and values.shape != shape:
                raise DataError(f"cloud: {name} has the shape {values.shape} instead of {shape}")
        if n == 0 or not np.isfinite([self.points.min(), self.points.max()]).all():
            raise DataError("cloud: there must be at least one point, and none that is not finite")
        if (self.pixels is None) != (self.size is None):
            raise DataError("cloud: pixels need the camera's size, and the size pixels")
        if self.pixels is None or self.size is None:
            return
        u, v = self.pixels.T
        if min(u.min(), v.min()) < 0 or u.max() >= self.size[0] or v.max() >= self.size[1]:
            raise DataError(f"cloud: pixels lie outside the camera's {self.size}")

    def __len__(self) -> int:
        return len(self.points)

    @property
    def sigma_mm(self) -> CloudPoints | None:
        """Noise and calibration together, float32 (N,): root mean square distance from the true point.

        None where one of them is not known.
        """
        if self.sigma_noise_mm is None or self.sigma_calibration_mm is None:
            return None
        return np.hypot(self.sigma_noise_mm, self.sigma_calibration_mm)

    def only(self, kept: Mask) -> Cloud:
        """The points that are kept, (N,) bool; at least one."""
        parts = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "size"}
        # Rows by number: NumPy takes four times as long by a mask.
        rows = np.flatnonzero(kept)
        return replace(
            self, **{name: part.take(rows, axis=0) for name, part in parts.items() if part is not None}
        )

    def grid(self) -> PixelGrid:
        """The points laid out over the camera's pixels. Raises `DataError` when those are not known."""
        if self.pixels is None or self.size is None:
            raise DataError("cloud: its points are not known by camera pixel; use a cloud that fpplab made")
        return PixelGrid.of(self.points, self.pixels, self.size, self.sigma_noise_mm)

    def grid_mesh(self) -> tuple[CloudPoints, NDArray[np.int32]]:
        """The surface over the pixel grid, cut at jumps: vertices (N, 3), faces (M, 3) facing the camera.

        The rule that cuts is that of `fpplab.clouds.pixelgrid`. Raises `DataError` without pixels.
        """
        return self.points, self.grid().faces()


def local_quadric_distance(cloud: Cloud, window: int = 15) -> CloudPoints:
    """Signed distances (N,) in mm along the normal of each point from a quadric fitted to its pixel window.

    A figure of roughness where the truth is not known. window: odd, in px. NaN where less than
    half the window belongs to the point's surface.
    Raises `ConfigError` for a window that is no odd number from 5, `DataError` without pixels.
    """
    if window < 5 or window % 2 == 0:
        raise ConfigError(f"window: {window} px must be an odd number, at least 5")
    return cloud.grid().quadric_distances(window)


def save_cloud(cloud: Cloud, path: Path) -> None:
    """Write by suffix, whole or not at all: `.ply` (binary), `.xyz` (text, points alone), `.npz`.

    Raises `ConfigError` for another suffix, `DataError` when the place cannot be written.
    """
    writers = {".ply": _write_ply, ".xyz": _write_xyz, ".npz": _write_npz}
    suffix = _known_suffix(path, CLOUD_SUFFIXES)
    write_atomic(path, lambda stream: writers[suffix](cloud, stream))


def load_cloud(path: Path) -> Cloud:
    """Read by suffix; what a file from elsewhere does not tell is None. Points in mm.

    Raises `ConfigError` for another suffix, `DataError` for a file that is missing or damaged.
    """
    readers = {".ply": _read_ply, ".xyz": _read_xyz, ".npz": _read_npz}
    suffix = _known_suffix(path, CLOUD_SUFFIXES)
    try:
        return readers[suffix](path)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, KeyError, IndexError, zipfile.BadZipFile, EOFError) as error:
        raise DataError(f"{path}: is no readable {suffix[1:].upper()} cloud ({error})") from error


def load_mesh(path: Path) -> trimesh.Trimesh:
    """A true shape in mm from STL, PLY or OBJ: its faces alone, joined wherever corners coincide.

    Raises `ConfigError` for another suffix, `DataError` for a file that is missing, damaged or no mesh.
    """
    import trimesh  # half a second that measuring does not need

    suffix = _known_suffix(path, MESH_SUFFIXES)
    try:
        # Unprocessed, for processing would drop corners that are not finite without a word.
        with path.open("rb") as stream, np.errstate(invalid="ignore"):
            mesh = trimesh.load_mesh(stream, file_type=suffix[1:], process=False)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # the readers of three formats raise what they like
        raise DataError(
            f"{path}: is no readable {suffix[1:].upper()} mesh ({error}); export it again"
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise DataError(f"{path}: holds no faces; give a mesh of the true shape, not a cloud")
    if not np.isfinite(mesh.vertices).all():
        raise DataError(f"{path}: has corners that are not finite; export it again")
    return trimesh.Trimesh(mesh.vertices, mesh.faces)


def _known_suffix(path: Path, known: tuple[str, ...]) -> str:
    suffix = path.suffix.lower()
    if suffix not in known:
        raise ConfigError(f"{path}: the suffix must be one of {', '.join(known)}")
    return suffix


def _write_npz(cloud: Cloud, stream: BinaryIO) -> None:
    parts = {f.name: getattr(cloud, f.name) for f in fields(cloud)}
    np.savez(stream, **{name: values for name, values in parts.items() if values is not None})


def _read_npz(path: Path) -> Cloud:
    with np.load(path, allow_pickle=False) as parts:
        known = {f.name: parts[f.name] for f in fields(Cloud) if f.name in parts and f.name != "size"}
        size = tuple(int(n) for n in parts["size"]) if "size" in parts else None
    return Cloud(**known, size=size)  # type: ignore[arg-type]


def _write_xyz(cloud: Cloud, stream: BinaryIO) -> None:
    np.savetxt(stream, cloud.points, fmt="%.5f")


def _read_xyz(path: Path) -> Cloud:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # an empty file is refused as a cloud without points
        values = np.loadtxt(path, np.float32, ndmin=2, comments=("#", "//"), usecols=(0, 1, 2))
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
    "sigma_form_mm is what the best rigid motion of all points leaves of sigma_calibration_mm",
    "sigma_mm is noise and calibration together: root mean square distance from the true point",
)


def _write_ply(cloud: Cloud, stream: BinaryIO) -> None:
    columns: dict[str, NDArray[Any]] = {}
    parts = [(_XYZ, cloud.points), (_NORMAL, cloud.normals), (_PIXEL, cloud.pixels)]
    for names, values in parts:
        if values is not None:
            columns |= dict(zip(names, np.asarray(values).T, strict=True))
    if cloud.colour is not None:
        columns |= dict.fromkeys(_RGB, cloud.colour)
    for name in (*_SIGMAS, "sigma_mm"):
        if (sigma := getattr(cloud, name)) is not None:
            columns[name] = sigma
    if cloud.epipolar_px is not None:
        columns["epipolar"] = cloud.epipolar_px
    table = np.empty(len(cloud), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    comments = ["points in mm in the camera's frame"]
    if cloud.sigma_calibration_mm is not None:
        comments += _SIGMAS_EXPLAINED
    if cloud.size is not None:
        comments.append(f"{_SIZE} {cloud.size[0]} {cloud.size[1]}")
    ply.write(table, comments, stream)


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
        **{name: _column(table, name) for name in _SIGMAS},
        epipolar_px=_column(table, "epipolar"),
    )


def _columns(table: ply.VertexTable, names: tuple[str, ...], dtype: Any) -> NDArray[Any] | None:
    if not set(names) <= set(table.dtype.names or ()):
        return None
    return np.asarray(np.stack([table[name] for name in names], axis=1), dtype)


def _column(table: ply.VertexTable, name: str) -> CloudPoints | None:
    return np.asarray(table[name], np.float32) if name in (table.dtype.names or ()) else None
