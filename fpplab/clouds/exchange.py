"""Clouds for other programs: E57 and LAS of points in m, OBJ, STL and 3MF of the surface and CSV in mm."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.clouds.cloud import SIGMAS, Cloud
from fpplab.clouds.files import CLOUD_SUFFIXES, save_cloud
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.extras import need_extra
from fpplab.core.files import write_atomic, write_by_name

MAX_E57_PIXEL = 2**16 - 1  # greatest row or column of a pixel in E57 files, integers of 16 bits


def export_cloud(cloud: Cloud, path: Path | str) -> None:
    path = Path(path)
    check_exported(path)
    _WRITERS[path.suffix.lower()](cloud, path)


def check_exported(path: Path) -> None:
    """Refuse at once what `export_cloud` would refuse whatever the cloud."""
    suffix = path.suffix.lower()
    if suffix not in EXPORTED:
        raise ConfigError(f"{path}: its name must end in {', '.join(EXPORTED[:-1])} or {EXPORTED[-1]}")
    if suffix in _LIBRARIES:
        need_extra(_LIBRARIES[suffix])


def point_columns(cloud: Cloud) -> dict[str, NDArray[Any]]:
    # returns (N,)
    columns: dict[str, NDArray[Any]] = dict(zip(("x_mm", "y_mm", "z_mm"), cloud.coordinates.T, strict=True))
    if cloud.pixels is not None:
        columns |= dict(zip(("pixel_u", "pixel_v"), cloud.pixels.T, strict=True))
    if cloud.normals is not None:
        columns |= dict(zip(("nx", "ny", "nz"), cloud.normals.T, strict=True))
    optional = {"grey": cloud.colour, "sigma_mm": cloud.sigma_mm, "epipolar_px": cloud.epipolar_px}
    optional |= {name: getattr(cloud, name) for name in SIGMAS}
    if cloud.rgb is not None:
        columns |= dict(zip(("red", "green", "blue"), cloud.rgb.T, strict=True))
    return columns | {name: values for name, values in optional.items() if values is not None}


def _write_csv(cloud: Cloud, path: Path) -> None:
    columns = point_columns(cloud)
    formats = ["%d" if np.issubdtype(values.dtype, np.integer) else "%.9g" for values in columns.values()]
    table = np.stack([values.astype(np.float64) for values in columns.values()], axis=1)
    header = ",".join(columns)
    write_atomic(
        path, lambda stream: np.savetxt(stream, table, formats, delimiter=",", header=header, comments="")
    )


def _write_surface(cloud: Cloud, path: Path) -> None:
    kind = path.suffix.lower()[1:]
    mesh = cloud.to_trimesh()
    if not len(mesh.faces):
        raise DataError(f"{path}: no three neighbouring pixels have points, so there is no surface to write")
    if kind == "3mf":
        mesh.units = "mm"
    exported: Any = mesh.export(file_type=kind)
    content: bytes = exported.encode("utf-8") if isinstance(exported, str) else exported
    write_atomic(path, lambda stream: stream.write(content))


def _write_e57(cloud: Cloud, path: Path) -> None:
    import pye57

    data: dict[str, NDArray[Any]] = dict(
        zip(("cartesianX", "cartesianY", "cartesianZ"), _metres(cloud).T.copy(), strict=True)
    )
    if cloud.colour is not None:
        data["intensity"] = cloud.colour.astype(np.float32)
        data |= dict(zip(("colorRed", "colorGreen", "colorBlue"), cloud.colours().T.copy(), strict=True))
    if cloud.pixels is not None and cloud.pixels.max() <= MAX_E57_PIXEL:
        data["columnIndex"], data["rowIndex"] = cloud.pixels.T.astype(np.uint16)

    def write(draft: Path) -> None:
        try:
            with pye57.E57(str(draft), mode="w") as file:
                file.write_scan_raw(data, name=path.stem)
        except pye57.libe57.E57Exception as error:
            raise DataError(f"{path}: cannot be written ({error})") from error

    write_by_name(path, write)


def _write_las(cloud: Cloud, path: Path) -> None:
    import laspy

    points = _metres(cloud)
    low, high = points.min(axis=0), points.max(axis=0)
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.generating_software = "fpplab"
    header.offsets = (low + high) / 2.0
    header.scales = np.full(3, _las_step(float((high - low).max()) / 2.0))
    extra = {
        name: values
        for name, values in point_columns(cloud).items()
        if name not in ("x_mm", "y_mm", "z_mm", "grey", "red", "green", "blue")
    }
    header.add_extra_dims(
        [laspy.ExtraBytesParams(name=name, type=values.dtype) for name, values in extra.items()]
    )
    header.global_encoding.wkt = True  # LAS 1.4 demands it of this point format
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.return_number[:] = las.number_of_returns[:] = 1
    if cloud.colour is not None:
        wide = np.uint16(257)  # 16 bits: 255 becomes 65535
        las.intensity = cloud.colour.astype(np.uint16) * wide
        las.red, las.green, las.blue = cloud.colours().T.astype(np.uint16) * wide
    for name, values in extra.items():
        las[name] = values
    content = io.BytesIO()
    las.write(content, do_compress=path.suffix.lower() == ".laz")
    write_atomic(path, lambda stream: stream.write(content.getbuffer()))


def _las_step(reach_m: float) -> float:
    """The step in m, a power of ten, with which 32 bits reach so far from the middle."""
    step = 1e-9  # in m; coordinates are integers of 32 bits, so it is larger for parts beyond 2 m
    while reach_m / step > 2**31 - 1:
        step *= 10.0
    return step


def _metres(cloud: Cloud) -> Floats:
    return cloud.coordinates.astype(np.float64) / 1000.0


_LIBRARIES = {".e57": "pye57", ".las": "laspy", ".laz": "laspy", ".3mf": "lxml"}
_WRITERS: dict[str, Callable[[Cloud, Path], None]] = {
    **dict.fromkeys(CLOUD_SUFFIXES, save_cloud),
    ".e57": _write_e57,
    ".las": _write_las,
    ".laz": _write_las,
    ".obj": _write_surface,
    ".stl": _write_surface,
    ".3mf": _write_surface,
    ".csv": _write_csv,
}
EXPORTED = tuple(_WRITERS)  # suffixes that `export_cloud` writes
