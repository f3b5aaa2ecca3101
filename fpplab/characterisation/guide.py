"""Guide through a characterisation: which pose next, whether one fits the others, what is known by now.

A pose is told in words for the person who holds the board, and as an outline in the camera's image.
"""

from dataclasses import dataclass, replace

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation.candidate_poses import TILT_DEG, candidate_poses
from fpplab.characterisation.coverage import REGION_NAMES, covered_regions, uncovered_regions
from fpplab.characterisation.estimate import JointEstimate, first_estimate
from fpplab.characterisation.first_poses import FIRST_POSES, RoughView, first_pose, working_depth
from fpplab.characterisation.fitting import DEFAULT_LEVEL
from fpplab.characterisation.judging import Errors, judge
from fpplab.characterisation.limits import POSE_LIMITS, PoseLimits
from fpplab.characterisation.next_pose import Design, best_pose, expected_observation
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import DistortionModel, ImageSize
from fpplab.characterisation.working_volume import WorkingVolume
from fpplab.characterisation.zhang import rms
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import CalibrationError, UndeterminedError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.targets import Target

FACING_DEG, TURNED_DEG, SAME_MM = 5.0, 20.0, 3.0
"""Tilt, turn and change of distance below which none is stated. Chosen: a hand does not hold it better."""

EDGES = (
    "right edge", "lower right corner", "lower edge", "lower left corner",
    "left edge", "upper left corner", "upper edge", "upper right corner",
)  # fmt: skip
"""As the camera sees the board, clockwise."""

FIRST_POSE = (
    "in the middle of the image, where parts will be measured, upper edge tilted away by about "
    f"{TILT_DEG:.0f} degrees"
)
"""The first pose, before anything is known."""


@dataclass(frozen=True, eq=False)
class WantedPose:
    """A pose that is asked for."""

    description: str  # for a person
    T_camera_target: RigidTransform | None = None  # for a robot or a simulation; None for the very first pose
    outline_px: Floats | None = None  # (40, 2)
    form_mm: float | None = None  # standard uncertainty of form in mm that the pose is expected to leave


@dataclass(frozen=True, eq=False)
class PoseFit:
    """Residuals of one pose compared with those that the other poses predict."""

    camera: Errors  # of the two devices, with only the board's pose fitted
    projector: Errors  # of the two devices, with only the board's pose fitted
    outlying_pose: str | None = None  # name of an earlier pose, where that is the outlier
    limits: PoseLimits = POSE_LIMITS  # by which the pose is judged

    @property
    def contradicting_devices(self) -> tuple[str, ...]:
        """Devices in which the residuals are far beyond those predicted."""
        pairs = (("camera", self.camera), ("projector", self.projector))
        max_ratio = self.limits.max_residual_ratio
        return tuple(n for n, e in pairs if e.contradicts and e.rms_px > max_ratio * e.predicted_px)


