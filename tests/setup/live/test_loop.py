"""The loop: other commands get the rig within a frame, and the bench is left dark."""

import threading
import time
from pathlib import Path

import pytest

from fpplab.core.conventions import Mask
from fpplab.core.errors import DeviceError
from fpplab.devices import Frame, State
from fpplab.devices.rig import Rig
from fpplab.devices.rig_lock import watching_rig
from fpplab.patterns.fringes import Pattern
from fpplab.setup.live.loop import LiveOptions, LiveSetUp
from fpplab.setup.live.orders import VIEW_ORDERS, Order
from fpplab.setup.live.patterns import View
from fpplab.setup.live.status import LiveStatus
from tests.conformance.bench import devices_of
from tests.setup.live.benches import PLAN, Operator, operate, rig_file
from tests.support.commands import Command


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    return rig_file(tmp_path)


def test_it_ends_by_itself_and_leaves_the_rig_closed(rig: Path) -> None:
    operator = Operator()
    made = Rig.load(rig)
    setup = LiveSetUp(made, LiveOptions(PLAN, frames=11), operator.orders, operator)
    with watching_rig(rig) as turn:
        last = setup.run(turn)
        assert not turn.is_mine
    assert last.frames == len(operator.frames) == 11
    assert all(device.state is State.CLOSED for device in devices_of(made))
    start = time.monotonic()
    operate(rig, Operator(), seconds=0.5)
    assert 0.5 <= time.monotonic() - start < 20


def test_every_view_shows_its_own_pattern(rig: Path) -> None:
    operator = Operator(*VIEW_ORDERS, Order.QUIT, after=9)
    operate(rig, operator)
    shown: dict[View, set[str]] = {}
    for status, pattern in zip(operator.seen, operator.patterns, strict=True):
        assert pattern is not None
        shown.setdefault(status.view, set()).add(pattern.id)
    assert shown[View.WHITE] == {"grey-255"}
    assert shown[View.BLACK] == {"grey-000"}
    assert shown[View.CHECKER] == {"live-checker"}
    assert shown[View.CROSS] == {"live-cross"}
    assert len(shown[View.COARSE]) == len(shown[View.FINE]) == 1
    assert shown[View.COARSE] | shown[View.FINE] <= shown[View.MEASURE]
    assert operator.seen[-1].levels is not None  # white, checker and cross are measured as well


@pytest.mark.whole
def test_a_command_gets_the_rig_and_the_set_up_goes_on(rig: Path) -> None:
    """The devices are closed while the command has the rig, and open again afterwards, with the exposure."""
    from tests.devices.test_rig_lock import waiting

    states: list[tuple[bool, State]] = []

    class Watching(Operator):
        def __call__(
            self, status: LiveStatus, frame: Frame | None, pattern: Pattern | None, dark: Mask | None
        ) -> bool:
            states.append((status.paused_for is not None, made.camera.state))
            return super().__call__(status, frame, pattern, dark)

    operator, made = Watching(Order.LONGER), Rig.load(rig)
    setup = LiveSetUp(made, LiveOptions(PLAN, seconds=60.0), operator.orders, operator)
    with watching_rig(rig) as turn, waiting(rig) as process:
        thread = threading.Thread(target=end_after, args=(setup, operator, process))
        thread.start()
        last = setup.run(turn)
        thread.join()
    assert last.pauses == 1
    assert {state for paused, state in states if paused} == {State.CLOSED}
    pause = [paused for paused, _ in states].index(True)
    assert any(not paused for paused, _ in states[pause:])
    assert f"process {process.pid} " in str(next(s for s in operator.seen if s.paused_for).paused_for)
    assert last.settings is not None
    assert last.settings.exposure_s == pytest.approx(PLAN.exposure_s * 2**0.5)
    assert last.message == "the rig is free again"


def end_after(setup: LiveSetUp, operator: Operator, process) -> None:  # type: ignore[no-untyped-def]
    """Once the other command has had the rig for a while, end it; once frames come again, quit."""
    process.stdout.readline()
    time.sleep(0.3)
    process.kill()
    process.wait()
    came = len(operator.frames)
    deadline = time.monotonic() + 30
    while len(operator.frames) < came + 3 and time.monotonic() < deadline:
        time.sleep(0.02)
    operator.orders.put(Order.QUIT)


