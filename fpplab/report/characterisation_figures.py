"""Figures of a characterisation beyond residuals: epipolar distances, the board's shape, uncertainty."""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fpplab.characterisation import Characterisation, Judgement
from fpplab.characterisation.lens import scales_of_poses
from fpplab.characterisation.limits import USUAL_LIMITS
from fpplab.characterisation.result import board_deviation, epipolar_distances
from fpplab.characterisation.validation import projected_uncertainty
from fpplab.core.conventions import Floats
from fpplab.core.drawing import (
    ACCENT,
    FULL,
    HALF,
    INK,
    SECOND,
    as_png,
    colour_bar,
    map_height,
    name_poses,
    new_figure,
    sensor_axes,
    side_by_side,
    single_axes,
)

EPIPOLAR = (
    "Distance in the projector's image between each point and the epipolar line of its camera pixel; it does "
    "not depend on the board. Where the mean of one pose differs from zero, something moved while that pose "
    "was captured."
)
MAPS = (
    "Standard uncertainty of the pixel at which a place is seen, at the boards' median distance, by the "
    "uncertainty of the device's model; a turn of the whole device does not count. Dots: the board's points. "
    "The model is extrapolated where there are none."
)
JUDGED = "RMS error of each pose (bars) and that which the calibration predicts (lines)."
SCALES = (
    "Scale of the camera's image in each pose relative to that of all, with its standard uncertainty by the "
    "noise of the points; band: what a locked lens keeps to. The projector determines where the board is, so "
    "that the board's distance does not explain another scale. One pose alone may be a board that moved."
)
BOARD = (
    "Deviation of the refined board from the board as drawn, after removal of position, rotation and scale. "
    "Left: out of its plane, positive away from the viewer. Right: within its plane."
)


@as_png
def epipolar_figure(characterisation: Characterisation) -> Figure:
    poses = [epipolar_distances(o, characterisation.calibration) for o in characterisation.observations]
    distances = np.concatenate(poses)
    rms = float(np.sqrt(np.mean(distances**2)))
    figure, (left, right) = side_by_side(2.9, (1.0, 1.5))
    reach = max(float(np.percentile(np.abs(distances), 99.5)), 1e-9) * 1.05
    left.hist(distances, np.linspace(-reach, reach, 41).tolist(), color=ACCENT)
    left.axvline(0, color=INK, linewidth=0.8)
    left.set(xlabel="distance from the epipolar line in px", ylabel="points", xlim=(-reach, reach))
    beyond = int(np.sum(np.abs(distances) > reach))
    more = f", {beyond} outside the plot" if beyond else ""
    left.set_title(f"RMS {rms:.3g} px, {len(distances)} points{more}", fontsize=8.5)
    _by_pose(right, [o.name for o in characterisation.observations], poses, reach)
    return figure


def _by_pose(axes: Axes, names: Sequence[str], poses: Sequence[Floats], reach: float) -> None:
    """Draw every point as a dot over its pose, with the mean as a line: motion shows as an offset."""
    for place, distances in enumerate(poses):
        spread = place + 0.3 * np.linspace(-1, 1, len(distances))
        axes.plot(spread, distances, ".", color=ACCENT, markersize=2.5, alpha=0.6)
    places = np.arange(len(poses))
    axes.hlines([d.mean() for d in poses], places - 0.4, places + 0.4, color=SECOND, linewidth=1.6)
    axes.axhline(0, color="#c4c8cc", linewidth=0.6, zorder=0)
    name_poses(axes, names)
    axes.set(ylabel="distance in px", ylim=(-reach, reach))
    axes.set_title("by pose, with its mean", fontsize=8.5)


@as_png
def scales_by_pose(characterisation: Characterisation) -> Figure:
    assert characterisation.solution is not None
    assert characterisation.sizes is not None
    scales, sigmas = scales_of_poses(
        characterisation.observations, characterisation.solution, characterisation.sizes
    )
    names, places = [o.name for o in characterisation.observations], np.arange(len(scales))
    figure, axes = single_axes(HALF, 2.9)
    limit = 100 * USUAL_LIMITS.max_focus_breathing
    axes.axhspan(-limit, limit, color=SECOND, alpha=0.2, linewidth=0)
    axes.errorbar(
        places, 100 * (scales - np.median(scales)), 100 * sigmas, fmt="o", color=ACCENT, markersize=4
    )
    name_poses(axes, names)
    axes.set(ylabel="scale relative to the median, in %")
    return figure


