"""Figures of every step of a measurement, as PNG files in memory."""

from collections.abc import Sequence
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Mask
from fpplab.core.drawing import (
    ACCENT,
    ERROR_COLOURS,
    FULL,
    INK,
    SECOND,
    as_png,
    colour_bar,
    draw_map,
    map_axes,
    map_height,
    name_poses,
    new_figure,
    sensor_axes,
    side_by_side,
    single_axes,
)
from fpplab.core.errors import DataError
from fpplab.core.robust import error_limit
from fpplab.patterns.fringes import Pattern
from fpplab.report.raster import CloudLike, raster_of, rasterise


@as_png
def error_map(
    cloud: CloudLike,
    distances_mm: NDArray[np.floating[Any]],
    counted: Mask | None = None,
    quantity: str = "signed error",
) -> Figure:
    # The colours span ± the 98th percentile of the absolute distance, which the colour bar states.
    # distances_mm (N,); counted (N,)
    errors = 1e3 * np.asarray(distances_mm, np.float32)
    if counted is not None:
        errors = np.where(counted, errors, np.float32(np.nan))
    finite = errors[np.isfinite(errors)]
    if len(errors) != len(cloud.points) or not len(finite):
        raise DataError(
            f"{len(cloud.points)} points were given with {len(finite)} distances; nothing to draw"
        )
    grid, limit = raster_of(cloud), error_limit(errors)
    mapped, extent = rasterise(grid, errors[:, None])
    figure, (left, right) = side_by_side(map_height(mapped.shape, 0.64 * FULL), (2.15, 1.0))
    mappable = draw_map(left, mapped[..., 0], ERROR_COLOURS, (-limit, limit), extent)
    left.set(xlabel=grid.names[0], ylabel=grid.names[1])
    colour_bar(figure, left, mappable, f"{quantity} in µm (range ±{limit:.3g}, 98 % of points)")
    _distribution(right, finite, limit, quantity)
    return figure


def _distribution(axes: Axes, errors: NDArray[np.floating[Any]], limit: float, quantity: str) -> None:
    edges = np.linspace(-limit, limit, 61)
    share = 100 * np.histogram(errors, edges)[0] / len(errors)
    colours = mpl.colormaps[ERROR_COLOURS](np.linspace(0, 1, 60))
    width = np.diff(edges)
    axes.bar(edges[:-1], share, width, align="edge", color=colours, edgecolor="#5a6068", linewidth=0.25)
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.set(xlabel=f"{quantity} in µm", ylabel="share of the points in %", xlim=(-limit, limit))
    rms, median = np.sqrt(np.mean(errors**2, dtype=np.float64)), np.median(errors)
    axes.set_title(f"RMS {rms:.3g} µm, median {median:+.2g} µm\n{len(errors):,} points", fontsize=8.5)


@as_png
def residuals_figure(pixels: Floats, errors: Floats, size: tuple[int, int], device: str) -> Figure:
    # pixels (N, 2) px; errors (N, 2) px
    if pixels.shape != errors.shape or not len(pixels):
        raise DataError(f"{device}: {len(errors)} residuals were given for {len(pixels)} pixels")
    length = np.linalg.norm(errors, axis=1)
    rms = float(np.sqrt(np.mean(length**2)))
    figure, (left, right) = side_by_side(min(map_height(size[::-1], 0.6 * FULL), 0.44 * FULL), (1.6, 1.0))
    sensor_axes(left, size, device)
    left.set_facecolor("white")
    gain = 0.05 * max(size) / max(2.0 * rms, 1e-12)
    arrows = left.quiver(
        *pixels.T,
        *(errors * gain).T,
        length,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        cmap="cividis_r",
        clim=(0, 3 * rms),
        width=0.0022,
        headwidth=3.5,
    )
    left.quiverkey(arrows, 0.86, 1.04, rms * gain, f"{rms:.2g} px", labelpos="E", coordinates="axes")
    left.set_title(" ", fontsize=8.5)  # leaves space for the key
    right.scatter(errors[:, 0], errors[:, 1], s=4, color=ACCENT, alpha=0.35, linewidths=0)
    right.add_patch(Circle((0, 0), rms, fill=False, color=SECOND, linewidth=1.4))
    reach = 1.08 * max(float(np.percentile(length, 99.5)), 1.3 * rms, 1e-12)
    right.set(
        xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal", xlabel="Δu in px", ylabel="Δv in px"
    )
    right.axhline(0, color="#c4c8cc", linewidth=0.6, zorder=0)
    right.axvline(0, color="#c4c8cc", linewidth=0.6, zorder=0)
    beyond = int(np.sum(np.max(np.abs(errors), axis=1) > reach))
    more = f", {beyond} outside the plot" if beyond else ""
    right.set_title(f"RMS {rms:.3g} px (circle), {len(errors)} points{more}", fontsize=8.5)
    return figure


@as_png
def draw_coverage(poses: Sequence[Floats], size: tuple[int, int], device: str) -> Figure:
    # poses (N, 2) px
    figure, axes = map_axes(size[::-1])
    sensor_axes(axes, size, device)
    axes.set_facecolor("white")
    colours = mpl.colormaps["turbo"](np.linspace(0.05, 0.95, len(poses)))
    for points, colour in zip(poses, colours, strict=True):
        axes.scatter(points[:, 0], points[:, 1], s=5, color=colour, linewidths=0)
    hull = cv2.convexHull(np.concatenate(poses).astype(np.float32))[:, 0]
    axes.fill(*hull.T, facecolor=ACCENT, alpha=0.07, edgecolor=ACCENT, linewidth=0.8)
    covered = cv2.contourArea(hull) / (size[0] * size[1])
    axes.set_title(f"{len(poses)} poses span {100 * covered:.0f} % of the {device}'s image", fontsize=8.5)
    return figure


@as_png
def pose_rms(names: Sequence[str], camera_px: Sequence[float], projector_px: Sequence[float]) -> Figure:
    figure, axes = single_axes(FULL, 2.6)
    place = np.arange(len(names))
    axes.bar(place - 0.2, camera_px, 0.38, color=ACCENT, label="camera")
    axes.bar(place + 0.2, projector_px, 0.38, color=SECOND, label="projector")
    name_poses(axes, names)
    axes.set(ylabel="RMS error in px")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return figure


@as_png
def pattern_sheet(patterns: Sequence[Pattern]) -> Figure:
    # They are reduced by averaging: stripes that are too fine for the sheet appear grey.
    columns = 6
    rows = -(-len(patterns) // columns)
    figure = new_figure(FULL, 1.25 * rows)  # inches
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, pattern in zip(panels, patterns, strict=False):
        axes.imshow(pattern.image, cmap="gray", vmin=0, vmax=255, aspect="auto", interpolation="antialiased")
        axes.set_title(pattern.id, fontsize=6.5)
    return figure
