"""Characterisation and response on the virtual bench, each figure beside its target; the truth is known.

The demonstration's bench at 1368 x 912 px. Twenty poses of the paper's board go through the whole
measurement. Then come repeats: each takes twenty of forty poses, because what is wrong with a picture beyond
its noise is the same in every picture of one pose, and exposes them anew with noise of its own. There only
the part of the picture that holds the board is exposed and decoded.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from multiprocessing.pool import Pool
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks import Result, below
from fpplab.calibration.model import Calibration
from fpplab.characterisation import (
    Characterisation,
    Observation,
    characterise,
    finest_periods,
    observe,
)
from fpplab.characterisation.bundle import adjust_bundle
from fpplab.characterisation.parameters import Model
from fpplab.characterisation.zhang import calibrate_separately, fit_pose_between_devices
from fpplab.cli import console
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole
from fpplab.devices import CameraSettings
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.pipeline.characterising import characterise_sessions
from fpplab.pipeline.response import measure_response
from fpplab.pipeline.taking import take_or_resume_session
from fpplab.sessions.session import Session
from fpplab.targets import Target
from sim.devices import SimCamera
from sim.items import plate_corners
from sim.light import PatternLevels
from sim.sensor import SensorModel
from sim.world import World

POSES, POOL, REPEATS = 20, 40, 40
MARGIN_PX = 20
LIMITS_PX = {"camera": 0.042, "projector": 0.060, "joint": 0.054}
LEAST_COVERED, SIGMAS = 0.95, 3.0
MOST_SECONDS = 5.0
HIDDEN = {"a": 0.65, "b": 0.056, "g": 1.033}
RECOVERED, RESIDUAL_SUM = 0.01, 0.002
TERMS = ("fx", "fy", "cx", "cy")
RIG = """
name: Virtual bench
bench: {{backend: "sim.devices:VirtualBench", world: world.yaml}}
camera: {{backend: "sim.devices:SimCamera", bits: {bits}}}
projector: {{backend: "sim.devices:SimProjector"}}
fixture: {{backend: "sim.devices:SimFixture"}}
"""


def run() -> list[Result]:
    """Measure how well characterisation does; the baselines are the targets."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        return [*_characterisation(Path(folder)), *_response(Path(folder))]


def _characterisation(folder: Path) -> list[Result]:
    target = Target.load("target_paper.yaml")
    board = {"target": "target_paper.yaml", "poses": _poses(POOL)}
    random = np.random.default_rng(0)
    chosen = [random.permutation(POOL)[:POSES] for _ in range(REPEATS)]
    repeats: list[list[Observation]] = [[] for _ in range(REPEATS)]
    sessions: list[Session] = []
    rig = _open(folder, 8, items={"board": board}, mounted="board")
    with rig, get_context("spawn").Pool() as pool:
        plan = Plan.load("plan_board.yaml")
        with console.progress(f"Taking {POOL} poses of the board") as report:
            for pose in range(POOL):
                if pose < POSES:
                    sessions.append(
                        take_or_resume_session(rig, plan, folder / f"pose_{pose:02d}", ("board", pose))
                    )
                view = BoardWindow.of(rig, plan, target, pose)
                wanted = [r for r in range(REPEATS) if pose in chosen[r]]
                for repeat, seen in zip(wanted, _in_parallel(pool, view.observe, wanted), strict=True):
                    repeats[repeat].append(seen)
                report((pose + 1) / POOL)
        world = _world(rig)
        with console.progress("Characterising") as report:
            found = characterise_sessions(sessions, target, report)
        with console.progress(f"Characterising {REPEATS} times"):
            pulls = _in_parallel(pool, partial(_pulls, target, world), repeats)
    return [
        *_errors(found),
        _covered(np.array(pulls)),
        _refinement(found, target),
    ]


def _open(folder: Path, bits: int, **changes: Any) -> Rig:
    """The demonstration's rig over its world with changes, by section."""
    data = World.load("world_demo.yaml").model_dump(mode="json")
    for name, value in changes.items():
        data[name] = {**data[name], **value} if isinstance(value, dict) else value
    data["render"]["cache"] = False  # nothing may come from an earlier run
    (folder / "world.yaml").write_text(config.to_yaml(data))
    (folder / "rig.yaml").write_text(RIG.format(bits=bits))
    return Rig.load(folder / "rig.yaml")


def _poses(count: int) -> dict[str, Any]:
    """The rules by which the demonstration holds its board, for so many poses."""
    rules = World.load("world_demo.yaml").model_dump(mode="json")["items"]["board"]["poses"]
    return {**rules, "count": count}


def _world(rig: Rig) -> World:
    assert isinstance(rig.camera, SimCamera)
    return rig.camera.bench.world


