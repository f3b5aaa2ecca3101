"""Brings a rig to a candidate's stage position, projector rotation and item, and finds its calibration there.

The rig is characterised at two or more stage positions. Between two of them all parameters are interpolated
together, so that they stay consistent with one another.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from fpplab.calibration.displacements import error_modes
from fpplab.calibration.model import INTRINSICS, PARAMETERS, POSE, Calibration
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform, turned_towards
from fpplab.core.progress import Progress, no_progress
from fpplab.core.session_names import CALIBRATION
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Turnable
from fpplab.optimisation.fringe_cache import MeasuringSetup
from fpplab.optimisation.problem import CalibrationAt, SearchProblem
from fpplab.patterns.plan import Plan
from fpplab.pipeline.characterising import characterise_sessions
from fpplab.pipeline.taking import take_poses
from fpplab.targets import Target


@dataclass(frozen=True)
class TravelLimits:
    """Allowed deviation of the projector's measured travel from the stage's."""

    max_share: float = 0.05  # as a share of the travel (chosen)
    max_mm: float = 1.0  # in mm, added to the share (chosen)


TRAVEL_LIMITS = TravelLimits()


P = TypeVar("P", bound=SearchProblem)


class RigArranger:
    """Brings an open rig to a measuring setup, moving only what has to move."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._current = MeasuringSetup("", 0.0)

    def __call__(self, setup: MeasuringSetup) -> None:
        if setup.stage_mm is not None and setup.stage_mm != self._current.stage_mm:
            self._rig.place_stage(setup.stage_mm)
        if setup.convergence_deg is not None and setup.convergence_deg != self._current.convergence_deg:
            self._turn(setup.convergence_deg)
        if setup.item != self._current.item:
            self._rig.need_fixture(f"mounting the {setup.item}").mount(setup.item)
        self._current = setup

    def _turn(self, convergence_deg: float) -> None:
        if not isinstance(self._rig.simulation, Turnable):
            raise ConfigError(
                f"{self._rig.file.name}: 'convergence_deg' is {convergence_deg:g}, but only a simulated "
                "projector can be turned; leave it out of the study"
            )
        self._rig.simulation.turn(convergence_deg)


class StageCalibrations:
    """Calibrations of a rig by stage position."""

    def __init__(self, by_position: Mapping[float | None, Calibration]) -> None:
        if None in by_position and len(by_position) > 1:
            raise CalibrationError(
                "with several calibrations, each needs the position of its stage: 'stage_mm'"
            )
        self._positions = sorted(mm for mm in by_position if mm is not None)
        self._calibrations = [by_position[mm] for mm in self._positions or (None,)]
        first = self._calibrations[0]
        for mm, other in zip(self._positions, self._calibrations, strict=False):
            other.check_camera(first.camera.size, f"calibration at {mm:g} mm")
            other.check_projector(first.projector.size, first.projector.lattice, f"calibration at {mm:g} mm")
        self._made: dict[tuple[float | None, float], Calibration] = {}
        self._check_travel()

    def at(self, stage_mm: float | None = None, convergence_deg: float | None = None) -> Calibration:
        where = stage_mm, convergence_deg or 0.0
        if where not in self._made:
            calibration = self._at_stage(stage_mm)
            self._made[where] = (
                turn_projector(calibration, convergence_deg) if convergence_deg else calibration
            )
        return self._made[where]

    @property
    def is_exact(self) -> bool:
        """Whether no calibration has a covariance, as those that a simulation states of itself."""
        return all(calibration.uncertainty is None for calibration in self._calibrations)

    def sample(self, random: np.random.Generator) -> StageCalibrations:
        others = [sample_calibration(calibration, random) for calibration in self._calibrations]
        return StageCalibrations(dict(zip(self._positions or (None,), others, strict=True)))

    def _at_stage(self, stage_mm: float | None) -> Calibration:
        if len(self._calibrations) == 1 and stage_mm in (None, *self._positions):
            return self._calibrations[0]
        listed = ", ".join(f"{mm:g}" for mm in self._positions)
        if stage_mm is None:
            raise CalibrationError(
                f"the rig is characterised with the stage at {listed} mm; 'stage_mm' must give its position"
            )
        if not (self._positions and self._positions[0] <= stage_mm <= self._positions[-1]):
            raise CalibrationError(
                f"'stage_mm' is {stage_mm:g}, but the rig is characterised with the stage at "
                f"{f'{listed} mm' if listed else 'no known position'}; characterise it on both sides"
            )
        if stage_mm in self._positions:
            return self._calibrations[self._positions.index(stage_mm)]
        after = bisect_right(self._positions, stage_mm)
        low, high = self._positions[after - 1], self._positions[after]
        return interpolate_calibrations(
            self._calibrations[after - 1], self._calibrations[after], (stage_mm - low) / (high - low)
        )

    def _check_travel(self) -> None:
        origin, start = self._calibrations[0].projector_centre, next(iter(self._positions), 0.0)
        for mm, calibration in zip(self._positions[1:], self._calibrations[1:], strict=True):
            moved = float(np.linalg.norm(calibration.projector_centre - origin))
            if abs(moved - (mm - start)) > TRAVEL_LIMITS.max_share * (mm - start) + TRAVEL_LIMITS.max_mm:
                raise CalibrationError(
                    f"the calibrations at {start:g} and {mm:g} mm put the projector {moved:.1f} mm apart, "
                    f"not {mm - start:g}; check that they are of this rig and of these positions"
                )


