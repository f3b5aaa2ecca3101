"""A picture for every finding: the frame, map or curve in which its cause shows, with its limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats
from fpplab.diagnosis import FaultCause, Finding
from fpplab.diagnosis.geometry import PointSample
from fpplab.diagnosis.sample import FrameSample
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded
from fpplab.report import evidence_figures as drawn
from fpplab.report.parts import ReportFigure
from fpplab.report.response_figures import marker_levels


@dataclass(frozen=True, eq=False)
class Evidence:
    """What findings were drawn from."""

    recording: Recording | None = None  # frames with fringes; None where none were taken
    decoded: Decoded | None = None  # their projector coordinates
    cloud: Cloud | None = None  # their points
    calibration: Calibration | None = None  # that the points were triangulated with
    marker: NDArray[np.int64] | None = None  # grey levels of the synchronisation marker in the order shown
    runs: Mapping[str, Floats] = field(default_factory=dict)  # levels (K,) seen of it in each run

    @cached_property
    def frames(self) -> FrameSample | None:
        """Pixels of the recording, with their coordinates where these are known."""
        return None if self.recording is None else FrameSample.of(self.recording, self.decoded)

    @cached_property
    def points(self) -> PointSample | None:
        """Points of the scan."""
        if self.cloud is None or self.calibration is None or not len(self.cloud):
            return None
        return PointSample(self.cloud, self.calibration)


Picture = Callable[[Evidence, Finding], bytes | None]


def _of_frames(draw: Callable[[FrameSample], bytes | None]) -> Picture:
    return lambda given, _: draw(given.frames) if given.frames else None


def _of_points(draw: Callable[[PointSample, FrameSample], bytes | None]) -> Picture:
    return lambda given, _: draw(given.points, given.frames) if given.points and given.frames else None


def _of_marker(given: Evidence, _: Finding) -> bytes | None:
    return marker_levels(given.marker, given.runs) if given.marker is not None and given.runs else None


def _of_rate(_: Evidence, finding: Finding) -> bytes:
    return drawn.needed_rate(finding.excess)


PICTURES: Mapping[FaultCause, Picture] = {
    FaultCause.NO_TRIGGER: _of_marker,
    FaultCause.TRIGGER_EDGE: _of_marker,
    FaultCause.CAMERA_NOT_READY: _of_marker,
    FaultCause.SLOW_DISPLAY: _of_marker,
    FaultCause.OUT_OF_STEP: _of_marker,
    FaultCause.TRIGGER_SHIFTED: _of_marker,
    FaultCause.SLOW_LINK: _of_rate,
    FaultCause.SLOW_DISK: _of_rate,
    FaultCause.PROJECTOR_DARK: _of_frames(drawn.modulation_of_widest),
    FaultCause.NO_OVERLAP: _of_frames(drawn.lit_part),
    FaultCause.SATURATED: _of_frames(drawn.brightest_frame),
    FaultCause.UNDEREXPOSED: _of_frames(drawn.brightness_histogram),
    FaultCause.AMBIENT: _of_frames(drawn.unchanging_light),
    FaultCause.CAMERA_FOCUS: _of_frames(drawn.focus),
    FaultCause.PROJECTOR_FOCUS: _of_frames(drawn.focus),
    FaultCause.VIBRATION: _of_frames(drawn.displaced_sets),
    FaultCause.RESPONSE: _of_frames(drawn.error_by_phase),
    FaultCause.HARMONICS: _of_frames(drawn.error_by_phase),
    FaultCause.FLICKER: _of_frames(drawn.brightness_by_frame),
    FaultCause.MAINS_FLICKER: _of_frames(drawn.brightness_by_frame),
    FaultCause.MISSING_COLOUR: _of_frames(drawn.brightness_by_frame),
    FaultCause.BANDS: _of_frames(drawn.rows_by_frame),
    FaultCause.INTERREFLECTION: _of_frames(drawn.phase_disagreement),
    FaultCause.WRONG_RESOLUTION: _of_frames(drawn.roughness_spectrum),
    FaultCause.WRONG_PLAN: _of_frames(drawn.phases_of_sets),
    FaultCause.UNDERSAMPLED: _of_frames(drawn.finest_fringes),
    FaultCause.SMALL_ANGLE: _of_points(drawn.angles),
    FaultCause.WRONG_AXIS: _of_points(drawn.sensitivity),
    FaultCause.STALE_CALIBRATION: _of_points(drawn.epipolar_map),
}
"""What shows each cause that a check or a scan can find."""

IN_WORDS = frozenset({FaultCause.DEVICE, FaultCause.NO_PERMISSION})
"""Causes that show in what a device says alone."""

OF_POSES = frozenset(
    {
        FaultCause.LENS_NOT_LOCKED,
        FaultCause.BOARD_NOT_FOUND,
        FaultCause.BOARD_MOVED,
        FaultCause.POSE_MISFIT,
    }
)
"""Causes of a characterisation, whose report shows the residuals of every pose."""

OF_RESULTS = frozenset(
    {
        FaultCause.ARTEFACT_MISFIT,
        FaultCause.AT_BORDER,
        FaultCause.ENDED_EARLY,
        FaultCause.FAILED_CANDIDATES,
        FaultCause.FEW_POSITIONS,
        FaultCause.FLAT_OPTIMUM,
        FaultCause.FORM,
        FaultCause.LIMITS_BROKEN,
        FaultCause.NO_GAIN,
        FaultCause.NO_LIMITS,
        FaultCause.NOISE,
        FaultCause.NOT_CONFIRMED,
        FaultCause.POINTS_MISFIT,
        FaultCause.SCALE,
        FaultCause.SPHERE_SIZE,
        FaultCause.UNEVEN_LENGTHS,
        FaultCause.UNLIKE_IMAGES,
    }
)
"""Causes of an acceptance test, a matching or a search, whose pages draw what they judge."""


def evidence_pictures(findings: Sequence[Finding], given: Evidence) -> list[tuple[Finding, bytes]]:
    """Draw what shows each finding."""
    pictures = [(one, PICTURES[one.cause](given, one)) for one in findings if one.cause in PICTURES]
    return [(one, picture) for one, picture in pictures if picture is not None]


def evidence_report(findings: Sequence[Finding], given: Evidence) -> tuple[ReportFigure, ...]:
    """Draw what shows each finding, as figures of a page."""
    return tuple(
        ReportFigure.of(picture, f"What shows {_words(one)}", f"{_words(one).capitalize()}: {one.evidence}.")
        for one, picture in evidence_pictures(findings, given)
    )


def _words(finding: Finding) -> str:
    return finding.cause.value.replace("_", " ")
