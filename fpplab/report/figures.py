"""Pictures of every step of a measurement, as PNG files in memory.

Maps are drawn as the camera or the projector sees them: u to the right, v down, in px.
Where nothing was measured the picture is grey. Matplotlib is used through its object
interface alone, so that drawing neither opens windows nor leaves state behind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Axis, Floats, Image, Map, Mask, full_scale
from fpplab.core.errors import DataError
from fpplab.patterns.response import Response
from fpplab.report.drawing import (
    ACCENT,
    ALARM,
    FULL,
    INK,
    SECOND,
    blank,
    colour_bar,
    map_height,
    map_sheet,
    pair,
    picture,
    sensor_axes,
    sheet,
    show,
    thinning,
    value_range,
)
from fpplab.report.raster import CloudLike, block_mean, lay, raster

RELIEF_COLUMNS = 760
"""Columns of a relief: points are averaged to this, which takes the noise out of the normals."""
CONTOUR_COLUMNS = 400


class ResponseLike(Protocol):
    """A response `out = a in^g + b`, both in [0, 1]."""

    @property
    def a(self) -> float: ...
    @property
    def b(self) -> float: ...
    @property
    def g(self) -> float: ...


@picture
def camera_image(image: Image, bits: int = 8) -> Figure:
    """One frame with its saturated pixels marked. image: raw integers [v, u]; bits: their depth."""
    full = full_scale(bits)
    saturated = image >= full
    figure, axes = map_sheet(image.shape)
    step = thinning(image.shape)
    bright = max(float(np.percentile(image[::step, ::step], 99.8)), 1.0)
    mappable = show(axes, image, "gray", (0.0, bright))
    share = float(saturated.mean())
    label = f"{saturated.sum():,} saturated pixels ({100 * share:.2g} %)" if share else "no saturated pixels"
    if share:
        marks = cv2.dilate(saturated.astype(np.uint8), np.ones((2 * step + 1,) * 2, np.uint8)) > 0
        overlay = np.where(marks, 1.0, np.nan)
        show(axes, overlay, mpl.colors.ListedColormap([ALARM]), (0.0, 1.0), background=False)
    axes.legend(
        handles=[Patch(facecolor=ALARM if share else "none", label=label)],
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        borderpad=0.1,
        handlelength=1.0 if share else 0.0,
    )
    colour_bar(figure, axes, mappable, f"grey level (full scale {full})")
    return figure


@picture
def wrapped_phase_figure(phase: Map) -> Figure:
    """The phase of one fringe set in rad, [0, 2π), on a cyclic colour map."""
    figure, axes = map_sheet(phase.shape)
    bar = colour_bar(figure, axes, show(axes, phase, "twilight", (0.0, TWO_PI)), "wrapped phase in rad")
    bar.set_ticks([0, np.pi / 2, np.pi, 1.5 * np.pi, TWO_PI], labels=["0", "π/2", "π", "3π/2", "2π"])
    return figure


@picture
def coordinate(values: Map, axis: Axis) -> Figure:
    """The projector's coordinate in px along `axis`, with contour lines."""
    figure, axes = map_sheet(values.shape)
    limits = value_range(values, 0.1, 99.9)
    mappable = show(axes, values, "viridis", limits)
    bar = colour_bar(figure, axes, mappable, f"projector {'u' if axis == 'x' else 'v'} in px")
    coarse, (height, width) = block_mean(values, CONTOUR_COLUMNS), values.shape
    levels = mpl.ticker.MaxNLocator(14).tick_values(*limits)
    known = coarse[np.isfinite(coarse)]
    levels = [level for level in levels if len(known) and known.min() < level < known.max()]
    if levels:
        u, v = np.linspace(0, width - 1, coarse.shape[1]), np.linspace(0, height - 1, coarse.shape[0])
        lines = axes.contour(u, v, coarse, levels=levels, colors="white", linewidths=0.6, alpha=0.75)
        bar.add_lines(lines)
    return figure


@picture
def modulation(values: Map) -> Figure:
    """The fringes' amplitude in grey levels of 255."""
    figure, axes = map_sheet(values.shape)
    mappable = show(axes, values, "inferno", (0.0, value_range(values, 0.0, 99.5)[1]))
    colour_bar(figure, axes, mappable, "modulation in grey levels of 255")
    return figure


@picture
def relief(cloud: CloudLike) -> Figure:
    """The measured surface under a light from the upper left, as the camera sees it."""
    grid = raster(cloud)
    points, extent = lay(grid, cloud.points)
    figure, axes = map_sheet(points.shape)
    show(axes, shading(points), "gray", (0.0, 1.0), extent)
    axes.set(xlabel=grid.names[0], ylabel=grid.names[1])
    return figure