def test_a_pose_that_is_interrupted_is_no_pose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rig is let go within a frame even while a pose is taken; what there is of it is deleted."""
    from fpplab.devices.rig_lock import RigTurn
    from fpplab.targets import Target
    from tests.setup.live.test_coverage import BOTH_AXES

    path = rig_file(tmp_path)
    asked: list[bool] = []

    def is_requested(turn: RigTurn) -> bool:
        begun = any((tmp_path / "poses").glob("pose_*/*"))
        asked.append(begun)
        return begun and asked.count(True) == 3

    monkeypatch.setattr(RigTurn, "is_requested", is_requested)
    operator = Operator(Order.TAKE, after=2)
    board = Target.load(tmp_path / "board.yaml")
    setup = operate(path, operator, plan=BOTH_AXES, target=board, poses=tmp_path / "poses", frames=12)
    assert setup.poses == ()
    assert not any((tmp_path / "poses").glob("pose_*"))
    assert "another command wanted the rig; take the pose again" in [s.message for s in operator.seen]


def test_the_operator_closes_the_viewer(rig: Path) -> None:
    class Closing(Operator):
        def __call__(
            self, status: LiveStatus, frame: Frame | None, pattern: Pattern | None, dark: Mask | None
        ) -> bool:
            return super().__call__(status, frame, pattern, dark) and len(self.frames) < 5

    operator = Closing()
    operate(rig, operator)
    assert len(operator.frames) == 5


def test_orders_that_make_no_sense_here_are_answered(rig: Path) -> None:
    operator = Operator(Order.TAKE, Order.NEXT_POSE, Order.FORWARD, Order.QUIT, after=2)
    operate(rig, operator)
    said = " ".join(status.message for status in operator.seen)
    assert "give --target" in said
    assert "no --item was given" in said
    assert "is not homed" in said


def test_a_device_that_fails_ends_it(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from sim.devices import SimCamera

    def broken(camera: SimCamera, timeout_s: float) -> Frame:
        raise OSError("the cable is out")

    monkeypatch.setattr(SimCamera, "_read", broken)
    with pytest.raises(DeviceError, match="the cable is out"):
        operate(rig, Operator(), frames=3)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("rig_demo_quick.yaml", ("plan", "show", "plan_paper")),
        ("rig_emulated_quick.yaml", ("check", "--item", "grey_card")),
    ],
)
def test_a_command_beside_live_just_works(name: str, command: tuple[str, ...], fpplab: Command) -> None:
    """Whole commands, on the simulated bench and on the real drivers."""
    import json
    import re
    import subprocess
    import sys
    import urllib.request

    words = ["live", "--rig", name, "--item", "grey_card", "--no-view", "--seconds", "300", "--json"]
    with subprocess.Popen(
        [sys.executable, "-m", "fpplab", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as live:
        assert live.stderr is not None
        found = re.search(r"http://\S+", live.stderr.readline())
        assert found is not None

        def state() -> dict[str, object]:
            with urllib.request.urlopen(found.group() + "state", timeout=20) as reply:
                return dict(json.load(reply))

        until(lambda: int(str(state().get("frames", 0))) > 2)
        done = fpplab(*command, "--rig", name, "--json")
        assert done.code == 0, done.err
        frames = int(str(state()["frames"]))
        until(lambda: int(str(state()["frames"])) > frames + 2)
        body = json.dumps({"order": "quit"}).encode()
        urllib.request.urlopen(urllib.request.Request(found.group() + "order", body), timeout=20).close()
        out, _ = live.communicate(timeout=60)
    assert live.returncode == 0
    answer = json.loads(out)
    assert answer["pauses"] >= 1  # a command that opens the rig twice may find it taken again
    assert answer["frames"] > frames
    assert answer["poses"] == []


def until(true) -> None:  # type: ignore[no-untyped-def]
    deadline = time.monotonic() + 240
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.1)
