"""What `fpplab check` tells of the trigger, with the real drivers on an emulated bench."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.dlp4500.sequence import SIZE
from drivers.emulators.bench import BenchFaults
from fpplab.acquisition import acquire
from fpplab.acquisition.synchronisation import Cause, SyncFault
from fpplab.core.progress import ignore
from fpplab.devices.rig import Rig
from fpplab.diagnosis.causes.of_rig_check import (
    CAMERA_NOT_READY,
    NO_TRIGGER,
    OUT_OF_STEP,
    TRIGGER_EDGE,
    TRIGGER_SHIFTED,
)
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import Plan
from fpplab.setup.rig_check import marker_check
from fpplab.setup.rig_check.check import RigCheck, check_rig
from fpplab.setup.rig_check.marker import marker
from fpplab.setup.rig_check.marker_check import MarkerRun
from tests.drivers.emulated_rig import PLAN, bench_of, burn, on_video, rig_file

DIM = PLAN.model_copy(update={"exposure_s": 0.016})
SLOW = pytest.mark.whole


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("checked")
    burn(folder, uniform_patterns(marker().tolist(), SIZE))
    return folder


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame that does not come is waited for briefly; on this bench time is the computer's only then."""
    monkeypatch.setattr(acquire, "READ_TIMEOUT_S", 0.1)


def checked(rig: Rig) -> RigCheck:
    return check_rig(rig, DIM, "white", ignore)


@pytest.mark.parametrize("rig_on", [rig_file, pytest.param(on_video, marks=SLOW)])
def test_a_sound_bench(folder: Path, rig_on: Callable[..., Rig]) -> None:
    assert checked(rig_on(folder)).findings == ()


@pytest.mark.whole
@pytest.mark.parametrize(
    ("faults", "fault"),
    [
        ({"doubled": [4]}, SyncFault(Cause.DOUBLED, 5)),
        pytest.param({"extra": True}, SyncFault(Cause.LATE), marks=SLOW),
        pytest.param({"missed": [0]}, SyncFault(Cause.EARLY), marks=SLOW),
        ({"missed": [2]}, SyncFault(Cause.MISSED, 2)),
        pytest.param({"missed": [6]}, SyncFault(Cause.MISSED, 6), marks=SLOW),
    ],
)
def test_pulses_that_slip(folder: Path, faults: dict[str, Any], fault: SyncFault) -> None:
    (finding,) = checked(rig_file(folder, {"faults": faults})).findings
    assert finding.cause == OUT_OF_STEP
    assert finding.evidence.startswith(f"triggered: {fault.describe()}")


def test_no_pulse(folder: Path) -> None:
    (finding,) = checked(rig_file(folder, {"faults": {"cut": True}})).findings
    assert finding.cause == NO_TRIGGER
    assert finding.evidence == "none of 12 frames came"
    assert "trigger cable" in finding.remedy


@pytest.mark.whole
@pytest.mark.parametrize(
    "sections",
    [{"camera": {"trigger": {"edge": "falling"}}}, {"projector": {"trigger_out_1": {"inverted": True}}}],
)
def test_the_wrong_edge(folder: Path, sections: dict[str, Any]) -> None:
    (finding,) = checked(rig_file(folder, **sections)).findings
    assert finding.cause == TRIGGER_EDGE
    assert "`edge`" in finding.remedy


@pytest.mark.parametrize("delay_ms", [3.0, pytest.param(1.0, marks=SLOW), pytest.param(8.0, marks=SLOW)])
def test_exposures_that_begin_late(folder: Path, delay_ms: float) -> None:
    trigger = {"trigger": {"delay_us": 1e3 * delay_ms}}
    (finding,) = checked(rig_file(folder, camera=trigger)).findings
    assert finding.cause == TRIGGER_SHIFTED
    found = re.search(r"about ([\d.]+) ms too late", finding.evidence)
    assert found is not None
    assert float(found[1]) == pytest.approx(delay_ms, abs=0.35)  # the gap of 0.231 ms is dark
    assert "delay_us" in finding.remedy


@SLOW
def test_both_edges_the_other_way_round_are_right(folder: Path) -> None:
    sections: dict[str, Any] = {
        "camera": {"trigger": {"edge": "falling"}},
        "projector": {"trigger_out_1": {"inverted": True}},
    }
    assert checked(rig_file(folder, **sections)).findings == ()


@pytest.mark.whole
@pytest.mark.parametrize(("untold_us", "dead_s"), [(300.0, 0.0007), pytest.param(4000.0, 0.0052, marks=SLOW)])
def test_a_camera_that_is_not_ready_yet(folder: Path, untold_us: float, dead_s: float) -> None:
    """It needs more time than it tells; with the time that the check finds it is ready."""
    sensor = {"sensor": {"untold_us": untold_us}}
    (finding,) = checked(rig_file(folder, sensor)).findings
    assert finding.cause == CAMERA_NOT_READY
    assert finding.evidence.startswith("6 of 12 frames came")
    assert finding.remedy == f"put `dead_time_s: {dead_s:g}` into the rig file's section of the camera"
    assert checked(rig_file(folder, sensor, {"dead_time_s": dead_s})).findings == ()


@SLOW
def test_a_slip_that_does_not_happen_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    really_run = marker_check._show_marker_once

    def once(rig: Rig, plan: Plan, *more: Any) -> MarkerRun:
        bench_of(rig).faults = BenchFaults(missed=missed.pop() if plan.trigger == "triggered" else ())
        return really_run(rig, plan, *more)

    missed: list[tuple[int, ...]] = [(), (), (3,)]
    monkeypatch.setattr(marker_check, "_show_marker_once", once)
    (finding,) = checked(rig_file(folder)).findings
    assert (finding.cause, missed) == (OUT_OF_STEP, [])
    assert finding.evidence.endswith("when it was repeated, all frames were in step")
