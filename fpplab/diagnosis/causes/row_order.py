"""Rows or columns of the images are interchanged or wrapped around."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.config import Positive
from fpplab.core.conventions import TWO_PI, Axis, Floats
from fpplab.core.drawing import HALF, single_axes
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.limits import CountLimit, LimitsSection
from fpplab.diagnosis.sample import FrameSample


class RowOrderLimits(LimitsSection):
    """How unequally rows follow one another."""

    max_ratio: Positive = 2.0
    """Mean square of the phase's change from odd to even rows, beside that from even to odd ones. Derived: of
    interchanged rows it is 9 without noise, and 2 where what they are off is a third of the noise; of others
    it is 1."""
    min_pixels: CountLimit = 20
    """Measured pixels of a row, over all tiles, or of both ends of the image. Chosen."""
    max_steps_around: Positive = 5.0
    """Change of the coordinate from the last column to the first, in those from one to the next, of images
    whose columns are moved around. Chosen."""


def _changes_between_rows(sample: FrameSample, fringe_axis: Axis, axis: int, distance: int) -> Floats | None:
    """Mean square change in rad² of the phase from rows (axis 1) or columns (axis 2) of tiles to later ones.

    Of the finest set of one coded axis; None where too few pixels see it.
    """
    fit = sample.tile_fits[sample.recording.plan.finest_set(fringe_axis)]
    phase, modulation = (np.moveaxis(part, axis, 0) for part in (fit.phase, fit.modulation))
    lit = modulation > max(0.1 * float(np.percentile(modulation, 99)), 1.0)
    change = phase[distance:] - phase[:-distance]
    change -= TWO_PI * np.rint(change / TWO_PI)
    used = lit[distance:] & lit[:-distance]
    if used.sum(axis=(1, 2)).min() < sample.limits.of(RowOrderLimits).min_pixels:
        return None
    # The median leaves out edges of the part.
    return np.array([np.median(np.square(row[use])) for row, use in zip(change, used, strict=True)])


def _ratio(changes: Floats) -> float:
    """How much greater every other change is; blocks of a compression are but every eighth."""
    even, odd = float(np.median(changes[::2])), float(np.median(changes[1::2]))
    return max(even, odd) / max(min(even, odd), 1e-12)


def _worst_ratio(sample: FrameSample, axis: int) -> tuple[float, float]:
    """The greatest ratio of a set, and the shift of its phase from row to row, in rad."""
    worst = 1.0, 0.0
    for fringe_axis in sample.recording.plan.axes:
        near, far = (_changes_between_rows(sample, fringe_axis, axis, distance) for distance in (1, 2))
        if near is None or far is None:
            continue
        greatest = max(np.median(near[::2]), np.median(near[1::2]))
        # Rows in their order, even in steps, are as far from the next but one at least.
        if greatest > 1.3 * np.median(far) and _ratio(near) > worst[0]:
            worst = _ratio(near), float(np.sqrt(greatest)) / 3.0
    return worst


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample, limit = evidence.frames, evidence.limits.of(RowOrderLimits).max_ratio
    if not sample.measured.any():
        return
    for axis, name in ((1, "rows"), (2, "columns")):
        ratio, off = _worst_ratio(sample, axis)
        if ratio <= limit:
            continue
        cost = (
            f"; that puts points {off * evidence.um_per_rad:.0f} µm off, which σ does not contain"
            if evidence.has_points
            else ""
        )
        text = (
            f"{name} are interchanged in pairs: the phase changes {ratio:.1f} times as much, in squares, "
            f"from one pair to the next as within pairs (at most {limit:g}){cost}"
        )
        yield Finding(ROW_ORDER, text, ratio / limit)


def _find_moved_around(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    """Columns of images with fringes along x, or rows of those along y, that go on at the other end."""
    limits = evidence.limits.of(RowOrderLimits)
    if evidence.recording is None:
        return
    for fringe_axis, coordinate in evidence.frames.coordinates.items():
        axis, name = (1, "columns") if fringe_axis == "x" else (0, "rows")
        lines = np.moveaxis(coordinate, axis, 0)
        whole = np.flatnonzero(np.isfinite(lines[0]) & np.isfinite(lines[-1]))
        if len(whole) < limits.min_pixels:
            continue
        lines = lines[:, whole[:: max(1, len(whole) // limits.min_pixels)]]
        around = float(np.median(np.abs(lines[0] - lines[-1])))
        step = float(np.nanmedian(np.abs(np.diff(lines, axis=0))))
        between = float(np.median(np.nanmax(lines, axis=0) - np.nanmin(lines, axis=0)))
        # Of a camera that stands upright the coordinate grows from one end to the other.
        if around <= limits.max_steps_around * step and between > 0.5 * len(lines) * step:
            text = (
                f"{name} are moved around: from the last to the first the coordinate changes by "
                f"{around:.1f} px, as between neighbours, though it covers {between:.0f} px"
            )
            yield Finding(ROW_ORDER, text, len(lines) / limits.max_steps_around, ruins_points=True)


def _draw(evidence: Evidence, _: Finding) -> Figure:
    figure, axes = single_axes(HALF, 2.4)
    for axis, name in ((1, "rows"), (2, "columns")):
        for fringe_axis in evidence.frames.recording.plan.axes:
            curve = _changes_between_rows(evidence.frames, fringe_axis, axis, 1)
            if curve is not None:
                axes.plot(np.sqrt(curve), "o-", markersize=2, label=name)
    axes.set(xlabel="row or column of the tiles", ylabel="change of the phase\nto the next, in rad")
    axes.legend(loc="best")
    return figure


ROW_ORDER = FaultCause(
    key="row_order",
    meaning="Rows or columns of the images are interchanged or wrapped around.",
    remedy="check how the camera driver, or the program that wrote the images, combines fields or "
    "taps of the sensor, and record again",
    measured="change of phase from odd to even rows relative to that from even to odd; change of the "
    "coordinate from the last column to the first relative to that between neighbours",
    limit=f"{RowOrderLimits().max_ratio:g} times, in squares; {RowOrderLimits().max_steps_around:g} times",
    seen_in="frames",
    detectors=(Detector(DetectionStage.FRAMES, _find), Detector(DetectionStage.POINTS, _find_moved_around)),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"wrong_plan", "stale_calibration", "vibration"}),
)
