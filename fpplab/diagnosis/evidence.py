"""What a diagnosis is made of: frames, points, and what further frames of a check have shown."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import TWO_PI, Floats, axis_length
from fpplab.diagnosis.blur import Blur, measured_blur
from fpplab.diagnosis.geometry import GeometryCheck
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.diagnosis.points import PointSample
from fpplab.diagnosis.sample import FrameSample
from fpplab.diagnosis.visibility import Visibility, visibility
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded


class Needs(Enum):
    """What has to be known to draw a finding."""

    FINDING = "finding"
    FRAMES = "frames"
    POINTS = "points"
    MARKER = "marker"


@dataclass(frozen=True, eq=False)
class Evidence:
    """What findings are made of."""

    recording: Recording | None = None  # frames with fringes; None where none were taken
    decoded: Decoded | None = None  # their projector coordinates
    cloud: Cloud | None = None  # their points
    calibration: Calibration | None = None  # that the points were triangulated with
    marker: NDArray[np.int64] | None = None  # grey levels of the synchronisation marker in the order shown
    runs: Mapping[str, Floats] = field(default_factory=dict)  # levels (K,) seen of it in each run
    intended: Plan | None = None  # the plan that the points are judged by; by default that of the recording
    geometry: GeometryCheck | None = None  # what is known of the rig's geometry beyond what the points show
    limits: DiagnosisLimits = USUAL_LIMITS

    def has(self, needed: Needs) -> bool:
        available = {
            Needs.FINDING: True,
            Needs.FRAMES: self.recording is not None,
            Needs.POINTS: self.recording is not None and self.has_points,
            Needs.MARKER: self.marker is not None and bool(self.runs),
        }
        return available[needed]

    @property
    def has_points(self) -> bool:
        """Whether there are points, and the calibration that they were triangulated with."""
        return self.cloud is not None and self.calibration is not None and len(self.cloud) > 0

    @cached_property
    def frames(self) -> FrameSample:
        """Pixels of the recording, with their coordinates where these are known."""
        assert self.recording is not None
        return FrameSample.of(self.recording, self.decoded, self.limits)

    @cached_property
    def points(self) -> PointSample:
        assert self.cloud is not None
        assert self.calibration is not None
        return PointSample(self.cloud, self.calibration)

    @property
    def um_per_rad(self) -> float:
        """How far points are off along rays in µm if the finest phase is by 1 rad; there must be points."""
        assert self.recording is not None
        axis = self.recording.plan.axes[0]
        fringe = self.recording.plan.fringes[self.recording.plan.finest_set(axis)]
        period = axis_length(self.recording.projector_size, axis) / fringe.stripes
        return 1e3 * period / TWO_PI / float(self.points.px_per_mm_of_depth["xy".index(axis)])

    def contained_cost(self, rad: float) -> str:
        """Tell how far a phase error that σ contains puts points off; empty where there are none."""
        return f"; {rad * self.um_per_rad:.0f} µm, which σ contains" if self.has_points else ""

    @property
    def plan(self) -> Plan:
        if self.intended is not None:
            return self.intended
        assert self.recording is not None
        return self.recording.plan

    @cached_property
    def visibility(self) -> Visibility:
        """How clearly the frames show fringes."""
        return visibility(self.frames)

    @cached_property
    def blur(self) -> Blur | None:
        """How blurred fringes and edges are; None where the sets do not determine it."""
        scale = None
        if self.has_points:
            scale = float(self.points.projector_px_per_px["xy".index(self.plan.axes[0])])
        return measured_blur(self.frames, scale)