@picture
def depth(cloud: CloudLike) -> Figure:
    """Distance from the camera along its axis, in mm."""
    grid = raster(cloud)
    laid, extent = lay(grid, cloud.points[:, 2:])
    figure, axes = map_sheet(laid.shape)
    mappable = show(axes, laid[..., 0], "viridis_r", value_range(laid, 0.5, 99.5), extent)
    axes.set(xlabel=grid.names[0], ylabel=grid.names[1])
    colour_bar(figure, axes, mappable, "distance z from the camera in mm")
    return figure


def shading(points: Map) -> Map:
    """Brightness in [0, 1] of a lit matt surface, NaN where there is none.

    points: (h, w, 3) in mm of the camera's frame, NaN where not measured. The result is
    averaged to about `RELIEF_COLUMNS` columns.
    """
    coarse = block_mean(points, RELIEF_COLUMNS)
    known = np.isfinite(coarse[..., 0])
    if min(known.shape) < 2:  # one line of pixels has no normals
        return np.where(known, np.float32(0.5), np.float32(np.nan))
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), 1.2)
    smooth = cv2.GaussianBlur(np.nan_to_num(coarse), (0, 0), 1.2) / np.maximum(weight, 1e-6)[..., None]
    normals = np.cross(np.gradient(smooth, axis=1), np.gradient(smooth, axis=0))
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
    normals *= -np.sign(normals[..., 2:])  # towards the camera
    light = np.array([-0.55, -0.65, -0.8]) / np.linalg.norm([-0.55, -0.65, -0.8])
    halfway = (light + [0.0, 0.0, -1.0]) / np.linalg.norm(light + [0.0, 0.0, -1.0])
    matt, gloss = np.clip(normals @ light, 0, 1), np.clip(normals @ halfway, 0, 1) ** 24
    bright = 0.08 + 0.80 * matt + 0.12 * gloss
    return np.where(known, bright, np.nan).astype(np.float32)


@picture
def error_map(
    cloud: CloudLike, distances_mm: NDArray[np.floating[Any]], counted: Mask | None = None
) -> Figure:
    """The cloud coloured by its signed distance from the true shape, with the distribution.

    distances_mm: (N,) signed, NaN where a point has no counterpart. counted: (N,), the points
    that are compared; the others are left out. The colours span ± the 98th percentile of the
    absolute distance, which is stated. Raises `DataError` when nothing is left to draw.
    """
    errors = 1e3 * np.asarray(distances_mm, np.float32)
    if counted is not None:
        errors = np.where(counted, errors, np.float32(np.nan))
    known = errors[np.isfinite(errors)]
    if len(errors) != len(cloud.points) or not len(known):
        raise DataError(f"{len(cloud.points)} points were given with {len(known)} distances; nothing to draw")
    grid, limit = raster(cloud), error_limit(errors)
    laid, extent = lay(grid, errors[:, None])
    figure, (left, right) = pair(map_height(laid.shape, 0.64 * FULL), (2.15, 1.0))
    mappable = show(left, laid[..., 0], "RdBu_r", (-limit, limit), extent)
    left.set(xlabel=grid.names[0], ylabel=grid.names[1])
    colour_bar(figure, left, mappable, f"signed error in µm (range ±{limit:.3g}, 98 % of points)")
    _distribution(right, known, limit)
    return figure


def _distribution(axes: Axes, errors: NDArray[np.floating[Any]], limit: float) -> None:
    edges = np.linspace(-limit, limit, 61)
    share = 100 * np.histogram(errors, edges)[0] / len(errors)
    colours = mpl.colormaps["RdBu_r"](np.linspace(0, 1, 60))
    width = np.diff(edges)
    axes.bar(edges[:-1], share, width, align="edge", color=colours, edgecolor="#5a6068", linewidth=0.25)
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.set(xlabel="signed error in µm", ylabel="share of the points in %", xlim=(-limit, limit))
    rms, median = np.sqrt(np.mean(errors**2, dtype=np.float64)), np.median(errors)
    axes.set_title(f"RMS {rms:.3g} µm, median {median:+.2g} µm\n{len(errors):,} points", fontsize=8.5)


def error_limit(errors: NDArray[np.floating[Any]]) -> float:
    """Half the symmetric colour range of signed errors: the 98th percentile of what is finite."""
    known = np.abs(errors[np.isfinite(errors)])
    return max(float(np.percentile(known, 98)), 1e-6) if len(known) else 1.0


