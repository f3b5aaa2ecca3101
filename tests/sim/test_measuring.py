"""Candidates measured on a small virtual bench, as a search does it."""

import math
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab import artefacts
from fpplab.calibration.model import Calibration
from fpplab.comparison import compare
from fpplab.core import config
from fpplab.core.errors import CalibrationError, ConfigError, DataError
from fpplab.devices.rig import Rig
from fpplab.optimisation.candidate import Candidate, Score
from fpplab.optimisation.measuring import RigEvaluator
from fpplab.optimisation.study import Study
from fpplab.patterns.fringe_sets import stepped_fringes
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.measuring import reconstruct_points
from fpplab.pipeline.taking import take_or_resume_session
from sim.items import item_poses
from sim.world import World
from tests.sim.conftest import RIG, plain, write_world

START = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=12) for s in (1, 8, 64)))
STAGE = 'stage: {backend: "sim.devices:SimStage"}\n'


def candidate(*stripes: float, steps: int = 12, **where: Any) -> Candidate:
    return Candidate(tuple(stepped_fringes("x", float(s), steps) for s in stripes), START.exposure_s, **where)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig with a stage, and its true calibrations at two positions."""
    place = tmp_path_factory.mktemp("rig")
    world = World.load(write_world(place, plain()))
    (place / "rig.yaml").write_text(RIG + STAGE)
    for mm in (0.0, 20.0):
        true = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(mm), {})
        true.save(place / f"at_{mm:g}.yaml")
    return place


def study(folder: Path, **changes: Any) -> Study:
    data = {
        "name": "small",
        "artefacts": ["pillars"],
        "start": START.model_copy(update={"stage_mm": 0.0}).model_dump(mode="json", exclude_none=True),
        "calibrations": [{"stage_mm": mm, "file": str(folder / f"at_{mm:g}.yaml")} for mm in (0.0, 20.0)],
        "space": {"stripes": [None, [2, 32], [16, 228]]},
        "objectives": ["surface_smcd_um"],
        "method": {"kind": "coordinate"},
    }
    return config.validate({**data, **changes}, Study, "study")


def measured(folder: Path, *asked: tuple[Candidate, int]) -> list[tuple[Score, ...]]:
    evaluator = RigEvaluator(str(folder / "rig.yaml"), study(folder))
    try:
        return [evaluator.measure(*one) for one in asked]
    finally:
        evaluator.close()


@pytest.mark.nightly
def test_score_does_not_depend_on_evaluator_or_order(folder: Path) -> None:
    coarse, fine = candidate(1, 8, 32, stage_mm=0.0), candidate(1, 8, 64, stage_mm=0.0)
    moved = candidate(1, 8, 64, steps=6, stage_mm=10.0)
    asked = [(coarse, 1), (fine, 1), (moved, 1), (fine, 2)]
    one, other = measured(folder, *asked), measured(folder, *asked[::-1])
    assert one == other[::-1]
    by_stripes, by_seed = (one[0][0], one[1][0]), (one[1][0], one[3][0])
    assert by_stripes[0].surface_smcd_um > 1.3 * by_stripes[1].surface_smcd_um
    assert by_seed[0].surface_smcd_um != by_seed[1].surface_smcd_um
    assert one[2][0].images == 18
    assert one[2][0].seconds == pytest.approx(18 * START.exposure_s)
    assert all(scores[0].wrong_orders == 0.0 and scores[0].completeness > 0.9 for scores in one)


@pytest.mark.nightly
def test_guided_orders_follow_the_depth_range_of_the_plan(folder: Path) -> None:
    """Two near-equal sets of three images each, without a set of one stripe."""
    few = candidate(140, 152, steps=3, stage_mm=0.0)
    seen = {"fringes": [{"axis": "x", "stripes": 12.0, "steps": 3}], "stage_mm": 0.0, "unwrapping": "guided"}
    score = {}
    for depth in ([420.0, 480.0], [200.0, 4000.0], [700.0, 800.0]):
        wanted = study(folder, start={**seen, "depth_mm": depth}, space={"stripes": [[8, 20]]})
        with closing(RigEvaluator(str(folder / "rig.yaml"), wanted)) as evaluator:
            try:
                score[depth[0]] = evaluator.measure(few, 1)[0]
            except DataError as reason:
                score[depth[0]] = str(reason)
    near, wide, elsewhere = score.values()
    assert isinstance(near, Score)
    assert near.wrong_orders == 0.0
    assert near.completeness > 0.9
    assert "guided unwrapping in this depth range needs a set" in str(wide)
    assert isinstance(elsewhere, str) or elsewhere.completeness < 0.1


@pytest.mark.whole
def test_score_agrees_with_a_scan_and_its_comparison(folder: Path, tmp_path: Path) -> None:
    """Only the noise differs."""
    plan = Candidate.of(START).plan(START).model_copy(update={"stage_mm": 0.0})
    score = measured(folder, (Candidate.of(plan), 1))[0][0]
    with Rig.load(folder / "rig.yaml") as rig:
        session = take_or_resume_session(rig, plan, tmp_path / "scan", ("pillars", 0))
        true = artefacts.make("pillars")
        true.apply_transform(rig.fixture.pose("pillars").matrix)  # type: ignore[union-attr]
    calibration = Calibration.load(folder / "at_0.yaml")
    _, cloud = reconstruct_points(session, calibration)
    wanted = compare(cloud, true, calibration, align=True)
    assert score.surface_smcd_um == pytest.approx(wanted.surface_smcd_um, rel=0.03)
    assert score.surface_rms_um == pytest.approx(wanted.surface_rms_um, rel=0.05)
    assert score.smcd_um == pytest.approx(wanted.smcd_um, rel=0.02)
    assert score.points == pytest.approx(wanted.points, rel=0.01)


@pytest.mark.nightly
def test_artefact_of_unknown_pose_is_located(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a real rig, where an operator places it."""
    asked = candidate(1, 8, 64, stage_mm=0.0), 1
    known = measured(folder, asked)[0][0]
    monkeypatch.setattr("sim.devices.SimFixture._pose", lambda self, item, pose: None)
    found = measured(folder, asked)[0][0]
    assert found.surface_smcd_um == pytest.approx(known.surface_smcd_um, rel=0.05)
    assert found.points == pytest.approx(known.points, rel=0.01)
    assert found.wrong_orders == 0.0


