"""Points on the pixel grid of an image, and maps made of them."""

from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Map, Mask
from fpplab.core.errors import DataError

Extent = tuple[float, float, float, float]
"""Left, right, bottom and top edge of a map in the units of its axes."""


class CloudLike(Protocol):
    """What the figures need of a cloud."""

    @property
    def points(self) -> NDArray[np.float32]:
        """Points (N, 3) in mm."""

    @property
    def pixels(self) -> NDArray[np.int32] | None:
        """Camera pixels (N, 2), or None."""


class Raster(NamedTuple):
    """Where N points lie on a grid."""

    columns: NDArray[np.int64]  # (N,)
    rows: NDArray[np.int64]  # (N,)
    origin: tuple[float, float]  # coordinates of column 0 and row 0 in the units of the axes
    pitch: float  # of columns and rows, in the units of the axes
    names: tuple[str, str]  # labels of the horizontal and the vertical axis


def raster_of(cloud: CloudLike) -> Raster:
    """Put points on the grid of the camera's pixels; without these, on one in mm across the optical axis."""
    if not len(cloud.points):
        raise DataError("the cloud has no points; nothing to draw")
    if cloud.pixels is not None:
        u, v = cloud.pixels.T.astype(np.int64)
        return Raster(u, v, (0.0, 0.0), 1.0, ("camera u in px", "camera v in px"))
    x, y = cloud.points[:, :2].T.astype(np.float64)
    left, top, right, bottom = _bounds_without_outliers(x, y)
    wide, high = right - left, bottom - top
    pitch = max(float(np.sqrt(wide * high / len(x))), (wide + high) / 4000, 1e-9)
    columns, rows = (np.rint((c - lower) / pitch).astype(np.int64) for c, lower in ((x, left), (y, top)))
    return Raster(columns, rows, (left, top), pitch, ("x in mm", "y in mm"))


def rasterise(grid: Raster, values: NDArray[np.float32]) -> tuple[Map, Extent]:
    # The map is cropped to the points with a margin, a few outliers left aside, so that a small object fills
    # it.
    # values (N, C); returns (h, w, C)
    left, top, right, bottom = (round(edge) for edge in _bounds_without_outliers(grid.columns, grid.rows))
    inside = (grid.columns >= left) & (grid.columns <= right) & (grid.rows >= top) & (grid.rows <= bottom)
    mapped = np.full((bottom - top + 1, right - left + 1, values.shape[1]), np.nan, np.float32)
    mapped[grid.rows[inside] - top, grid.columns[inside] - left] = values[inside]
    x, y = grid.origin
    edges = np.array([left - 0.5, right + 0.5, bottom + 0.5, top - 0.5]) * grid.pitch + [x, x, y, y]
    return mapped, cast(Extent, tuple(edges.tolist()))


def block_mean(values: Map, columns: int) -> Map:
    # values (h, w)
    step = max(1, min(round(values.shape[1] / columns), values.shape[0]))
    if step == 1:
        return values
    height, width = (n // step * step for n in values.shape[:2])
    blocks = values[:height, :width].reshape(height // step, step, width // step, step, *values.shape[2:])
    finite: Mask = np.isfinite(blocks)
    count = finite.sum((1, 3))
    total = np.where(finite, blocks, 0.0).sum((1, 3), dtype=np.float64)
    mean = np.where(2 * count >= step * step, total / np.maximum(count, 1), np.nan)
    return cast(Map, mean.astype(np.float32))


def _bounds_without_outliers(columns: NDArray[Any], rows: NDArray[Any]) -> tuple[float, float, float, float]:
    (left, right), (top, bottom) = (np.percentile(c, (0.5, 99.5)) for c in (columns, rows))
    margin = 0.04 * max(right - left, bottom - top)
    return (
        float(max(left - margin, columns.min())),
        float(max(top - margin, rows.min())),
        float(min(right + margin, columns.max())),
        float(min(bottom + margin, rows.max())),
    )
