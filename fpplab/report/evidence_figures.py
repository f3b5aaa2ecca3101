"""Drawings that show what is wrong with frames or points, each with its limit."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fpplab.core.conventions import Floats
from fpplab.core.drawing import (
    ACCENT,
    ALARM,
    HALF,
    SECOND,
    as_png,
    colour_bar,
    draw_map,
    map_axes,
    new_figure,
    side_by_side,
    single_axes,
    value_range,
)
from fpplab.diagnosis import geometry, light
from fpplab.diagnosis.brightness import FEWEST_STRIPES, frame_levels, row_gains
from fpplab.diagnosis.fringe_shape import MOST_MOIRE_PX, moire_spectrum, phase_deviations
from fpplab.diagnosis.geometry import PointSample, triangulation_angles_deg
from fpplab.diagnosis.sample import FrameSample
from fpplab.report import figures

LOW = 2.4
"""Height in inches of curves."""
BINS, FEWEST_IN_BIN = 48, 50
"""Bins of a period, and the fewest values of a bin that are drawn."""
FROM_FRAME = "modulation in grey levels of 255"


def _extent(sample: FrameSample) -> tuple[float, float, float, float]:
    height, width = sample.recording.frames[0].shape
    return (-0.5, width - 0.5, height - 0.5, -0.5)


def _map(
    values: Floats, sample: FrameSample, colours: str, limits: tuple[float, float], label: str
) -> Figure:
    figure, axes = map_axes(values.shape)
    colour_bar(figure, axes, draw_map(axes, values, colours, limits, _extent(sample)), label)
    return figure


@as_png
def needed_rate(excess: float) -> Figure:
    """Draw how many frames per second a plan takes beside what is possible."""
    figure, axes = single_axes(HALF, 1.5)
    axes.barh(["possible", "needed"], [1.0, excess], color=[SECOND, ALARM], height=0.6)
    axes.axvline(1.0, color=SECOND, linewidth=1.2)
    axes.set(xlabel="frames per second, as a multiple of those possible")
    return figure


@as_png
def modulation_of_widest(sample: FrameSample) -> Figure:
    """Draw the modulation of the widest fringes."""
    values = sample.widest.modulation
    return _map(values, sample, "viridis", (0.0, max(sample.strongest, 1.0)), FROM_FRAME)


@as_png
def lit_part(sample: FrameSample) -> Figure:
    """Draw which part of the image sees the fringes."""
    figure, axes = map_axes(sample.lit.shape)
    mean = sample.spread.mean(axis=0)
    shown = draw_map(axes, mean, "gray", (0.0, max(float(np.percentile(mean, 99.8)), 1.0)), _extent(sample))
    colour_bar(figure, axes, shown, "mean grey level of 255")
    height, width = sample.lit.shape
    places = [np.arange(n) * sample.step for n in (width, height)]
    if sample.lit.any() and not sample.lit.all():
        axes.contour(*places, sample.lit, levels=[0.5], colors=[ALARM], linewidths=1.2)
    axes.set_title(f"{100 * sample.lit.mean():.2g} % see fringes (at least {100 * light.LEAST_LIT:g} %)")
    return figure


def brightest_frame(sample: FrameSample) -> bytes:
    """Draw the brightest grey level of every pixel, saturated ones marked."""
    recording = sample.recording
    return figures.camera_image(np.max(np.stack(recording.frames), axis=0), recording.bits)


@as_png
def brightness_histogram(sample: FrameSample) -> Figure:
    """Draw how bright lit pixels become, beside the least that the brightest should reach."""
    brightest = sample.spread.max(axis=0)
    shown = brightest[sample.lit] if sample.lit.any() else brightest.ravel()
    figure, axes = single_axes(HALF, LOW)
    axes.hist(100.0 * shown / 255.0, bins=list(range(101)), color=ACCENT)
    _limit(axes, 100.0 * light.LEAST_PEAK, "least that the brightest should reach")
    axes.set(xlabel="brightest grey level of a pixel, in % of full scale", ylabel="pixels", xlim=(0, 100))
    return figure


@as_png
def unchanging_light(sample: FrameSample) -> Figure:
    """Draw the light that does not change beside the modulation."""
    fit = sample.widest
    share = np.where(
        sample.measured, (fit.offset - fit.modulation) / np.maximum(fit.modulation, 1e-3), np.nan
    )
    most = max(2.0 * light.MOST_AMBIENT, value_range(share, 0, 95)[1]) if sample.measured.any() else 1.0
    return _map(
        share, sample, "magma", (0.0, most), f"other light over modulation (limit {light.MOST_AMBIENT:g})"
    )


@as_png
def focus(sample: FrameSample) -> Figure:
    """Draw the part of the image with the sharpest edges, and the contrast of the finest fringes."""
    figure, (left, right) = side_by_side(3.0, (1.0, 1.4))
    tile = sample.offsets_in_tiles.mean(axis=0)[0]
    left.imshow(tile, cmap="gray")
    left.set(xlabel="px", ylabel="px", title="part of the image with most contrast")
    finest = sample.fits[sample.recording.plan.finest_set()].modulation
    share = np.where(sample.measured, finest / np.maximum(sample.widest.modulation, 1e-3), np.nan)
    shown = draw_map(right, share, "viridis", (0.0, 1.0), _extent(sample))
    colour_bar(figure, right, shown, "contrast of the finest fringes\nover that of the widest")
    return figure


@as_png
def displaced_sets(sample: FrameSample) -> Figure:
    """Draw how far the scene is displaced in each fringe set, and what that changes in the image."""
    moved = [shift for shift, _ in light.displacements_px(sample)]
    worst = int(np.argmax(moved))
    change = (sample.offsets_in_tiles[worst + 1] - sample.offsets_in_tiles[0])[0]
    figure, (left, right) = side_by_side(3.0, (1.0, 1.4))
    most = max(float(np.abs(change).max()), 1.0)
    shown = left.imshow(change, cmap="RdBu", vmin=-most, vmax=most)
    colour_bar(figure, left, shown, f"set {worst + 2} − set 1, grey levels")
    left.set(xlabel="px", ylabel="px")
    right.bar(np.arange(2, len(moved) + 2), moved, color=ACCENT, width=0.6)
    right.axhline(light.MOST_SHIFT_PX, color=ALARM, linewidth=1.2, label=f"limit {light.MOST_SHIFT_PX:g} px")
    right.set(
        xlabel="fringe set", ylabel="displacement beside set 1 in px", xticks=np.arange(2, len(moved) + 2)
    )
    right.legend(loc="best")
    return figure


@as_png
def error_by_phase(sample: FrameSample) -> Figure:
    """Draw, by phase, how fringes depart from sinusoids and the phase from the coordinate's."""
    figure, (left, right) = side_by_side(2.8, (1.0, 1.0))
    for k, fringe in enumerate(sample.recording.plan.fringes):
        fit, used = sample.fits[k], sample.measured
        if fringe.images > 3 and used.any():
            a, b = sample.recording.plan.set_starts[k : k + 2]
            angles = fit.phase[used] - fringe.phase_shifts()[:, None]
            seen = (sample.spread[a:b, used] - fit.offset[used]) / fit.modulation[used]
            left.plot(*_binned(angles, seen - np.cos(angles)), linewidth=1.2, label=f"set {k + 1}")
    for k, expected, deviation in phase_deviations(sample):
        known = np.isfinite(deviation)
        right.plot(*_binned(expected[known], deviation[known]), linewidth=1.2, label=f"set {k + 1}")
    right.axhspan(-light.LEAST_HARMONIC_RAD, light.LEAST_HARMONIC_RAD, color=SECOND, alpha=0.2, linewidth=0)
    left.set(xlabel="phase in rad", ylabel="image − sinusoid, of the modulation")
    right.set(xlabel="phase in rad", ylabel="phase error in rad (band: RMS limit)")
    for axes in (left, right):
        if axes.lines:
            axes.legend(loc="best")
        else:
            axes.set_title("not to be told from these sets", fontsize=8.5)
    return figure