def test_triangulation_angle_follows_from_the_triangle(folder: Path) -> None:
    """Camera at the origin, projector, and the middle of the artefact: by the lengths of the sides."""
    world = World.load(folder / "world.yaml")
    with closing(RigEvaluator(str(folder / "rig.yaml"), study(folder))) as evaluator:
        for mm in (0.0, 20.0):
            true = artefacts.make("pillars").apply_transform(item_poses(world, "pillars")[0].matrix)
            middle, projector = true.bounds.mean(axis=0), world.T_projector_camera(mm).inverse().translation
            a, b, c = (float(np.linalg.norm(side)) for side in (middle, middle - projector, projector))
            angle = math.degrees(math.acos((a**2 + b**2 - c**2) / (2 * a * b)))
            assert evaluator.triangulation_angle_deg(candidate(1, 8, 64, stage_mm=mm)) == pytest.approx(angle)


def test_study_without_calibrations_or_artefact_is_refused(folder: Path) -> None:
    rig = str(folder / "rig.yaml")
    with pytest.raises(CalibrationError, match="'calibrations' names none"):
        RigEvaluator(rig, study(folder, calibrations=[])).measure(candidate(1, 8, 64), 1)
    evaluator = RigEvaluator(rig, study(folder, artefacts=["card"]))
    try:
        with pytest.raises(CalibrationError, match="at 0, 20 mm; 'stage_mm' must give"):
            evaluator.measure(candidate(1, 8, 64), 1)
        with pytest.raises(CalibrationError, match="'stage_mm' is 21"):
            evaluator.measure(candidate(1, 8, 64, stage_mm=21.0), 1)
        with pytest.raises(ConfigError, match="there is no artefact 'card'"):
            evaluator.measure(candidate(1, 8, 64, stage_mm=0.0), 1)
    finally:
        evaluator.close()