def _in_parallel(pool: Pool, work: Any, items: Sequence[Any]) -> list[Any]:
    """In as few pieces as there are processors: what `work` carries is large."""
    return pool.map(work, items, chunksize=-(-len(items) // (os.cpu_count() or 1)))


@dataclass(frozen=True, eq=False)
class BoardWindow:
    """What reaches the part of the sensor on which the board of one pose lies, under every pattern."""

    name: str  # of the pose
    light: list[PatternLevels]  # by image
    corner: Floats  # its pixel (u, v) in the whole picture
    first: int  # number of the pose's first frame, from which the noise follows
    sensor: SensorModel  # its seed is chosen by the repeat
    settings: CameraSettings  # of every frame
    plan: Plan  # what is projected
    projector_size: tuple[int, int]  # (width, height) in px
    target: Target  # the board

    @classmethod
    def of(cls, rig: Rig, plan: Plan, target: Target, pose: int) -> BoardWindow:
        """Look at the board in one pose."""
        assert isinstance(rig.camera, SimCamera)
        fixture, caps, bench = rig.need_fixture("the benchmark"), rig.projector.caps, rig.camera.bench
        fixture.mount("board", pose)
        world, settings = bench.world, rig.camera_settings(plan.exposure_s)
        held = fixture.pose("board", pose)
        assert held is not None
        camera = world.camera_model()
        outline = camera.project(held.apply(plate_corners(target.size_mm)))
        low = np.maximum(np.floor(outline.min(axis=0)).astype(int) - MARGIN_PX, 0)
        high = np.ceil(outline.max(axis=0)).astype(int) + MARGIN_PX
        patterns = make_patterns(plan, caps.size, caps.lattice)
        rig.projector.load(patterns)
        light = []
        for i in range(len(patterns)):
            rig.projector.show(i)
            light.append(bench.irradiance(settings, 0)[low[1] : high[1], low[0] : high[0]].copy())
        sensor = replace(SensorModel.of(world), seed=0)
        first = pose * plan.images
        return cls(
            f"pose_{pose:02d}",
            light,
            low.astype(np.float64),
            first,
            sensor,
            settings,
            plan,
            caps.size,
            target,
        )

    def observe(self, repeat: int) -> Observation:
        """Observe the board in one repeat."""
        sensor, plan = replace(self.sensor, seed=repeat), self.plan
        frames = [sensor.expose(light, self.settings, self.first + i) for i, light in enumerate(self.light)]
        recording = Recording(frames, plan, self.projector_size, self.settings.bits)
        decoded, even = decode(recording), np.mean(recording.finest("x")[1], axis=0)
        seen = observe(self.name, even, decoded, self.target, finest_periods(plan, self.projector_size))
        return replace(seen, camera_px=seen.camera_px + self.corner)


def _pulls(target: Target, world: World, observations: list[Observation]) -> Floats:
    """Error over standard uncertainty of both devices' `TERMS` and of the baseline, (9,)."""
    camera, projector = world.camera_model(), world.projector_model()
    calibration = characterise(
        observations, target, camera.size, projector.size, projector.lattice
    ).calibration
    assert calibration.uncertainty is not None
    sigma, pulls = calibration.uncertainty.sigma, []
    for name, device, truth in (
        ("camera", calibration.camera, camera),
        ("projector", calibration.projector, projector),
    ):
        errors = _terms(device) - _terms(truth)
        pulls += [error / sigma[f"{name}.{term}"] for error, term in zip(errors, TERMS, strict=True)]
    true_mm = float(np.linalg.norm(world.T_projector_camera().translation))
    return np.array([*pulls, (calibration.baseline_mm - true_mm) / _baseline_sigma(calibration)])


def _terms(device: Pinhole) -> Floats:
    return device.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]


def _baseline_sigma(calibration: Calibration) -> float:
    """Standard uncertainty in mm of the distance between the devices."""
    known = calibration.uncertainty
    assert known is not None
    rows = [known.names.index(f"T_projector_camera.{axis}") for axis in "xyz"]
    along = calibration.T_projector_camera.translation / calibration.baseline_mm
    return float(np.sqrt(along @ known.covariance[np.ix_(rows, rows)] @ along))


def _errors(found: Characterisation) -> list[Result]:
    """RMS in px in the poses fitted, and of each device in poses left out."""
    left_out = found.leave_one_out_px
    assert left_out is not None
    return [
        *(below(f"characterise_{name}", found.calibration.rms_px[name], "px RMS", limit)
          for name, limit in LIMITS_PX.items()),
        *(below(f"characterise_{name}_left_out", left_out[name], "px RMS", limit)
          for name, limit in LIMITS_PX.items()),
    ]  # fmt: skip


def _covered(pulls: Floats) -> Result:
    """Of the parameter that lies within `SIGMAS` of its uncertainties the least often."""
    share = float((np.abs(pulls) <= SIGMAS).mean(axis=0).min())
    return Result("characterise_coverage", share, "share of repeats", LEAST_COVERED, share / LEAST_COVERED)


def _refinement(found: Characterisation, target: Target) -> Result:
    """Seconds for the joint refinement from Zhang's first values, median of three."""
    calibration, observations = found.calibration, found.observations
    start, _, _ = calibrate_separately(
        observations, target.points(), calibration.camera.size, calibration.projector.size
    )
    pair, _ = fit_pose_between_devices(observations, start, calibration.camera.size)
    start = replace(start, T_projector_camera=pair)
    seconds = []
    for _ in range(3):
        begin = time.perf_counter()
        adjust_bundle(observations, start, Model(found.level, target.points()))
        seconds.append(time.perf_counter() - begin)
    return below("characterise_refinement", median(seconds), "s", MOST_SECONDS)


def _response(folder: Path) -> list[Result]:
    """A projector's response that is not told, recovered from what the camera sees of a white card.

    At 12 bits: of 8 the black level is 2.6 grey levels, which rounding takes for 3.
    """
    rig = _open(folder, 12, projector={"response": HIDDEN}, mounted="grey_card")
    with rig, console.progress("Response") as report:
        response, _ = measure_response(rig, Plan.load("plan_paper.yaml").exposure_s, progress=report)
    found = response.normalised
    assert found is not None
    assert response.residual_sum is not None
    white = HIDDEN["a"] + HIDDEN["b"]
    pairs = ((found["a"], HIDDEN["a"] / white), (found["b"], HIDDEN["b"] / white), (response.g, HIDDEN["g"]))
    error = max(abs(value / truth - 1) for value, truth in pairs)
    return [
        below("response_error", error, "share", RECOVERED),
        below("response_residual_sum", response.residual_sum, "share²", RESIDUAL_SUM),
    ]
