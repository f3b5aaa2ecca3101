"""Points and maps on the raster of a picture."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Map, Mask
from fpplab.core.errors import DataError

STRAYS = 0.5
"""Per cent of the points on each side that do not widen a picture."""
MARGIN = 0.04
"""Of the picture's greater side."""

Extent = tuple[float, float, float, float]
"""Left, right, bottom and top edge of a map in the units of its axes."""


class CloudLike(Protocol):
    """What is drawn of a cloud: points (N, 3) in mm, and camera pixels (N, 2) or None."""

    @property
    def points(self) -> NDArray[np.float32]: ...
    @property
    def pixels(self) -> NDArray[np.int32] | None: ...


class Raster(NamedTuple):
    """Where points lie in a picture: their (N,) columns and rows, the origin, pitch and names of its axes."""

    columns: NDArray[np.int64]
    rows: NDArray[np.int64]
    origin: tuple[float, float]
    pitch: float
    names: tuple[str, str]


def raster(cloud: CloudLike) -> Raster:
    """The camera's pixels; for points that have none, a view along the optical axis, in mm.

    Raises `DataError` when there are no points.
    """
    if not len(cloud.points):
        raise DataError("the cloud has no points; nothing to draw")
    if cloud.pixels is not None:
        u, v = cloud.pixels.T.astype(np.int64)
        return Raster(u, v, (0.0, 0.0), 1.0, ("camera u in px", "camera v in px"))
    x, y = cloud.points[:, :2].T.astype(np.float64)
    left, top, right, bottom = _box(x, y)
    wide, high = right - left, bottom - top
    pitch = max(float(np.sqrt(wide * high / len(x))), (wide + high) / 4000, 1e-9)
    columns, rows = (np.rint((c - least) / pitch).astype(np.int64) for c, least in ((x, left), (y, top)))
    return Raster(columns, rows, (left, top), pitch, ("x in mm", "y in mm"))


def lay(grid: Raster, values: NDArray[np.float32]) -> tuple[Map, Extent]:
    """Values (N, C) of points as a map (h, w, C), NaN where there is no point, and the map's extent.

    The map ends where the points end, a few strays left aside, so that a small object fills it.
    """
    left, top, right, bottom = (round(edge) for edge in _box(grid.columns, grid.rows))
    inside = (grid.columns >= left) & (grid.columns <= right) & (grid.rows >= top) & (grid.rows <= bottom)
    laid = np.full((bottom - top + 1, right - left + 1, values.shape[1]), np.nan, np.float32)
    laid[grid.rows[inside] - top, grid.columns[inside] - left] = values[inside]
    x, y = grid.origin
    edges = np.array([left - 0.5, right + 0.5, bottom + 0.5, top - 0.5]) * grid.pitch + [x, x, y, y]
    return laid, cast(Extent, tuple(edges.tolist()))


def block_mean(values: Map, columns: int) -> Map:
    """Means over square blocks, down to about `columns`, of what is known; NaN where under half is.

    values: (h, w) or (h, w, C).
    """
    step = max(1, min(round(values.shape[1] / columns), values.shape[0]))
    if step == 1:
        return values
    height, width = (n // step * step for n in values.shape[:2])
    blocks = values[:height, :width].reshape(height // step, step, width // step, step, *values.shape[2:])
    known: Mask = np.isfinite(blocks)
    count = known.sum((1, 3))
    total = np.where(known, blocks, 0.0).sum((1, 3), dtype=np.float64)
    mean = np.where(2 * count >= step * step, total / np.maximum(count, 1), np.nan)
    return cast(Map, mean.astype(np.float32))


def _box(columns: NDArray[Any], rows: NDArray[Any]) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of all but the strays, with a margin."""
    (left, right), (top, bottom) = (np.percentile(c, (STRAYS, 100 - STRAYS)) for c in (columns, rows))
    margin = MARGIN * max(right - left, bottom - top)
    return (
        float(max(left - margin, columns.min())),
        float(max(top - margin, rows.min())),
        float(min(right + margin, columns.max())),
        float(min(bottom + margin, rows.max())),
    )
