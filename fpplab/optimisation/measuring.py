"""Measures candidates on any rig: the evaluator that every worker of a search opens."""

from collections import OrderedDict
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from fpplab import artefacts
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison import Comparison, compare
from fpplab.comparison.alignment import align_mesh
from fpplab.core.depth import first_stated
from fpplab.core.errors import CalibrationError, ConfigError, DataError
from fpplab.core.geometry import RigidTransform
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import RigArranger, StageCalibrations
from fpplab.optimisation.candidate import Candidate, Evaluator, Score
from fpplab.optimisation.fringe_cache import FringeSetCache, MeasuringSetup
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.problem import SearchProblem
from fpplab.optimisation.scoring import LIMITS, ArtefactFigures, TrueShape
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, check_codes, check_unwrapping, decode
from fpplab.phase.bounds import DecodingBounds, widest_interval_share
from fpplab.phase.exposures import merged_recording
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.points import points_of
from fpplab.sessions.origin import SessionOrigin


class RigEvaluator:
    """Measures candidates on an open rig, with cached fringe sets."""

    def __init__(self, rig: str, problem: SearchProblem, samples: int | None = LIMITS.samples) -> None:
        self._file, self._problem, self._samples = rig, problem, samples
        self._first, self._stack = Candidate.of(problem.start), ExitStack()
        self._true_shapes: OrderedDict[tuple[str, float | None, float | None], TrueShape] = OrderedDict()
        self._placed: dict[str, trimesh.Trimesh] = {}

    def described(self) -> tuple[dict[str, Any], SessionOrigin]:
        return self._rig.described(), SessionOrigin.of(self._rig)

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        return tuple(self._measure_and_score(name, candidate, seed) for name in self._problem.artefacts)

    def figures(
        self, name: str, candidate: Candidate, seed: int, calibrations: StageCalibrations | None = None
    ) -> ArtefactFigures:
        """Measure one artefact; what was acquired before is not acquired again."""
        by_position = calibrations or self.calibrations
        calibration = by_position.at(candidate.stage_mm, candidate.convergence_deg)
        shape = self._true_shape(name, candidate)  # may raise, so before anything is acquired
        plan = candidate.plan(self._problem.start)
        decoded = self._take_and_decode(name, candidate, seed, calibration)
        return shape.score(decoded, plan, calibration)

    def compare(self, name: str, candidate: Candidate, seed: int) -> tuple[Cloud, Comparison]:
        calibration = self.calibrations.at(candidate.stage_mm, candidate.convergence_deg)
        plan = candidate.plan(self._problem.start)
        _, cloud = points_of(self._take_and_decode(name, candidate, seed, calibration), calibration, plan)
        return cloud, compare(cloud, self._mesh_in_camera_frame(name), calibration, align=True)

    def triangulation_angle_deg(self, candidate: Candidate) -> float:
        # Seen from the centre of its bounding box.
        projector = self.calibrations.at(candidate.stage_mm, candidate.convergence_deg).projector_centre
        middles = np.array(
            [self._mesh_in_camera_frame(name).bounds.mean(axis=0) for name in self._problem.artefacts]
        )
        to_projector = projector - middles
        norms = np.linalg.norm(middles, axis=1) * np.linalg.norm(to_projector, axis=1)
        return float(np.degrees(np.arccos(-np.sum(middles * to_projector, axis=1) / norms)).mean())

    def close(self) -> None:
        """Close the rig; it is opened again when something is measured."""
        self._stack.close()
        for opened in ("_rig", "_frames"):
            vars(self).pop(opened, None)

    @cached_property
    def _rig(self) -> Rig:
        return self._stack.enter_context(Rig.load(self._file))

    @cached_property
    def _frames(self) -> FringeSetCache:
        return FringeSetCache(self._rig, self._problem.start, RigArranger(self._rig))

    @cached_property
    def calibrations(self) -> StageCalibrations:
        files = self._problem.calibrations
        if not files:
            raise CalibrationError(
                f"study '{self._problem.name}': 'calibrations' names none; characterise the rig first"
            )
        return StageCalibrations({entry.stage_mm: Calibration.load(Path(entry.file)) for entry in files})

    @cached_property
    def _image_s(self) -> float:
        return RigLimits.of(self._rig).dead_time_s + self._problem.start.settle_s

    def _measure_and_score(self, name: str, candidate: Candidate, seed: int) -> Score:
        figures = asdict(self.figures(name, candidate, seed))
        del figures["surface_spread_um"]
        seconds = candidate.seconds(self._image_s)
        return Score(artefact=name, seed=seed, images=candidate.images, seconds=seconds, **figures)

    def _take_and_decode(
        self, name: str, candidate: Candidate, seed: int, calibration: Calibration
    ) -> Decoded:
        plan, rig = candidate.plan(self._problem.start), self._rig
        bounds = possible_coordinates(plan, calibration, rig)  # may raise, so before anything is acquired
        place = candidate.stage_mm, candidate.convergence_deg
        frames = [
            frame
            for taken, exposure_s in enumerate(candidate.exposures)
            for frame in self._frames.frames(
                MeasuringSetup(name, exposure_s, *place, taken), candidate.fringes, seed
            )
        ]
        size, bits = rig.projector.caps.size, self._problem.start.bits or rig.file.camera.bits
        name, bayer = f"measurement of the {name}", rig.camera.caps.bayer
        raw = Recording(frames, plan, size, bits, name, bayer=bayer)
        return decode(merged_recording(raw, candidate.exposures), bounds=bounds)

    def _true_shape(self, name: str, candidate: Candidate) -> TrueShape:
        space = self._problem.space
        illuminated = space.stage_mm is None and space.convergence_deg is None
        # Where one shape is used for all, it is the start's, so that the order of candidates does not matter.
        of = candidate if illuminated else self._first
        key = name, of.stage_mm, of.convergence_deg
        if key not in self._true_shapes:
            calibration = self.calibrations.at(of.stage_mm, of.convergence_deg)
            self._true_shapes[key] = TrueShape(
                self._mesh_in_camera_frame(name), calibration, illuminated, self._samples
            )
        self._true_shapes.move_to_end(key)
        while len(self._true_shapes) > 6:  # chosen, for the memory they take
            self._true_shapes.popitem(last=False)
        return self._true_shapes[key]

    def _mesh_in_camera_frame(self, name: str) -> trimesh.Trimesh:
        if name not in self._placed:
            mesh = artefacts.make(name)
            pose = self._rig.need_fixture("a search").pose(name) or self._locate_by_measurement(name, mesh)
            self._placed[name] = mesh.apply_transform(pose.matrix)
        return self._placed[name]

    def _locate_by_measurement(self, name: str, mesh: trimesh.Trimesh) -> RigidTransform:
        calibration = self.calibrations.at(self._first.stage_mm)
        decoded = self._take_and_decode(name, self._first, self._problem.seeds[0], calibration)
        _, cloud = points_of(decoded, calibration, self._problem.start)
        return align_mesh(cloud.points.astype(np.float64), mesh).transform


@dataclass(frozen=True)
class RigEvaluatorFactory:
    """Opens the rig of a search, in the process that measures."""

    rig: str  # rig file, by path or name, as the worker finds it
    problem: SearchProblem  # what is measured
    kind: Callable[[str, SearchProblem], Evaluator] = RigEvaluator  # what measures, or predicts

    def __call__(self) -> Evaluator:
        return self.kind(self.rig, self.problem)


def possible_coordinates(plan: Plan, calibration: Calibration, rig: Rig) -> DecodingBounds:
    depth = first_stated(
        (plan.depth_mm, "plan: 'depth_mm'"), (rig.file.depth_mm, f"{rig.source}: 'depth_mm'")
    )
    bounds, size = decoding_bounds(plan, calibration, depth), calibration.projector.size
    try:
        check_codes(plan, size, "plan")
        check_unwrapping(
            plan, "plan", {axis: widest_interval_share(bounds, axis, size) for axis in plan.axes}
        )
    except ConfigError as reason:
        raise DataError(str(reason)) from None
    return bounds