class Guide:
    """The state of a guided characterisation."""

    def __init__(
        self, target: Target, image_sizes: tuple[ImageSize, ImageSize], lattice: Lattice = Lattice.SQUARE,
        depth_mm: DepthInterval | None = None, level: DistortionModel = DEFAULT_LEVEL, refined: bool = True,
        limits: PoseLimits = POSE_LIMITS,
    ) -> None:  # fmt: skip
        self.target, self.sizes, self.lattice = target, image_sizes, lattice
        self.level, self.refined, self.limits = level, refined, limits
        self.observations: list[Observation] = []
        self.estimate: JointEstimate | None = None
        self.first_known: RigidTransform | None = None
        self._stated_mm = depth_mm
        self._excluded: list[RigidTransform] = []

    @property
    def depth_mm(self) -> DepthInterval | None:
        """Working range of depths in mm; None before the first pose where none is stated."""
        if self._stated_mm or not self.observations:
            return self._stated_mm
        return working_depth(self.estimate.poses[0] if self.estimate else self._view().first)

    @property
    def volume(self) -> WorkingVolume | None:
        """The working volume; None before there is an estimate."""
        if self.estimate is None or self.depth_mm is None:
            return None
        return WorkingVolume.of(self.estimate.calibration, self.depth_mm)

    @property
    def form_mm(self) -> float | None:
        """Standard uncertainty of form in the working volume in mm, without the board's scale."""
        volume = self.volume
        if volume is None or self.estimate is None:
            return None
        return volume.form_mm(self.estimate.solution, self.level, self.estimate.covariance)

    def next_pose(self, fill: bool = False) -> WantedPose:
        if not self.observations:
            return WantedPose(FIRST_POSE)
        if self.estimate is None:
            view = self._view()
            number = len(self.observations) + len(self._excluded)
            pose = first_pose(number, view, self.target, self._stated_mm)
            return self._asked(pose, view.camera, float(view.first.translation[2]))
        volume, calibration = self.volume, self.estimate.calibration
        assert volume is not None
        candidates = self._candidates()
        if not candidates:
            raise CalibrationError(
                "every pose that both devices see was rejected; check the rig, and start again"
            )
        candidates = (self._filling(candidates) if fill else []) or candidates
        chosen, form_mm = best_pose(Design.of(self.estimate, volume), candidates)
        first_mm = float(self.estimate.poses[0].translation[2])
        return self._asked(candidates[chosen], calibration.camera, first_mm, form_mm)

    @property
    def has_uncovered_region(self) -> bool:
        """Whether a part of an image has no points yet, and some pose would bring points there."""
        return self.estimate is not None and bool(self._filling(self._candidates()))

    def _candidates(self) -> list[RigidTransform]:
        assert self.estimate is not None
        assert self.depth_mm is not None
        poses = candidate_poses(self.estimate.calibration, self.target.size_mm, self.depth_mm)
        return [pose for pose in poses if not any(self._similar(pose, other) for other in self._excluded)]

    def _filling(self, candidates: list[RigidTransform]) -> list[RigidTransform]:
        """Those that bring points into a part of an image that has none."""
        assert self.estimate is not None
        centres = np.array([pose.translation for pose in self.estimate.poses])
        bare = uncovered_regions(self.observations, centres, self.estimate.calibration)
        if not any(part.any() for part in bare.values()):
            return []
        sizes, filling = dict(zip(bare, self.sizes, strict=True)), []
        for pose in candidates:
            observation = expected_observation(self.estimate, pose)
            if any((bare[d] & covered_regions([observation], d, sizes[d])).any() for d in bare):
                filling.append(pose)
        return filling

    def exclude(self, pose: WantedPose) -> None:
        if pose.T_camera_target is not None:
            self._excluded.append(pose.T_camera_target)

    def judged(self, observation: Observation) -> PoseFit | None:
        """Compare the residuals of a pose with those that the poses before predict."""
        if self.estimate is None:
            return None
        fit = self._fit_of(observation, self.estimate.calibration)
        return replace(fit, outlying_pose=self._outlying_earlier_pose(observation))

    def add(self, observation: Observation) -> dict[str, str]:
        self.observations.append(observation)
        if self.estimate is not None:
            self.estimate = self.estimate.with_pose(observation)
            return {}
        if len(self.observations) < len(FIRST_POSES):
            return {}
        try:
            estimate, outlying = first_estimate(
                self.observations, self.target, self.sizes, self.lattice, self.level, self.refined
            )
        except UndeterminedError:
            if len(self.observations) >= self.limits.certain_poses:
                raise
            return {}
        self.estimate, self.observations = estimate, list(estimate.observations)
        return outlying

    def drop(self, name: str) -> None:
        index = [o.name for o in self.observations].index(name)
        del self.observations[index]
        if len(self.observations) < len(FIRST_POSES):
            self.estimate = None
        elif self.estimate is not None:
            self.estimate = self.estimate.without_pose(index)

    def rms_px(self, name: str) -> dict[str, float]:
        if self.estimate is None:
            return {}
        index = [o.name for o in self.observations].index(name)
        pair = self.estimate.solution.residuals(index, self.observations[index])
        return {
            device: rms([residuals]) for device, residuals in zip(("camera", "projector"), pair, strict=True)
        }

    def _fit_of(self, observation: Observation, calibration: Calibration) -> PoseFit:
        (judged,) = judge(calibration, [observation]).poses
        return PoseFit(judged.camera, judged.projector, limits=self.limits)

    def _outlying_earlier_pose(self, new: Observation) -> str | None:
        """Name which of a few earlier poses the fit of the others, the new one included, contradicts."""
        assert self.estimate is not None
        if len(self.observations) >= self.limits.certain_poses:
            return None
        try:
            joint = self.estimate.with_pose(new)
            without = [joint.without_pose(k) for k in range(len(joint.observations))]
        except CalibrationError:
            return None
        k = int(np.argmin([others.calibration.rms_px["joint"] for others in without]))
        outlier = joint.observations[k]
        if outlier.name == new.name:
            return None
        return outlier.name if self._fit_of(outlier, without[k].calibration).contradicting_devices else None

    def _view(self) -> RoughView:
        return RoughView.of(self.observations, self.target, self.sizes, self.first_known)

    def _asked(
        self, pose: RigidTransform, camera: Pinhole, first_mm: float, form_mm: float | None = None
    ) -> WantedPose:
        outline = outline_px(pose, camera, self.target.size_mm)
        return WantedPose(describe_pose(pose, camera, first_mm), pose, outline, form_mm)

    def _similar(self, pose: RigidTransform, other: RigidTransform) -> bool:
        turn_deg = np.degrees(np.linalg.norm((pose @ other.inverse()).rotation_vector))
        distance_mm = np.linalg.norm(pose.translation - other.translation)
        return bool(distance_mm < self.limits.similar_mm and turn_deg < self.limits.similar_deg)