def turn_projector(calibration: Calibration, convergence_deg: float) -> Calibration:
    pose = turned_towards(calibration.T_projector_camera, float(np.radians(convergence_deg)))
    return replace(calibration, T_projector_camera=pose, uncertainty=None)


def sample_calibration(calibration: Calibration, random: np.random.Generator) -> Calibration:
    covariance = calibration.uncertainty
    if covariance is None:
        return calibration
    errors = error_modes(covariance) @ random.standard_normal(len(covariance.names))
    by_name = dict.fromkeys(PARAMETERS, 0.0) | dict(zip(covariance.names, errors.tolist(), strict=True))
    pose, change = calibration.T_projector_camera, [by_name[f"T_projector_camera.{term}"] for term in POSE]
    return Calibration(
        _device_with_change(calibration.camera, [by_name[f"camera.{term}"] for term in INTRINSICS]),
        _device_with_change(calibration.projector, [by_name[f"projector.{term}"] for term in INTRINSICS]),
        RigidTransform.from_vectors(pose.rotation_vector + change[:3], pose.translation + change[3:]),
        rms_px={},
    )


def _device_with_change(device: Pinhole, change: Sequence[float]) -> Pinhole:
    matrix = device.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += change[:4]
    return replace(device, matrix=matrix, distortion=device.distortion + change[4:])


def interpolate_calibrations(low: Calibration, high: Calibration, share: float) -> Calibration:
    # Rotations are interpolated about their common axis.
    turn = (high.T_projector_camera.rotation @ low.T_projector_camera.rotation.T).astype(np.float64)
    rotation_vector = RigidTransform(turn, np.zeros(3)).rotation_vector
    part = RigidTransform.from_vectors(share * rotation_vector, np.zeros(3)).rotation
    shift = _mixed(low.T_projector_camera.translation, high.T_projector_camera.translation, share)
    return Calibration(
        _device(low.camera, high.camera, share),
        _device(low.projector, high.projector, share),
        RigidTransform(part @ low.T_projector_camera.rotation, shift),
        rms_px={},
    )


def _device(low: Pinhole, high: Pinhole, share: float) -> Pinhole:
    matrix, distortion = (_mixed(getattr(low, n), getattr(high, n), share) for n in ("matrix", "distortion"))
    return replace(low, matrix=matrix, distortion=distortion)


def _mixed(low: Floats, high: Floats, share: float) -> Floats:
    return np.asarray((1.0 - share) * low + share * high)


def characterise_positions(
    rig: Rig,
    positions: Sequence[float | None],
    plan: Plan,
    board: str,
    target: Target,
    poses: int,
    folder: Path,
    progress: Progress = no_progress,
) -> dict[float | None, Path]:
    # Sessions and calibrations are kept in `folder`; positions whose calibration is there already are
    # skipped.
    files: dict[float | None, Path] = {}
    for done, mm in enumerate(positions):
        place = folder / ("as_it_stands" if mm is None else f"stage_{mm:+g}")
        files[mm] = place / CALIBRATION
        if not files[mm].exists():
            plan_at_position = plan.model_copy(update={"stage_mm": mm})
            sessions = take_poses(rig, plan_at_position, board, poses, place, False)
            characterise_sessions(sessions, target).calibration.save(files[mm])
        progress((done + 1) / len(positions))
    return files


def with_calibrations(
    rig: Rig,
    problem: P,
    folder: Path,
    progress: Progress = no_progress,
    stage_positions: Sequence[float] | None = None,
) -> P:
    """Characterise an open rig at the ends of the stage positions that a search needs, and at its start."""
    # Sessions and calibrations are kept in `folder`; what is there already is not measured again.
    searched, start = problem.space.stage_mm, problem.start.stage_mm
    positions: Sequence[float | None] = [start]
    if searched is not None:
        among = (start or 0.0, *(stage_positions or searched))
        positions = sorted({min(among), among[0], max(among)})
    board = problem.board
    files = characterise_positions(
        rig,
        positions,
        Plan.load(board.plan),
        board.item,
        Target.load(board.target),
        board.poses,
        folder / "board",
        progress,
    )
    calibrations = tuple(CalibrationAt(file=str(path.resolve()), stage_mm=mm) for mm, path in files.items())
    return problem.model_copy(update={"calibrations": calibrations})
