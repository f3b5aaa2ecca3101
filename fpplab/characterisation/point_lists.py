"""Points of a board that another program located in camera and projector: a table, one point a row."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import ImageSize
from fpplab.core import config
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.file_kinds import naming_other_kinds
from fpplab.targets import Target

PIXELS = ("camera_u", "camera_v", "projector_u", "projector_v")
BOARD = ("x_mm", "y_mm")
MAX_SHIFT = 0.01
"""Of a point from where the target file has it, as a share of the pitch. Chosen: rounded numbers."""


@dataclass(frozen=True)
class PointListSource:
    """A table of points, and the devices in whose pixels they are."""

    path: Path
    camera_size: ImageSize  # (width, height) px
    projector_size: ImageSize  # (width, height) px
    lattice: Lattice = Lattice.SQUARE


def load_point_list(source: PointListSource, target: Target) -> list[Observation]:
    """Read the poses of a table, in the order in which they begin."""
    # The first row names the columns: `pose`, `id` (row of the target's points) or `x_mm` and `y_mm` (on the
    # board, from its centre or from its first point), `camera_u`, `camera_v`, `projector_u`, `projector_v` in
    # px. They are parted by commas, semicolons or tabs. The centre of a device's first pixel is (0, 0).
    rows = _rows(source.path)
    ids = _match_rows_to_target(source.path, rows, target)
    pixels = np.column_stack([_numbers(source.path, rows, name) for name in PIXELS])
    for device, size, columns in (
        ("camera", source.camera_size, slice(0, 2)),
        ("projector", source.projector_size, slice(2, 4)),
    ):
        _require_inside(source.path, device, size, pixels[:, columns])
    poses = np.array(rows["pose"])
    observations = []
    for name in dict.fromkeys(rows["pose"]):
        of_pose = np.flatnonzero(poses == name)
        unique, first = np.unique(ids[of_pose], return_index=True)
        if len(unique) < len(of_pose):
            again = np.setdiff1d(np.arange(len(of_pose)), first)[0]
            raise DataError(
                f"{source.path}: row {of_pose[again] + 2} gives point {ids[of_pose[again]]} of pose {name} "
                "again; keep one of the rows"
            )
        kept = of_pose[first]
        observations.append(Observation(name, unique, pixels[kept, :2], pixels[kept, 2:]))
    return observations


def _rows(path: Path) -> Mapping[str, Sequence[str]]:
    """Read the columns of a table by name."""
    with naming_other_kinds(path, "points"):
        return _columns(path)


def _columns(path: Path) -> Mapping[str, Sequence[str]]:
    lines = [line for line in config.read_text(path).splitlines() if line.strip()]
    if not lines:
        raise DataError(f"{path}: is empty; a table of points is expected")
    separator = max(",;\t", key=lines[0].count)
    names, *rows = ([cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator))
    names = [name.lower() for name in names]
    board = ("id",) if "id" in names else BOARD
    expected = ("pose", *board, *PIXELS)
    if sorted(names) != sorted(expected):
        raise DataError(
            f"{path}: its first row names the columns {', '.join(names[:9])}; they must be "
            f"pose, id (or {' and '.join(BOARD)}), {', '.join(PIXELS)}, in any order"
        )
    for number, row in enumerate(rows, 2):
        if len(row) != len(names):
            raise DataError(f"{path}: row {number} has {len(row)} values for {len(names)} columns")
    if not rows:
        raise DataError(f"{path}: names columns, but has no points")
    return dict(zip(names, zip(*rows, strict=True), strict=True))


def _numbers(path: Path, rows: Mapping[str, Sequence[str]], name: str) -> Floats:
    values = np.empty(len(rows[name]))
    for k, text in enumerate(rows[name]):
        try:
            values[k] = float(text)
        except ValueError:
            values[k] = np.nan
        if not np.isfinite(values[k]):
            raise DataError(
                f"{path}: '{name}' in row {k + 2} is '{text}'; a number with a decimal point is expected"
            )
    return values


def _match_rows_to_target(path: Path, rows: Mapping[str, Sequence[str]], target: Target) -> NDArray[np.intp]:
    """Find the row of the target's points that each row of the table means."""
    points = target.points()[:, :2]
    if "id" in rows:
        ids = _numbers(path, rows, "id")
        wrong = np.flatnonzero((ids != np.rint(ids)) | (ids < 0) | (ids >= len(points)))
        if wrong.size:
            raise DataError(
                f"{path}: 'id' in row {wrong[0] + 2} is '{rows['id'][wrong[0]]}'; the board's points are "
                f"0 to {len(points) - 1}, row by row"
            )
        return ids.astype(np.intp)
    stated = np.column_stack([_numbers(path, rows, name) for name in BOARD])
    max_shift_mm = MAX_SHIFT * min(target.spacing_mm)
    nearest_mm = []
    for origin in (np.zeros(2), points[0]):
        distances = np.linalg.norm(stated[:, None] + origin - points[None], axis=2)
        nearest = distances.min(axis=1)
        if nearest.max() <= max_shift_mm:
            return np.asarray(distances.argmin(axis=1))
        nearest_mm.append(nearest)
    worst = min(nearest_mm, key=np.median).argmax()
    raise DataError(
        f"{path}: row {worst + 2} is of the point {stated[worst, 0]:g} {stated[worst, 1]:g} mm, where the "
        "target file has none, whether counted from its centre or from its first point; give the target "
        "that was shown, or the points' numbers as `id`"
    )


def _require_inside(path: Path, device: str, size: ImageSize, pixels: Floats) -> None:
    """Refuse points outside of a device's picture, where nothing can have been measured."""
    if min(size) < 1:
        raise ConfigError(f"--{device}-size is {size[0]} {size[1]}; it must be width and height in px")
    outside = np.flatnonzero(((pixels < -0.5) | (pixels > np.array(size) - 0.5)).any(axis=1))
    if outside.size:
        u, v = pixels[outside[0]]
        raise DataError(
            f"{path}: row {outside[0] + 2} has the point {u:g} {v:g} in the {device}, which has "
            f"{size[0]} x {size[1]} px ({outside.size} such rows); correct --{device}-size or leave them out"
        )
