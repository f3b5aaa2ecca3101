"""Benches with an effect that the twin's model lacks: whether it is named, and whether intervals still hold.

A twin is matched to recordings of a board and of one part. The bench has a response in the form of an S, a
part of wax, a groove whose walls light each other, or a part that moves while it is recorded. Then the twin
predicts two other measurements of that part, which the bench makes afterwards.
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.interpolate import make_lsq_spline

from benchmarks import Result, above, below
from benchmarks.hidden.bench import record_images, write_rig
from benchmarks.hidden.worlds import BOARD, CARD, drawn_world, nominal_world
from benchmarks.predict import PredictSetup, Question, matched, predictions
from benchmarks.virtual import virtual_bench
from fpplab.cli import console
from fpplab.core import config
from fpplab.core.conventions import Image
from fpplab.core.errors import FppError
from fpplab.devices import CameraSettings
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Predictable
from fpplab.patterns.curve import DEGREE, knots
from fpplab.patterns.fringes import Pattern
from fpplab.patterns.plan import Plan
from fpplab.pipeline.response import measure_response
from fpplab.pipeline.taking import take_or_resume_session, take_poses
from fpplab.sessions.session import Session, recorded_sessions
from sim.bench import VirtualBench
from sim.build import SceneState
from sim.items import item_poses
from sim.light import ShownPattern
from sim.matching.judging.measured import measured_figures
from sim.prediction import MeasuredFigures, Prediction
from sim.sensor import SensorModel
from sim.world import World

PART = "part"
FIGURES = ("distance_um", "noise_um", "completeness")
S_SHAPE = 0.09
"""Of the response `i - 0.09 sin(2 pi i)`."""
PIECES = 12
"""Coefficients of its spline."""
INDIRECT = {"samples": 64, "subpixels": 1, "path": "auto"}
"""How light by way of other surfaces, or of the inside of a part, is rendered."""
DRIFT_MM = 0.004
"""By how much the part moves towards the camera from frame to frame."""


@dataclass(frozen=True)
class Outside:
    """An effect that the model lacks."""

    name: str  # of the effect
    board: Callable[[World], World]  # the world in front of which board and card are recorded
    part: Callable[[World], World]  # the world in which the part is recorded
    words: tuple[str, ...]  # one of these must be said
    drift_mm: float = 0.0  # by how much the part moves towards the camera in every frame
    mesh: Callable[[Path], Path] | None = None  # makes the part's file in a folder; None for the pyramid


def _same(world: World) -> World:
    return world


def _with(world: World, **changes: Mapping[str, Any]) -> World:
    data = world.model_dump(mode="json")
    for section, fields in changes.items():
        data[section] = {**data[section], **fields}
    return config.validate(data, World, "a bench outside of the model")


def s_shaped(world: World) -> World:
    """Give a world a projector whose response has the form of an S."""
    shown = np.linspace(0.0, 1.0, 2001)
    wanted = shown - S_SHAPE * np.sin(2 * np.pi * shown)
    found = make_lsq_spline(shown, wanted, knots(PIECES), DEGREE).c
    found[0], found[-1] = 0.0, 1.0
    response = {
        **world.projector.response.model_dump(),
        "g": 1.0,
        "spline": np.maximum.accumulate(found).tolist(),
    }
    return _with(world, projector={"response": response})


def of_wax(world: World) -> World:
    """Make the part of wax."""
    wax = {"kind": "translucent", "reflectance": 0.85, "radius_mm": 0.3}
    item = {**world.model_dump(mode="json")["items"][PART], "material": "wax"}
    return _with(world, materials={"wax": wax}, items={PART: item}, render=INDIRECT)


def of_lit_walls(world: World) -> World:
    """Let surfaces light each other."""
    return _with(world, render={"bounces": 2, **INDIRECT})


def groove(folder: Path) -> Path:
    """Make a block with a groove of 80 degrees."""
    block = trimesh.creation.box(bounds=[(-35, -25, -15), (35, 25, 25)])
    edges = [(-26.0, -16.0), (0.0, 15.0), (26.0, -16.0)]
    wedge = trimesh.convex.convex_hull(np.array([(x, y, z) for x, z in edges for y in (-26, 26)]))
    path = folder / "groove.stl"
    trimesh.boolean.difference([block, wedge]).export(path)
    return path


EFFECTS = (
    Outside("response", s_shaped, s_shaped, ("response",)),
    Outside("wax", _same, of_wax, ("light below the surface",)),
    Outside("groove", _same, of_lit_walls, ("interreflection",), mesh=groove),
    Outside("moving", _same, _same, ("parts that moved", "vibration", "the part creeps"), DRIFT_MM),
)


@dataclass(frozen=True, eq=False)
class JudgedEffect:
    """One bench."""

    name: str  # of the effect
    said: str  # everything that was said of it
    named: bool  # whether the effect is named
    answers: dict[str, tuple[Prediction, MeasuredFigures]] = field(default_factory=dict)  # by question

    @property
    def missed(self) -> list[str]:
        """Questions and figures whose interval does not hold what was measured."""
        return [
            f"{question} {name}"
            for question, (said, measured) in self.answers.items()
            for name in FIGURES
            if not said.figures[name].contains(getattr(measured, name))
        ]


def run() -> list[Result]:
    """Measure how twins do on benches that they cannot model. It takes some twenty minutes."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        return effect_figures([judged_effect(one, Path(folder) / one.name) for one in EFFECTS])