@picture
def residuals_figure(pixels: Floats, errors: Floats, size: tuple[int, int], device: str) -> Figure:
    """Reprojection errors over the sensor as vectors, and as a scatter with its RMS circle.

    pixels, errors: (N, 2) in px; size: (width, height) of the `device`, "camera" or "projector".
    """
    if pixels.shape != errors.shape or not len(pixels):
        raise DataError(f"{device}: {len(errors)} residuals were given for {len(pixels)} pixels")
    length = np.linalg.norm(errors, axis=1)
    rms = float(np.sqrt(np.mean(length**2)))
    figure, (left, right) = pair(min(map_height(size[::-1], 0.6 * FULL), 0.44 * FULL), (1.6, 1.0))
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
    left.set_title(" ", fontsize=8.5)  # makes room for the key
    right.scatter(errors[:, 0], errors[:, 1], s=4, color=ACCENT, alpha=0.35, linewidths=0)
    right.add_patch(Circle((0, 0), rms, fill=False, color=SECOND, linewidth=1.4))
    reach = 1.08 * max(float(np.percentile(length, 99.5)), 1.3 * rms, 1e-12)
    right.set(
        xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal", xlabel="Δu in px", ylabel="Δv in px"
    )
    right.axhline(0, color="#c4c8cc", linewidth=0.6, zorder=0)
    right.axvline(0, color="#c4c8cc", linewidth=0.6, zorder=0)
    beyond = int(np.sum(np.max(np.abs(errors), axis=1) > reach))
    more = f", {beyond} beyond the frame" if beyond else ""
    right.set_title(f"RMS {rms:.3g} px (circle), {len(errors)} points{more}", fontsize=8.5)
    return figure


@picture
def coverage(poses: Sequence[Floats], size: tuple[int, int], device: str) -> Figure:
    """Where the board's points lay on a sensor, one colour per pose.

    poses: (N, 2) px each; size: (width, height) of the `device`.
    """
    figure, axes = map_sheet(size[::-1])
    sensor_axes(axes, size, device)
    axes.set_facecolor("white")
    colours = mpl.colormaps["turbo"](np.linspace(0.05, 0.95, len(poses)))
    for points, colour in zip(poses, colours, strict=True):
        axes.scatter(points[:, 0], points[:, 1], s=5, color=colour, linewidths=0)
    hull = cv2.convexHull(np.concatenate(poses).astype(np.float32))[:, 0]
    axes.fill(*hull.T, facecolor=ACCENT, alpha=0.07, edgecolor=ACCENT, linewidth=0.8)
    covered = cv2.contourArea(hull) / (size[0] * size[1])
    axes.set_title(f"{len(poses)} poses span {100 * covered:.0f} % of the {device}", fontsize=8.5)
    return figure


@picture
def response_curve(response: ResponseLike, levels: Floats) -> Figure:
    """Levels measured and fitted, and what remains. levels: (K, 2), in and out, both in [0, 1]."""
    shown, seen = levels.T
    axis = np.linspace(0, 1, 200)
    figure, (left, right) = pair(3.2, (1.3, 1.0))
    left.plot(
        axis,
        response.a * axis**response.g + response.b,
        color=SECOND,
        linewidth=1.5,
        label=_formula(response),
    )
    left.plot(shown, seen, "o", color=ACCENT, markersize=4, label="measured")
    left.set(
        xlabel="level shown, of full scale",
        ylabel="level seen, of full scale",
        xlim=(-0.02, 1.02),
        ylim=(min(0.0, float(seen.min())), None),
    )
    left.legend(loc="upper left")
    rest = 255 * (seen - (response.a * shown**response.g + response.b))
    right.axhline(0, color=SECOND, linewidth=1.2)
    right.vlines(shown, 0, rest, color=ACCENT, linewidth=1.0)
    right.plot(shown, rest, "o", color=ACCENT, markersize=4)
    right.set(
        xlabel="level shown, of full scale",
        ylabel="measured − fitted, in grey levels of 255",
        xlim=(-0.02, 1.02),
    )
    return figure