def describe_pose(pose: RigidTransform, camera: Pinhole, first_mm: float) -> str:
    u, v = camera.project(pose.translation)
    column, row = (int(np.clip(3 * (x + 0.5) / n, 0, 2)) for x, n in zip((u, v), camera.size, strict=True))
    parts = [
        f"in the {REGION_NAMES[row][column]} of the image",
        _describe_distance(float(pose.translation[2]), first_mm),
    ]
    return ", ".join([*parts, _describe_tilt(pose), *_describe_turn(pose)])


def outline_px(pose: RigidTransform, camera: Pinhole, size_mm: tuple[float, float]) -> Floats:
    # size_mm (width, height) mm; returns (40, 2) px
    x, y = 0.5 * size_mm[0], 0.5 * size_mm[1]
    corners = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
    steps = np.linspace(0, 1, 11)[:-1, None]
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return camera.project(pose.apply(np.concatenate([a + steps * (b - a) for a, b in sides])))


def _describe_distance(z: float, first_mm: float) -> str:
    difference = z - first_mm
    if abs(difference) < SAME_MM:
        return f"as far as the first pose ({z:.0f} mm from the camera)"
    direction = "farther" if difference > 0 else "nearer"
    return f"{abs(difference):.0f} mm {direction} than the first pose ({z:.0f} mm)"


def _describe_tilt(pose: RigidTransform) -> str:
    across, down, along = pose.rotation[:, 2]
    tilt = float(np.degrees(np.arccos(np.clip(along, -1.0, 1.0))))
    if tilt < FACING_DEG:
        return "facing the camera"
    # The depth of the plane grows against the normal's part in the image.
    octant = round(float(np.degrees(np.arctan2(-down, -across))) / 45.0) % 8
    return f"{EDGES[octant]} tilted away by {tilt:.0f} degrees"


def _describe_turn(pose: RigidTransform) -> list[str]:
    turn = float(np.degrees(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])))
    if abs(turn) < TURNED_DEG:
        return []
    return [f"turned by {abs(turn):.0f} degrees {'clockwise' if turn > 0 else 'counterclockwise'}"]
