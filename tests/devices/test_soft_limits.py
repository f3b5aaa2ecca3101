"""Soft limits of the rig file: moves beyond them need consent, and the travel holds in any case."""

import io
import sys
from pathlib import Path

import pytest

from fpplab.calibration.model import Calibration
from fpplab.core import confirmation
from fpplab.core.confirmation import ConfirmationRequired, confirm_in_advance
from fpplab.core.errors import ConfigError, LimitError
from fpplab.devices import StageMove
from fpplab.devices.rig import Rig
from sim.world import World
from tests.support.commands import run

RIG = """name: twin
bench: {backend: "sim.devices:VirtualBench", world: world_demo.yaml, binning: 8, analytic: true}
camera: {backend: "sim.devices:SimCamera"}
projector: {backend: "sim.devices:SimProjector"}
stage: {backend: "sim.devices:SimStage", soft_limits_mm: [-10, 20]}
"""


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG, encoding="utf-8")
    return path


def test_beyond_the_soft_limits_nothing_moves_without_consent(
    rig_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Rig.load(rig_file) as rig:
        stage = rig.stage
        assert stage is not None
        rig.place_stage(20.0)
        for refused in (lambda: rig.need_stage(20.1), lambda: stage.move_to(20.1)):
            with pytest.raises(
                LimitError, match=r"20.1 mm lies beyond the soft limits of the rig file, -10 to"
            ):
                refused()
        assert stage.position_mm == 20.0
        monkeypatch.setattr(confirmation, "_has_terminal", lambda: True)
        monkeypatch.setattr(sys, "stdin", io.StringIO("n\ny\n"))
        with pytest.raises(LimitError, match="--allow beyond-soft-limits"):
            stage.move_to(30.0)
        assert stage.position_mm == 20.0
        rig.place_stage(30.0)  # asked once for the look ahead and the move together
        assert stage.position_mm == 30.0


def test_the_flag_allows_them_but_never_the_end_of_the_travel(rig_file: Path) -> None:
    confirm_in_advance([ConfirmationRequired.BEYOND_SOFT_LIMITS])
    try:
        with Rig.load(rig_file) as rig:
            rig.place_stage(-30.0)
            with pytest.raises(LimitError, match="the travel is -60 to 60 mm"):
                rig.need_stage(61.0)
    finally:
        confirm_in_advance([])


def test_a_move_is_foreseen_without_moving(rig_file: Path) -> None:
    with Rig.load(rig_file) as rig:
        assert rig.stage is not None
        assert rig.plan_stage_move(20.0) == StageMove(None, 20.0, (-60.0, 60.0), (-10.0, 20.0), False)
        rig.place_stage(5.0)
        assert [rig.plan_stage_move(mm).needs_consent for mm in (-10.1, -10.0, 20.1)] == [True, False, True]
        assert rig.plan_stage_move(30.0).start_mm == rig.stage.position_mm == 5.0
        with pytest.raises(LimitError, match="the travel is -60 to 60 mm"):
            rig.plan_stage_move(60.1)


def test_a_dry_run_of_a_scan_says_where_the_stage_would_go(rig_file: Path) -> None:
    folder, world = rig_file.parent, World.load("world_demo.yaml")
    rig_file.write_text(RIG.replace("binning: 8, ", ""), encoding="utf-8")
    known = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})
    known.save(folder / "calibration.yaml")
    (folder / "plan.yaml").write_text(
        "stage_mm: 30\nfringes:\n" + "".join(f"- {{axis: x, stripes: {n}, steps: 4}}\n" for n in (1, 8))
    )
    words = ("scan", "--rig", "rig.yaml", "--plan", "plan.yaml", "--calibration", "calibration.yaml")
    done = run(*words, "--out", "s", "--dry-run", "--json", cwd=folder)
    assert done.code == 0, done.err
    assert (done.json["images"], done.json["dry_run"], done.json["replaces"]) == (8, True, False)
    assert done.json["stage"] == {
        "start_mm": None,
        "target_mm": 30.0,
        "travel_mm": [-60.0, 60.0],
        "soft_limits_mm": [-10.0, 20.0],
        "needs_consent": True,
    }
    assert sorted(path.name for path in folder.iterdir()) == ["calibration.yaml", "plan.yaml", "rig.yaml"]
    assert "--allow beyond-soft-limits" in run(*words, "--out", "s", cwd=folder).err


def test_limits_that_do_not_rise_are_refused(rig_file: Path) -> None:
    rig_file.write_text(RIG.replace("[-10, 20]", "[20, -10]"), encoding="utf-8")
    with pytest.raises(ConfigError, match="'soft_limits_mm' must be two rising positions"):
        Rig.load(rig_file)