@picture
def response_fit(response: Response) -> Figure:
    """A fitted response: levels with error bars and the curve, the misfit below, regions' exponents beside.

    Error bars span two standard uncertainties each way.
    Raises `DataError` for a response that does not say what it was fitted to.
    """
    if not response.measured or not response.regions:
        raise DataError("the response holds no levels and regions to draw; measure it with `fpplab gamma`")
    shown, seen, rest = np.array([(p.shown, p.seen, p.residual) for p in response.measured]).T
    error = 2 * np.array([p.sigma or 0.0 for p in response.measured])
    figure = blank(FULL, 3.8)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1.0), height_ratios=(1.7, 1.0))
    curve, misfit = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    axis = np.linspace(0, 1, 200)
    curve.plot(axis, response.apply(axis), color=SECOND, linewidth=1.5, label=_formula(response))
    curve.errorbar(
        shown,
        seen,
        error,
        fmt="o",
        color=ACCENT,
        markersize=3.5,
        label="seen, ± 2 standard uncertainties",
        capsize=2,
    )
    curve.set(ylabel="level seen, of full scale", xlim=(-0.02, 1.02))
    curve.legend(loc="upper left")
    misfit.axhline(0, color=SECOND, linewidth=1.2)
    misfit.errorbar(shown, 255 * rest, 255 * error, fmt="o", color=ACCENT, markersize=3.5, capsize=2)
    misfit.set(
        xlabel="level shown, of full scale", ylabel="seen − fitted\nin greys of 255", xlim=(-0.02, 1.02)
    )
    _region_exponents(figure.add_subplot(grid[:, 1]), response)
    return figure


def _region_exponents(axes: Axes, response: Response) -> None:
    """G of every region, with two standard uncertainties, against that of all together."""
    names = [f"{r.row + 1}, {r.column + 1}" for r in response.regions]
    place = np.arange(len(names))
    reach = 2 * response.sigma[2]
    axes.axvspan(response.g - reach, response.g + reach, color=SECOND, alpha=0.25, linewidth=0)
    axes.axvline(response.g, color=SECOND, linewidth=1.2)
    axes.errorbar(
        [r.g for r in response.regions],
        place,
        xerr=[2 * r.sigma_g for r in response.regions],
        fmt="o",
        color=ACCENT,
        markersize=3.5,
        capsize=2,
    )
    axes.set_yticks(place, names)
    axes.set(xlabel="exponent g of each region", ylabel="region: row, column", ylim=(len(names) - 0.5, -0.5))
    axes.xaxis.set_major_formatter(mpl.ticker.FormatStrFormatter("%.4f"))
    axes.xaxis.set_major_locator(mpl.ticker.MaxNLocator(4))


@picture
def pose_rms(names: Sequence[str], camera_px: Sequence[float], projector_px: Sequence[float]) -> Figure:
    """RMS reprojection error of each pose in px, camera and projector side by side."""
    figure, axes = sheet(FULL, 2.6)
    place = np.arange(len(names))
    axes.bar(place - 0.2, camera_px, 0.38, color=ACCENT, label="camera")
    axes.bar(place + 0.2, projector_px, 0.38, color=SECOND, label="projector")
    axes.set_xticks(
        place, names, rotation=35 if len(names) > 8 else 0, ha="right" if len(names) > 8 else "center"
    )
    axes.set(ylabel="RMS error in px", xlim=(-0.6, len(names) - 0.4))
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return figure


@picture
def marker_levels(shown: NDArray[np.integer[Any]], seen: Mapping[str, Floats]) -> Figure:
    """Levels seen of the uniform grey-level images of a marker, and those expected of frames in step.

    shown: (K,) greys in their order. seen: (K,) shares of full scale of each run, NaN where no frame came. A
    run's levels are expected to rise with the greys, so what is expected are the levels seen, in that order.
    """
    figure = blank(FULL, 2.6)
    sheets = np.atleast_1d(figure.subplots(1, len(seen), sharey=True))
    for axes, (how, levels) in zip(sheets, seen.items(), strict=True):
        known = np.flatnonzero(np.isfinite(levels))
        expected = np.sort(levels[known])[np.argsort(np.argsort(shown[known]))]
        axes.plot(known, expected, color=SECOND, linewidth=1.2, label="in step")
        axes.plot(known, levels[known], "o", color=ACCENT, markersize=4, label="seen")
        astray = known[np.abs(levels[known] - expected) > 0.05 * np.ptp(levels[known])]
        axes.plot(astray, levels[astray], "o", color=ALARM, markersize=4, label="seen, of another grey")
        axes.set(xlabel="frame", xlim=(-0.5, len(shown) - 0.5))
        axes.set_title(how, fontsize=8.5)
    sheets[0].set(ylabel="level, of full scale")
    sheets[0].legend(loc="upper left", bbox_to_anchor=(0.0, -0.2), ncols=3)
    return figure


def _formula(response: ResponseLike) -> str:
    sign = "+" if response.b >= 0 else "−"
    return rf"{response.a:.3f} · level$^{{{response.g:.3f}}}$ {sign} {abs(response.b):.3f}"
