"""Stages by name, stages that turn, thermometers, and dead times that grow with the exposure."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fpplab.core.errors import ConfigError, LimitError
from fpplab.devices import StageCaps
from fpplab.devices.rig import Rig
from fpplab.patterns.plan import Plan, StagePosition
from fpplab.pipeline.taking import plan_stage_moves, take_or_resume_session
from fpplab.sessions.origin import session_origin
from tests.conformance.bench import FLAT
from tests.conformance.reference import ReferenceCamera, ReferenceStage

RIG = """name: A turntable before the camera
bench: {backend: "tests.conformance.reference:ReferenceBench"}
camera: {backend: "tests.devices.test_axes:WarmCamera"}
projector: {backend: "tests.conformance.reference:ReferenceProjector"}
stages:
  turntable: {backend: "tests.devices.test_axes:Turntable", soft_limits_mm: [0, 180]}
"""
PLAN = Plan(fringes=(FLAT,), exposure_s=0.02, stages=(StagePosition(stage="turntable", at=90.0),))


class Turntable(ReferenceStage):
    """Turns by 360 degrees."""

    def _caps(self) -> StageCaps:
        return StageCaps((0.0, 360.0), unit="deg")


class WarmCamera(ReferenceCamera):
    """Has a thermometer."""

    def _temperature_c(self) -> float:
        return 41.5


@pytest.fixture(autouse=True)
def _backends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FPPLAB_ALLOW_BACKEND", "tests")


def opened(folder: Path, text: str = RIG) -> Rig:
    (folder / "rig.yaml").write_text(text, encoding="utf-8")
    return Rig.load(folder / "rig.yaml")


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    with opened(tmp_path) as rig:
        yield rig


def test_a_plan_turns_the_table_and_the_session_says_so(rig: Rig, tmp_path: Path) -> None:
    session = take_or_resume_session(rig, PLAN, tmp_path / "session")
    assert rig.stages["turntable"].position_mm == 90.0
    assert "stages:\n- stage: turntable\n  at: 90.0\n" in (session.path / "plan.yaml").read_text(
        encoding="utf-8"
    )
    origin = session_origin(session.path)
    assert origin is not None
    assert origin.devices["turntable"].model == "reference"
    assert origin.temperatures_c == {"camera": 41.5}


@pytest.mark.parametrize(
    ("stage", "at", "error", "complaint"),
    [
        ("turntable", 400.0, LimitError, "400 deg was asked for; the travel is 0 to 360 deg"),
        (
            "turntable",
            270.0,
            LimitError,
            "270 deg lies beyond the soft limits of the rig file, 0 to 180 deg",
        ),
        ("lift", 5.0, ConfigError, "'stages.lift' is missing, and the plan's stages need it at 5"),
    ],
)
def test_where_it_cannot_turn_nothing_is_written(
    rig: Rig, tmp_path: Path, stage: str, at: float, error: type[Exception], complaint: str
) -> None:
    plan = PLAN.model_copy(update={"stages": (StagePosition(stage=stage, at=at),)})
    for use in (take_or_resume_session, lambda *given: plan_stage_moves(*given, replace_existing=False)):
        with pytest.raises(error) as refused:
            use(rig, plan, tmp_path / "session")
        assert complaint in str(refused.value)
    assert not (tmp_path / "session").exists()


def test_a_turntable_does_not_set_the_baseline(tmp_path: Path) -> None:
    text = RIG.replace("stages:\n  turntable: ", "stage: ")
    with (
        opened(tmp_path, text) as rig,
        pytest.raises(ConfigError, match="'stage' turns, and the plan's stage_mm 5"),
    ):
        rig.need_stage(5.0)


def test_a_stage_is_not_called_as_another_section(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="'stages' has one called 'camera'"):
        opened(tmp_path, RIG.replace("  turntable:", "  camera:"))


@pytest.mark.parametrize(
    ("stated", "dead_s"),
    [("0.004", 0.004), ("{fixed_s: 0.001, of_exposure: 0.1}", 0.003), ("{of_exposure: 0.1}", 0.002)],
)
def test_a_dead_time_may_grow_with_the_exposure(tmp_path: Path, stated: str, dead_s: Any) -> None:
    rig = opened(tmp_path, RIG.replace('WarmCamera"', f'WarmCamera", dead_time_s: {stated}'))
    assert rig.file.camera.dead_s(0.02) == pytest.approx(dead_s)