def _binned(angles: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Mean of values over one period."""
    place = np.floor((angles % (2 * np.pi)) / (2 * np.pi) * BINS).astype(np.intp).ravel() % BINS
    total, count = np.bincount(place, values.ravel(), BINS), np.bincount(place, minlength=BINS)
    with np.errstate(invalid="ignore"):
        mean = np.where(count >= FEWEST_IN_BIN, total / count, np.nan)
    return (np.arange(BINS) + 0.5) / BINS * 2 * np.pi, mean


@as_png
def brightness_by_frame(sample: FrameSample) -> Figure:
    """Draw the brightness of each frame beside the mean of its fringe set."""
    levels, starts = frame_levels(sample), sample.recording.plan.set_starts
    figure, axes = single_axes(HALF, LOW)
    sets = sample.recording.plan.fringes
    # The mean of a frame of few stripes depends on their phase.
    least = min(FEWEST_STRIPES, max(fringe.stripes for fringe in sets))
    for k, fringe in enumerate(sets):
        if fringe.stripes < least:
            continue
        own = np.arange(starts[k], starts[k + 1])
        off = 100.0 * (levels[own] / levels[own].mean() - 1.0)
        axes.plot(own + 1, off, "o-", markersize=3, linewidth=0.8, label=f"{fringe.stripes:g} stripes")
    axes.axhspan(-100 * light.MOST_FLICKER, 100 * light.MOST_FLICKER, color=SECOND, alpha=0.2, linewidth=0)
    axes.set(xlabel="frame", ylabel="brightness beside that\nof the set, in % (band: limit)")
    axes.legend(loc="best", ncols=3)
    return figure


@as_png
def _rows(gains: Floats) -> Figure:
    figure, axes = single_axes(HALF, 3.0)
    most = max(float(np.percentile(np.abs(100 * gains), 99)), 1.0)
    shown = axes.imshow(100.0 * gains.T, aspect="auto", cmap="RdBu", vmin=-most, vmax=most)
    colour_bar(figure, axes, shown, "brightness beside the fit, in %")
    axes.set(xlabel="frame", ylabel="lit row of the sample")
    return figure


def rows_by_frame(sample: FrameSample) -> bytes | None:
    """Draw the brightness of rows in each frame beside the fit of the fringes."""
    gains = row_gains(sample)
    return None if gains is None else _rows(gains)


def phase_disagreement(sample: FrameSample) -> bytes | None:
    """Draw where the phase of the wide fringes departs most from that of the finest."""
    found = [deviation for _, _, deviation in phase_deviations(sample)]
    return _disagreement(max(found, key=lambda one: float(np.nanstd(one))), sample) if found else None


@as_png
def _disagreement(deviation: Floats, sample: FrameSample) -> Figure:
    most = max(float(np.nanpercentile(np.abs(deviation), 98)), 0.05)
    return _map(deviation, sample, "RdBu", (-most, most), "phase of wide − fine fringes in rad")


def roughness_spectrum(sample: FrameSample) -> bytes | None:
    """Draw how often along the projector's pixels errors of the coordinate repeat."""
    found = [one for axis in sample.coordinates if (one := moire_spectrum(sample, axis)) is not None]
    return _spectrum(*max(found, key=lambda one: float(one[1].max()))) if found else None


@as_png
def _spectrum(cycles: Floats, amplitudes: Floats) -> Figure:
    figure, axes = single_axes(HALF, LOW)
    axes.plot(cycles, amplitudes, color=ACCENT, linewidth=1.0)
    axes.axhline(MOST_MOIRE_PX, color=ALARM, linewidth=1.2, label=f"limit {MOST_MOIRE_PX:g} px")
    axes.set(xlabel="cycles per projector px", ylabel="error of the coordinate\nin projector px")
    axes.legend(loc="best")
    return figure


@as_png
def phases_of_sets(sample: FrameSample) -> Figure:
    """Draw the wrapped phase of every fringe set, under the axis and number of stripes of the plan."""
    sets = sample.recording.plan.fringes
    columns = min(len(sets), 3)
    rows = -(-len(sets) // columns)
    figure = new_figure(2.4 * columns, 2.0 * rows)
    sheets = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axes, fringe, fit in zip(sheets, sets, sample.fits, strict=False):
        axes.imshow(np.where(sample.lit, fit.phase, np.nan), cmap="twilight", vmin=-np.pi, vmax=np.pi)
        axes.set_title(f"plan: {fringe.stripes:g} stripes along {fringe.axis}", fontsize=8)
    for axes in sheets:
        axes.set_axis_off()
    return figure


@as_png
def finest_fringes(sample: FrameSample) -> Figure:
    """Draw the finest fringes along some pixels in the middle of the image."""
    plan = sample.recording.plan
    k = plan.finest_set()
    frame = sample.recording.frames[plan.set_starts[k]]
    rows, columns = np.nonzero(sample.lit)
    row, column = (int(np.median(one)) * sample.step for one in (rows, columns))
    line = frame[row] if plan.fringes[k].axis == "x" else frame[:, column]
    middle = column if plan.fringes[k].axis == "x" else row
    shown = np.arange(max(middle - 30, 0), min(middle + 30, len(line)))
    figure, axes = single_axes(HALF, LOW)
    axes.plot(shown, line[shown], "o-", color=ACCENT, markersize=3, linewidth=0.8)
    across = "u" if plan.fringes[k].axis == "x" else "v"
    axes.set(xlabel=f"camera {across} in px", ylabel="grey level")
    axes.set_title(f"finest fringes; a stripe should cover {geometry.LEAST_PX_PER_STRIPE:g} px or more")
    return figure


@as_png
def angles(points: PointSample, _: FrameSample) -> Figure:
    """Draw the angles between the rays of camera and projector."""
    figure, axes = single_axes(HALF, LOW)
    axes.hist(triangulation_angles_deg(points.points, points.calibration), bins=60, color=ACCENT)
    _limit(axes, geometry.LEAST_ANGLE_DEG, "least")
    axes.set(xlabel="angle between the rays in degrees", ylabel="points")
    axes.set_xlim(left=0.0)
    return figure


@as_png
def sensitivity(points: PointSample, sample: FrameSample) -> Figure:
    """Draw how the projector's coordinates change with depth, those that the plan codes marked."""
    by_depth = points.px_per_mm_of_depth
    coded = [ACCENT if axis in sample.recording.plan.axes else SECOND for axis in "xy"]
    names = [
        f"{axis}{'' if colour == SECOND else ', of the plan'}"
        for axis, colour in zip("xy", coded, strict=True)
    ]
    figure, axes = single_axes(HALF, 1.8)
    axes.barh(names, by_depth, color=coded, height=0.6)
    least = geometry.LEAST_SENSITIVITY * float(np.linalg.norm(by_depth))
    _limit(axes, least, "least of the plan")
    axes.set(xlabel="change of the projector's coordinate in px per mm of depth")
    return figure


def epipolar_map(points: PointSample, _: FrameSample) -> bytes | None:
    """Draw how far points are off their epipolar lines."""
    off = points.cloud.epipolar_px
    if off is None or points.cloud.pixels is None:
        return None
    width, height = points.calibration.camera.size
    values = np.full((height, width), np.nan)
    u, v = points.cloud.pixels.T
    values[v, u] = off
    return _epipolar(values)


@as_png
def _epipolar(values: Floats) -> Figure:
    most = max(float(np.nanpercentile(np.abs(values), 98)), 2.0 * geometry.MOST_EPIPOLAR_PX)
    figure, axes = map_axes(values.shape)
    label = f"distance in projector px (limit {geometry.MOST_EPIPOLAR_PX:g})"
    colour_bar(figure, axes, draw_map(axes, values, "RdBu", (-most, most)), label)
    return figure


def _limit(axes: Any, value: float, what: str) -> None:
    axes.axvline(value, color=ALARM, linewidth=1.2, label=f"limit {value:.3g}: {what}")
    axes.legend(loc="best")