def effect_figures(judged: list[JudgedEffect]) -> list[Result]:
    """Sum up."""
    named = [above(f"outside_{one.name}_is_named", float(one.named), "", 1.0) for one in judged]
    missed = [
        below(f"outside_{one.name}_intervals_missed", float(len(one.missed)), "", 0.0) for one in judged
    ]
    return named + missed


def judged_effect(
    effect: Outside, folder: Path, seed: int = 6000, trial: PredictSetup | None = None
) -> JudgedEffect:
    """Record a bench, match a twin to it, predict, and measure."""
    trial = trial or PredictSetup(poses=6)
    world = _with_part(drawn_world(seed, trial.poses, trial.binning), effect, folder)
    plan, part_plan = Plan.load(trial.board_plan), Plan.load(trial.part_plan)
    questions = (
        Question("other_plan", PART, trial.other_plan),
        Question("half_exposure", PART, trial.part_plan, 0.5),
    )
    with Rig.load(write_rig(effect.board(world), folder / "bench", "Bench outside of the model")) as rig:
        console.log_status(f"Recording the bench '{effect.name}'")
        rig.need_fixture("the benchmark").mount(CARD, 0)
        response = measure_response(rig, plan.exposure_s)[0]
        take_poses(rig, plan, BOARD, trial.poses, folder / BOARD, replace_existing=False)
        virtual_bench(rig).replace_world(effect.part(world))
        scan = _taken(rig, part_plan, folder / "scan", effect.drift_mm)
        write_rig(_nominal(world), folder / "nominal", "Nominal twin")
        said = "response spline " if response.spline else ""
        try:
            found = matched(folder, trial, recorded_sessions([folder / BOARD]), {PART: scan}, {}, response)
            said += " ".join(one.evidence for one in found.diagnosis.findings)
            predicted = predictions(folder / "matched" / "rig.yaml", questions)
        except FppError as error:
            return JudgedEffect(effect.name, str(error), _names(effect, str(error)))
        said += " ".join(f"{one.discrepancy.looks_like}" for one in predicted.values() if one.discrepancy)
        calibration = found.reference.characterisation.calibration
        assert isinstance(rig.simulation, Predictable)
        mesh = rig.simulation.image_part_sampler().mesh(PART)
        answers = {}
        for one in questions:
            session = _taken(rig, one.loaded(), folder / one.name, effect.drift_mm)
            answers[one.name] = predicted[one.name], measured_figures(session, calibration, mesh)
    return JudgedEffect(effect.name, said, _names(effect, said), answers)


def _names(effect: Outside, said: str) -> bool:
    return any(word in said for word in effect.words)


def _with_part(world: World, effect: Outside, folder: Path) -> World:
    folder.mkdir(parents=True, exist_ok=True)
    data = world.model_dump(mode="json")
    item = dict(data["items"]["pyramid"])
    if effect.mesh:
        pose = {"rotation_deg": [0.0, 0.0, 0.0], "translation_mm": [0.0, 0.0, 460.0]}
        item = {"mesh": str(effect.mesh(folder)), "pose": pose}
    data["items"] = {BOARD: data["items"][BOARD], CARD: data["items"][CARD], PART: item}
    data["vibration_mm"] = 0.0
    return config.validate(data, World, "a bench outside of the model")


def _nominal(world: World) -> World:
    """What the data sheets say, with the part where it stands."""
    shapes = world.model_dump(mode="json")
    part = shapes["items"][PART] | {"material": None}
    complete = {**shapes, "items": {**shapes["items"], **dict.fromkeys(_OTHERS, part)}}
    told = nominal_world(config.validate(complete, World, "the bench")).model_dump(mode="json")
    told["items"] = {BOARD: told["items"][BOARD], CARD: told["items"][CARD], PART: part}
    return config.validate(told, World, "the nominal twin")


_OTHERS = ("pyramid", "pillars", "steps", "pyramid_moved", "pyramid_painted")


def _taken(rig: Rig, plan: Plan, path: Path, drift_mm: float) -> Session:
    if not drift_mm:
        take_or_resume_session(rig, plan, path, (PART, 0), accept_complete=True)
        return Session.open(path)
    return record_images(rig, plan, path, (PART, 0), partial(_moving, virtual_bench(rig), drift_mm))


def _moving(
    bench: VirtualBench, drift_mm: float, patterns: tuple[Pattern, ...], settings: CameraSettings
) -> Iterator[Image]:
    """Images of the part as it moves towards the camera; every recording begins where it stood."""
    pose, sensor = item_poses(bench.world, PART)[0], SensorModel.of(bench.world)
    for n in range(len(patterns)):
        setup = SceneState(PART, held=pose.moved(np.array([0.0, 0.0, -drift_mm * n])))
        yield sensor.expose(
            bench.light.irradiance(setup, ShownPattern(patterns, n)), settings, bench.next_draw()
        )
