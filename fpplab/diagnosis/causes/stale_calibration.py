"""The rig has changed since it was calibrated."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.config import Positive
from fpplab.core.drawing import ERROR_COLOURS, colour_bar, draw_map, map_axes
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.limits import DiagnosisLimits, LimitsSection
from fpplab.diagnosis.points import systematic_epipolar_px
from fpplab.phase import Decoded
from fpplab.phase.limits import GUIDED_AXIS


class StaleCalibrationLimits(LimitsSection):
    """How far points may be off their epipolar lines."""

    max_epipolar_px: Positive = 0.3
    """Systematic distance in projector px. Measured on benches."""


def _find_other_devices(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    if evidence.geometry and evidence.geometry.other_devices:
        advice = "use the calibration of these devices, or characterise them"
        # Half of what makes points useless: they may be far off, or right by chance.
        excess = 0.5 * STALE_CALIBRATION.useless_from
        yield Finding(STALE_CALIBRATION, evidence.geometry.other_devices, excess, advice)


def _find_changed_marks(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    if evidence.geometry and (change := evidence.geometry.change):
        yield Finding(STALE_CALIBRATION, change.sentence, change.excess, change.remedy)


def _find_moved_rig(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    off, limit = systematic_epipolar_px(evidence.points.cloud), _limit_px(evidence)
    if off is not None and off > limit:
        text = (
            f"points lie {off:.2f} projector px off their epipolar lines, systematically "
            f"(at most {limit:.2g})"
        )
        yield Finding(STALE_CALIBRATION, text, off / limit)


def _find_fringes_elsewhere(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    guided = evidence.decoded.guided if evidence.decoded else None
    if guided is None or not guided.is_contradicted:
        return
    text = (
        f"at {guided.share_off:.0%} of the pixels the fringes along {evidence.plan.guided_axis} lie more "
        f"than {GUIDED_AXIS.max_off_turns:g} periods from where the calibration puts them (at most "
        f"{GUIDED_AXIS.max_off_share:.0%}), so that nothing determines their orders"
    )
    yield Finding(STALE_CALIBRATION, text, STALE_CALIBRATION.useless_from)


def max_epipolar_px(limits: DiagnosisLimits, decoded: Decoded | None) -> float:
    """Give the greatest systematic distance from the epipolar lines that a sound rig may show."""
    guided = decoded.guided if decoded else None
    # Three steps do not suppress the second harmonic, which shifts coordinates and not the geometry.
    return math.hypot(
        limits.of(StaleCalibrationLimits).max_epipolar_px, guided.phase_error_px if guided else 0.0
    )


def _limit_px(evidence: Evidence) -> float:
    return max_epipolar_px(evidence.limits, evidence.decoded)


def _draw(evidence: Evidence, _: Finding) -> Figure | None:
    points, limit = evidence.points, _limit_px(evidence)
    distance_px = points.cloud.epipolar_px
    if distance_px is None or points.cloud.pixels is None:
        return None
    width, height = points.calibration.camera.size
    values = np.full((height, width), np.nan)
    u, v = points.cloud.pixels.T
    values[v, u] = distance_px
    range_px = max(float(np.nanpercentile(np.abs(values), 98)), 2.0 * limit)
    figure, axes = map_axes(values.shape)
    label = f"distance in projector px (limit {limit:.2g})"
    colour_bar(figure, axes, draw_map(axes, values, ERROR_COLOURS, (-range_px, range_px)), label)
    return figure


STALE_CALIBRATION = FaultCause(
    key="stale_calibration",
    meaning="The rig has changed since it was calibrated.",
    remedy="characterise the rig again; something was moved, refocused or exchanged, "
    "or the images show another region of the sensor",
    measured="distance of points from their epipolar lines, averaged over neighbours; fraction of "
    "pixels with fringes a quarter of a period off along a guided axis; reference marks",
    limit=f"{StaleCalibrationLimits().max_epipolar_px:g} projector px, and the waves of three steps; "
    f"{GUIDED_AXIS.max_off_share:.0%}",
    seen_in="points, two axes",
    detectors=(
        Detector(DetectionStage.POINTS, _find_other_devices),
        Detector(DetectionStage.POINTS, _find_changed_marks),
        Detector(DetectionStage.POINTS, _find_moved_rig),
        Detector(DetectionStage.POINTS, _find_fringes_elsewhere),
    ),
    picture=Picture(Needs.POINTS, _draw),
    useless_from=10.0,  # chosen: nothing else explains a distance of 3 px
)
