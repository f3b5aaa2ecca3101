"""`fpplab check --steps` with the real drivers on an emulated bench."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.dlp4500.sequence import SIZE
from drivers.emulators import bench as emulated
from drivers.emulators.dlpc350 import STRICT
from fpplab.acquisition import acquire
from fpplab.core.progress import ignore
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import uniform_patterns
from fpplab.setup.rig_check.marker import marker
from fpplab.setup.rig_check.steps import CheckedStep, _Steps, check_steps
from tests.drivers.emulated_rig import PLAN, burn, on_video, patterns, rig_file

DIM = PLAN.model_copy(update={"exposure_s": 0.016})
ALL = ["link", "lamp", "one pulse", "ten pulses", "rate", "long patterns", "exposure", "focus"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stepped")
    burn(folder, [*patterns(), *uniform_patterns(marker().tolist(), SIZE)])
    return folder


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame that does not come is waited for briefly; on this bench time is the computer's only then."""
    monkeypatch.setattr(acquire, "READ_TIMEOUT_S", 0.1)


def stepped(rig: Rig) -> dict[str, CheckedStep]:
    told: list[CheckedStep] = []
    found = check_steps(rig, DIM, "white", ignore, told.append)
    assert told == found
    return {step.name: step for step in found}


@pytest.mark.whole
@pytest.mark.parametrize("rig_on", [rig_file, pytest.param(on_video, marks=pytest.mark.nightly)])
def test_a_sound_bench(folder: Path, rig_on: Callable[..., Rig]) -> None:
    found = stepped(rig_on(folder))
    assert list(found) == ALL
    assert all(step.ok and not step.remedy for step in found.values()), found


@pytest.mark.whole
def test_the_shortest_period_is_what_the_sensor_takes(folder: Path) -> None:
    """Beyond the exposure it needs more than the projector's gap, and a little less than is allowed for."""
    rate = stepped(rig_file(folder, {"sensor": {"dead_us": 1000.0}}))["rate"]
    needed_s = (0.016 + 1e-3) * (1 + 1e-4)
    assert rate.ok
    assert needed_s <= rate.values["shortest_period_s"] <= rate.values["planned_period_s"]
    assert rate.values["planned_period_s"] == pytest.approx(needed_s, rel=2e-3)
    assert "5 of 10 at" in rate.seen


@pytest.mark.whole
def test_a_dead_time_that_is_not_told_is_found(folder: Path) -> None:
    sensor = {"sensor": {"untold_us": 1500.0}}
    rate = stepped(rig_file(folder, sensor))["rate"]
    assert not rate.ok
    dead_s = float(rate.remedy.split("`")[1].split(": ")[1])
    assert stepped(rig_file(folder, sensor, {"dead_time_s": dead_s}))["rate"].ok


@pytest.mark.whole
@pytest.mark.parametrize("stretches", [False, True])
@pytest.mark.parametrize(
    ("rig_on", "sections", "remedy"),
    [
        (rig_file, {}, ""),
        (on_video, {"bench": {"sensor": {"dead_us": 4000.0}}}, "expose for as long as patterns are shown"),
    ],
)
def test_it_is_told_whether_a_long_pattern_is_repeated(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    stretches: bool,
    rig_on: Callable[..., Rig],
    sections: dict[str, Any],
    remedy: str,
) -> None:
    """It does harm only where patterns are shown for longer than they are exposed."""
    monkeypatch.setattr(emulated, "STRICT_BOARD", replace(STRICT, stretches_patterns=stretches))
    plan = DIM.model_copy(update={"trigger": "triggered", "exposure_s": 0.008334})
    with rig_on(folder, **sections) as rig:
        steps = _Steps(rig, plan)
        assert steps.lamp().ok
        step = steps.long_patterns()
    assert step.values["repeats"] is not stretches
    assert "is stretched over it" in step.seen if stretches else "is repeated within it" in step.seen
    assert step.ok is not (stretches and bool(remedy))
    assert step.remedy.startswith(remedy if stretches else "")
    assert bool(step.remedy) is not step.ok


@pytest.mark.whole_after(3)
@pytest.mark.parametrize(
    ("sections", "failing", "seen", "remedy"),
    [
        ({"bench": {"faults": {"cut": True}}}, "one pulse", "0 of 1 frames came", "trigger cable"),
        ({"bench": {"faults": {"missed": [3]}}}, "ten pulses", " of 10 frames came", "plugs"),
        (
            {"projector": {"led_levels": {"red": 0, "green": 0, "blue": 0}}},
            "lamp",
            "white is brighter than black by 0",
            "LEDs",
        ),
        ({"camera": {"serial": "0815-0009"}}, "link", "0815-0009", ""),
    ],
)
def test_what_fails_is_named_and_ends_what_needs_it(
    folder: Path, sections: dict[str, Any], failing: str, seen: str, remedy: str
) -> None:
    found = stepped(rig_file(folder, **sections))
    step = found[failing]
    assert [name for name, one in found.items() if not one.ok] == [failing]
    assert seen in step.seen
    assert remedy in step.remedy
    after = ALL[ALL.index(failing) + 1 :]
    left = {"exposure", "focus"} if "pulse" in failing else set()
    assert set(found) == {*ALL[: ALL.index(failing) + 1], *(left & set(after))}
