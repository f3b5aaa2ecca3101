"""Figures that several causes share, and what they draw with."""

from typing import Any

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.core.drawing import (
    ALARM,
    HALF,
    SECOND,
    colour_bar,
    draw_map,
    map_axes,
    new_figure,
    side_by_side,
    single_axes,
)
from fpplab.diagnosis.brightness import BrightnessLimits, frame_levels
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import Figure, Finding
from fpplab.diagnosis.fringe_shape import FringeShapeLimits, phase_deviations
from fpplab.diagnosis.sample import FrameSample


def curve_axes() -> tuple[Figure, Any]:
    return single_axes(HALF, 2.4)


def sample_extent(sample: FrameSample) -> tuple[float, float, float, float]:
    """Give the edges of the camera's image: left, right, bottom, top in px."""
    height, width = sample.recording.frames[0].shape
    return (-0.5, width - 0.5, height - 0.5, -0.5)


def draw_sample_map(
    values: Floats, sample: FrameSample, colours: str, limits: tuple[float, float], label: str
) -> Figure:
    figure, axes = map_axes(values.shape)
    colour_bar(figure, axes, draw_map(axes, values, colours, limits, sample_extent(sample)), label)
    return figure


def draw_phases_by_set(evidence: Evidence, _: Finding) -> Figure:
    """Draw the wrapped phase of every fringe set, under the axis and number of stripes of the plan."""
    sample, sets = evidence.frames, evidence.frames.recording.plan.fringes
    columns = min(len(sets), 3)
    rows = -(-len(sets) // columns)
    figure = new_figure(2.4 * columns, 2.0 * rows)
    panels = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axes, fringe, fit in zip(panels, sets, sample.fits, strict=False):
        axes.imshow(np.where(sample.lit, fit.phase, np.nan), cmap="twilight", vmin=-np.pi, vmax=np.pi)
        axes.set_title(f"plan: {fringe.stripes:g} stripes along {fringe.axis}", fontsize=8)
    for axes in panels:
        axes.set_axis_off()
    return figure


def draw_limit(axes: Any, value: float, label: str) -> None:
    axes.axvline(value, color=ALARM, linewidth=1.2, label=f"limit {value:.3g}: {label}")
    axes.legend(loc="best")


def draw_rate(_: Evidence, finding: Finding) -> Figure:
    """Draw how many frames per second a plan takes compared with what is possible."""
    figure, axes = single_axes(HALF, 1.5)
    axes.barh(["possible", "needed"], [1.0, finding.excess], color=[SECOND, ALARM], height=0.6)
    axes.axvline(1.0, color=SECOND, linewidth=1.2)
    axes.set(xlabel="frames per second, as a multiple of those possible")
    return figure


def draw_focus(evidence: Evidence, _: Finding) -> Figure:
    """Draw the part of the image with the sharpest edges, and the contrast of the finest fringes."""
    sample = evidence.frames
    figure, (left, right) = side_by_side(3.0, (1.0, 1.4))
    tile = sample.offsets_in_tiles.mean(axis=0)[0]
    left.imshow(tile, cmap="gray")
    left.set(xlabel="px", ylabel="px", title="part of the image with most contrast")
    finest = sample.fits[sample.recording.plan.finest_set()].modulation
    share = np.where(sample.measured, finest / np.maximum(sample.widest.modulation, 1e-3), np.nan)
    shown = draw_map(right, share, "viridis", (0.0, 1.0), sample_extent(sample))
    colour_bar(figure, right, shown, "contrast of the finest fringes\nover that of the widest")
    return figure


def draw_errors_by_phase(evidence: Evidence, _: Finding) -> Figure:
    """Draw, by phase, how fringes depart from sinusoids and the phase from the coordinate's."""
    sample = evidence.frames
    figure, (left, right) = side_by_side(2.8, (1.0, 1.0))
    for k, fringe in enumerate(sample.recording.plan.fringes):
        fit, used = sample.fits[k], sample.measured
        if fringe.images > 3 and used.any():
            a, b = sample.recording.plan.set_starts[k : k + 2]
            angles = fit.phase[used] - fringe.phase_shifts()[:, None]
            normalised = (sample.spread[a:b, used] - fit.offset[used]) / fit.modulation[used]
            left.plot(
                *_mean_by_phase_bin(angles, normalised - np.cos(angles)), linewidth=1.2, label=f"set {k + 1}"
            )
    for k, expected, deviation in phase_deviations(sample):
        finite = np.isfinite(deviation)
        right.plot(
            *_mean_by_phase_bin(expected[finite], deviation[finite]), linewidth=1.2, label=f"set {k + 1}"
        )
    limit = sample.limits.of(FringeShapeLimits).min_harmonic_rad
    right.axhspan(-limit, limit, color=SECOND, alpha=0.2, linewidth=0)
    left.set(xlabel="phase in rad", ylabel="image − sinusoid, of the modulation")
    right.set(xlabel="phase in rad", ylabel="phase error in rad (band: RMS limit)")
    for axes in (left, right):
        if axes.lines:
            axes.legend(loc="best")
        else:
            axes.set_title("cannot be measured with these sets", fontsize=8.5)
    return figure


def _mean_by_phase_bin(angles: Floats, values: Floats, bins: int = 48) -> tuple[Floats, Floats]:
    place = np.floor((angles % (2 * np.pi)) / (2 * np.pi) * bins).astype(np.intp).ravel() % bins
    total, count = np.bincount(place, values.ravel(), bins), np.bincount(place, minlength=bins)
    with np.errstate(invalid="ignore"):
        mean = np.where(count >= 50, total / count, np.nan)  # the mean of fewer values is rough
    return (np.arange(bins) + 0.5) / bins * 2 * np.pi, mean


def draw_brightness_by_frame(sample: FrameSample, max_scatter: float) -> Figure:
    """Draw the brightness of each frame relative to the mean of its set, and the limit of its scatter."""
    levels, starts = frame_levels(sample), sample.recording.plan.set_starts
    figure, axes = curve_axes()
    sets = sample.recording.plan.fringes
    # The mean of a frame of few stripes depends on their phase.
    min_stripes = min(sample.limits.of(BrightnessLimits).min_stripes, max(fringe.stripes for fringe in sets))
    for k, fringe in enumerate(sets):
        if fringe.stripes < min_stripes:
            continue
        frames = np.arange(starts[k], starts[k + 1])
        percent = 100.0 * (levels[frames] / levels[frames].mean() - 1.0)
        axes.plot(frames + 1, percent, "o-", markersize=3, linewidth=0.8, label=f"{fringe.stripes:g} stripes")
    axes.axhspan(-100 * max_scatter, 100 * max_scatter, color=SECOND, alpha=0.2, linewidth=0)
    axes.set(xlabel="frame", ylabel="brightness relative to\nthat of the set, in % (band: limit)")
    axes.legend(loc="best", ncols=3)
    return figure
