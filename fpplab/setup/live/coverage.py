"""Poses of a board taken during the set-up: what they cover, and which pose would help next."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Observation, finest_periods, observe
from fpplab.characterisation.coverage import REGION_NAMES, coverage_warnings, regions_with_points
from fpplab.characterisation.fitting import MIN_POSES
from fpplab.characterisation.guide import Guide
from fpplab.characterisation.parameters import Solution
from fpplab.characterisation.zhang import calibrate_separately, fit_pose_between_devices, transform
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import CalibrationError, FppError
from fpplab.core.geometry import Pinhole
from fpplab.pipeline.decoding import decode_session
from fpplab.sessions.session import Session
from fpplab.targets import Target

RECOMMENDED_POSES = 10  # poses that make a good characterisation (chosen)


@dataclass
class BoardCoverage:
    """Poses taken so far."""

    target: Target  # the board
    camera_size: tuple[int, int]  # (width, height) in px
    projector_size: tuple[int, int]  # (width, height) in px
    lattice: Lattice = Lattice.SQUARE  # arrangement of the projector's mirrors
    depth_mm: DepthInterval | None = None  # working range of depths in mm, where it is known
    sessions: list[Path] = field(default_factory=list)  # of the poses that were kept
    rejected: list[str] = field(default_factory=list)  # why others were not
    _observations: list[Observation] = field(default_factory=list)
    _next: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        sizes = (self.camera_size, self.projector_size)
        self._guide = Guide(self.target, sizes, self.lattice, self.depth_mm)
        self._next = self._lacking()

    def add(self, session: Session) -> str:
        name = session.path.name
        try:
            decoded = decode_session(session)
            periods = finest_periods(session.plan, self.projector_size)
            image = session.recording(verify=False).mean_image()
            self._observations.append(observe(name, image, decoded, self.target, periods))
        except FppError as error:
            self.rejected.append(str(error))
            return f"{error}; the pose does not count"
        self.sessions.append(session.path)
        self._next = self._advised(self._observations[-1])
        return f"{name}: {len(self._observations[-1].ids)} points; {len(self.sessions)} poses so far"

    def _advised(self, newest: Observation) -> tuple[str, ...]:
        try:
            self._guide.add(newest)
            return (self._guide.next_pose().description, *self._lacking())
        except CalibrationError:  # the poses do not determine the devices yet; what they lack says why
            return self._lacking()

    def _lacking(self) -> tuple[str, ...]:
        return advise_by_coverage(self._observations, self.target, self.camera_size, self.projector_size)

    def summary(self) -> dict[str, object]:
        return {
            "poses": len(self.sessions),
            "camera": _ninths([o.camera_px for o in self._observations], self.camera_size),
            "projector": _ninths([o.projector_px for o in self._observations], self.projector_size),
            "next": list(self._next),
            "left_out": list(self.rejected),
        }


def _ninths(pixels: list[Floats], size: tuple[int, int]) -> list[list[bool]]:
    held = regions_with_points(np.concatenate([np.empty((0, 2)), *pixels]), size)
    return [[bool(is_held) for is_held in row] for row in held]


def advise_by_coverage(
    observations: Sequence[Observation],
    target: Target,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
) -> tuple[str, ...]:
    # camera_size, projector_size (width, height) px
    if not observations:
        return ("hold the board upright in the middle, and take the first pose",)
    advice: list[str] = []
    if len(observations) >= MIN_POSES:
        try:
            advice += _uncovered_regions(observations, target, camera_size, projector_size)
        except CalibrationError as error:
            advice.append(
                f"the poses do not determine the devices yet ({error}); tilt the board by 20 to 35°"
            )
    else:
        advice.append("tilt the board by 20 to 35°, each time about another axis, and change its distance")
        advice += _uncovered_parts(observations, camera_size)
    if not advice and len(observations) < RECOMMENDED_POSES:
        advice.append(
            f"take {RECOMMENDED_POSES - len(observations)} more poses, each tilted and placed differently"
        )
    return tuple(advice) or ("the poses cover tilts, distances and both images: characterise now",)


def _uncovered_parts(observations: Sequence[Observation], camera_size: tuple[int, int]) -> list[str]:
    uncovered = ~regions_with_points(np.concatenate([o.camera_px for o in observations]), camera_size)
    where = ", ".join(REGION_NAMES[row][column] for row, column in np.argwhere(uncovered))
    return [f"hold it also in these parts of the image: {where}"] if where else []


def _uncovered_regions(
    observations: Sequence[Observation],
    target: Target,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
) -> tuple[str, ...]:
    board = target.points()
    start, _, _ = calibrate_separately(observations, board, camera_size, projector_size)
    pair, _ = fit_pose_between_devices(observations, start, camera_size)
    estimate = replace(start, T_projector_camera=pair)
    poses = [transform(pose) for pose in estimate.poses]
    return coverage_warnings(
        observations, poses, _rough_calibration(estimate, camera_size, projector_size), board
    )


def _rough_calibration(
    estimate: Solution, camera_size: tuple[int, int], projector_size: tuple[int, int]
) -> Calibration:
    camera, projector = (
        Pinhole.from_focal(size, (lens[0], lens[1]), (lens[2], lens[3]), tuple(lens[4:].tolist()))
        for lens, size in ((estimate.camera, camera_size), (estimate.projector, projector_size))
    )
    pair = transform(estimate.T_projector_camera)
    return Calibration(camera, projector, pair, {})