@as_png
def board_shape(characterisation: Characterisation) -> Figure:
    place, deviation = board_deviation(characterisation)
    (x, y), along, height = place[:, :2].T, deviation[:, :2], deviation[:, 2]
    sides = np.ptp(place[:, :2], axis=0)
    figure = new_figure(FULL, map_height((int(sides[1]) + 1, int(sides[0]) + 1), 0.5 * FULL) + 0.4)
    left, right = cast(Any, figure.subplots(1, 2))
    limit = max(float(np.abs(height).max()), 1e-9)
    dots = left.scatter(x, y, c=height, s=90, cmap="RdBu_r", vmin=-limit, vmax=limit, edgecolors=INK,
                        linewidths=0.3)  # fmt: skip
    colour_bar(figure, left, dots, "out of the plane in µm")
    left.set_title(f"out of the plane: RMS {_rms(height):.3g} µm, span {np.ptp(height):.3g} µm", fontsize=8.5)
    size = _rms(np.linalg.norm(along, axis=1))
    arrows = right.quiver(x, y, *along.T, angles="xy", scale_units="xy", scale=20 * size / max(sides),
                          color=ACCENT, width=0.004)  # fmt: skip
    right.quiverkey(arrows, 0.8, 1.06, size, f"{size:.2g} µm", labelpos="E", coordinates="axes")
    right.plot(x, y, ".", color=INK, markersize=1.5)
    right.set_title(f"in the plane: RMS {size:.3g} µm", fontsize=8.5, loc="left")
    edge = 0.14 * max(sides)
    for axes in (left, right):
        axes.set(xlabel="board x in mm", ylabel="board y in mm", aspect="equal")
        axes.set(xlim=(x.min() - edge, x.max() + edge), ylim=(y.max() + edge, y.min() - edge))
    return figure


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


@as_png
def uncertainty_maps(characterisation: Characterisation) -> Figure:
    calibration, grid = characterisation.calibration, (24, 32)
    figure, both = side_by_side(3.4, (1.0, 1.0))
    to_projector = [calibration.T_projector_camera @ pose for pose in characterisation.poses]
    by_device = zip(
        both, characterisation.by_device.items(), (characterisation.poses, to_projector), strict=True
    )
    for axes, (device, seen), poses in by_device:
        size = seen.size
        u, v = (np.linspace(0, n - 1, k) for n, k in zip(size, grid[::-1], strict=True))
        places = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        distance = float(np.median([pose.translation[2] for pose in poses]))
        sigma = projected_uncertainty(calibration, device, places, distance).reshape(grid)
        limit = float(np.percentile(sigma, 98))
        mapped = axes.imshow(
            sigma, cmap="viridis", vmin=0, vmax=limit, interpolation="bilinear",
            extent=(-0.5, size[0] - 0.5, size[1] - 0.5, -0.5),
        )  # fmt: skip
        sensor_axes(axes, size, device)
        axes.plot(*np.concatenate(seen.pixels).T, ".", color="white", markersize=1.0, alpha=0.5)
        colour_bar(figure, axes, mapped, "standard uncertainty in px")
        axes.set_title(f"{device} at {distance:.0f} mm: median {np.median(sigma):.2g} px", fontsize=8.5)
    return figure


@as_png
def judged_errors(judgement: Judgement) -> Figure:
    figure, both = side_by_side(2.6, (1.0, 1.0))
    places, names = np.arange(len(judgement.poses)), [pose.name for pose in judgement.poses]
    for axes, device in zip(both, ("camera", "projector"), strict=True):
        errors = [getattr(pose, device) for pose in judgement.poses]
        colours = [SECOND if error.contradicts else ACCENT for error in errors]
        axes.bar(places, [error.rms_px for error in errors], width=0.7, color=colours)
        axes.hlines(
            [error.predicted_px for error in errors], places - 0.42, places + 0.42, color=INK, linewidth=1.6
        )
        name_poses(axes, names)
        axes.set(ylabel="RMS error in px")
        axes.set_title(device, fontsize=8.5)
    return figure
