"""Candidates measured on a rig, of whatever kind: the evaluator that a search opens on every worker."""

from __future__ import annotations

from collections import OrderedDict
from contextlib import ExitStack
from dataclasses import asdict
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh

from fpplab import artefacts
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison import Comparison, compare
from fpplab.comparison.alignment import align_mesh
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import RigArranger, StageCalibrations
from fpplab.optimisation.candidate import Candidate, Fringes, Score
from fpplab.optimisation.fringe_cache import FringeSetCache, MeasuringSetup
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.scoring import SAMPLES, ArtefactFigures, TrueShape
from fpplab.optimisation.study import Study
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded, decode
from fpplab.pipeline import points_of

TRUTHS = 6
"""True shapes that are kept ready."""


def candidate_from_plan(plan: Plan) -> Candidate:
    """The arrangement that a plan is."""
    sets = tuple(Fringes(one.axis, one.stripes, one.steps) for one in plan.fringes)
    return Candidate(sets, plan.exposure_s, plan.stage_mm)


class RigEvaluator:
    """Measures the artefacts of a study with candidates, on the rig of a file, opened when first needed.

    samples: pixels and points of the true surface that are compared, see `TrueShape`; None for all of them. Where
    the study moves the projector, the truth is what the camera sees, for every candidate alike.
    """

    def __init__(self, rig: str, study: Study, samples: int | None = SAMPLES) -> None:
        self._file, self._study, self._samples = rig, study, samples
        self._first, self._stack = candidate_from_plan(study.start), ExitStack()
        self._truths: OrderedDict[tuple[str, float | None, float | None], TrueShape] = OrderedDict()
        self._standing: dict[str, trimesh.Trimesh] = {}

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        """One score for each artefact of the study, compared after the true shape was moved onto the cloud.

        seed: of the noise, where the rig is a simulation; on any other, another seed is another measurement.
        Raises `ConfigError` and `DeviceError` from the rig; `CalibrationError` where the stage would stand
        outside of what was characterised; `DataError` where nothing could be measured.
        """
        return tuple(self._score(name, candidate, seed) for name in self._study.artefacts)

    def figures(
        self, name: str, candidate: Candidate, seed: int, calibrations: StageCalibrations | None = None
    ) -> ArtefactFigures:
        """One artefact compared; what was acquired before is not acquired again. Raises as `measure`.

        calibrations: in place of the study's.
        """
        known = calibrations or self.calibrations
        calibration = known.at(candidate.stage_mm, candidate.convergence_deg)
        truth = self._truth(name, candidate)  # before anything is acquired in vain
        plan, decoded = candidate.plan(self._study.start), self._decoded(name, candidate, seed)
        return truth.score(decoded, plan, calibration)

    def compared(self, name: str, candidate: Candidate, seed: int) -> tuple[Cloud, Comparison]:
        """One artefact's cloud, all of its points compared: for looking at. Raises as `measure`."""
        calibration = self.calibrations.at(candidate.stage_mm, candidate.convergence_deg)
        plan = candidate.plan(self._study.start)
        _, cloud = points_of(self._decoded(name, candidate, seed), calibration, plan)
        return cloud, compare(cloud, self._mesh(name), calibration, align=True)

    def triangulation_angle_deg(self, candidate: Candidate) -> float:
        """Of triangulation: how far apart an artefact's middle sees camera and projector, the mean over all.

        Raises as `measure`.
        """
        projector = self.calibrations.at(candidate.stage_mm, candidate.convergence_deg).projector_centre
        middles = np.array([self._mesh(name).bounds.mean(axis=0) for name in self._study.artefacts])
        there = projector - middles
        norms = np.linalg.norm(middles, axis=1) * np.linalg.norm(there, axis=1)
        return float(np.degrees(np.arccos(-np.sum(middles * there, axis=1) / norms)).mean())

    def close(self) -> None:
        """Let go of the rig."""
        self._stack.close()
        for opened in ("_rig", "_sets"):
            vars(self).pop(opened, None)

    @cached_property
    def _rig(self) -> Rig:
        return self._stack.enter_context(Rig.load(self._file))

    @cached_property
    def _sets(self) -> FringeSetCache:
        return FringeSetCache(self._rig, self._study.start, RigArranger(self._rig))

    @cached_property
    def calibrations(self) -> StageCalibrations:
        """Those that the study names. Raises `CalibrationError` when it names none."""
        files = self._study.calibrations
        if not files:
            raise CalibrationError(
                f"study '{self._study.name}': 'calibrations' names none; characterise the rig first"
            )
        return StageCalibrations({one.stage_mm: Calibration.load(Path(one.file)) for one in files})

    @cached_property
    def _image_s(self) -> float:
        """What an image takes beside its exposure, by what the devices say of themselves."""
        return RigLimits.of(self._rig).dead_time_s + self._study.start.settle_s

    def _score(self, name: str, candidate: Candidate, seed: int) -> Score:
        found = asdict(self.figures(name, candidate, seed))
        del found["surface_spread_um"]
        seconds = candidate.images * (candidate.exposure_s + self._image_s)
        return Score(artefact=name, seed=seed, images=candidate.images, seconds=seconds, **found)

    def _decoded(self, name: str, candidate: Candidate, seed: int) -> Decoded:
        view = MeasuringSetup(name, candidate.exposure_s, candidate.stage_mm, candidate.convergence_deg)
        frames = self._sets.frames(view, candidate.fringes, seed)
        plan, rig = candidate.plan(self._study.start), self._rig
        size, bits = rig.projector.caps.size, rig.file.camera.bits
        return decode(frames, plan, size, bits, f"measurement of the {name}")

    def _truth(self, name: str, candidate: Candidate) -> TrueShape:
        space = self._study.space
        lit = space.stage_mm is None and space.convergence_deg is None
        # Which candidate comes first must not matter, so where there is one truth it is the start's.
        of = candidate if lit else self._first
        key = name, of.stage_mm, of.convergence_deg
        if key not in self._truths:
            calibration = self.calibrations.at(of.stage_mm, of.convergence_deg)
            self._truths[key] = TrueShape(self._mesh(name), calibration, lit, self._samples)
        self._truths.move_to_end(key)
        while len(self._truths) > TRUTHS:
            self._truths.popitem(last=False)
        return self._truths[key]

    def _mesh(self, name: str) -> trimesh.Trimesh:
        """The true shape in the camera's frame, where the fixture holds it or a first look finds it."""
        if name not in self._standing:
            mesh = artefacts.make(name)
            pose = self._rig.need_fixture("a search").pose(name) or self._found(name, mesh)
            self._standing[name] = mesh.apply_transform(pose.matrix)
        return self._standing[name]

    def _found(self, name: str, mesh: trimesh.Trimesh) -> RigidTransform:
        """Where an artefact lies whose pose nobody knows, by a measurement with the plan of the start."""
        decoded = self._decoded(name, self._first, self._study.seeds[0])
        _, cloud = points_of(decoded, self.calibrations.at(self._first.stage_mm), self._study.start)
        return align_mesh(cloud.points.astype(np.float64), mesh).transform
