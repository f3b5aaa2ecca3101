"""The stage driver over a pseudo-terminal: where it goes, and what it says when something is wrong."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from drivers.emulators import terminal
from drivers.emulators.grbl import GrblController, GrblPolicy, GrblState, Rail
from drivers.emulators.grbl.drive import DEFAULTS
from drivers.emulators.grbl.gcode import Modes
from drivers.stage_grbl import GrblStage, device, wire
from drivers.stage_grbl.device import Mechanics
from drivers.stage_grbl.wire import GrblWire
from fpplab.core.errors import (
    ConfigError,
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    LimitError,
    ProtocolError,
)
from fpplab.devices import State
from tests.drivers.grbl_stage import PULL_OFF_MM, STEP_MM, Bench

HALF_STEP = STEP_MM / 2 + 1e-9
BRISK: dict[int, float] = {24: 6000.0, 25: 6000.0, 26: 0}
"""Homes in about 3 s, so that the clock need not run fast."""


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench() as made:
        yield made


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time-outs that a test can wait for."""
    for module, name in ((wire, "ANSWER_S"), (device, "ANSWER_S"), (device, "START_S")):
        monkeypatch.setattr(module, name, 0.1)


# --- where it goes


@pytest.mark.parametrize("start_mm", [-0.5, 0.0, 42.0, 204.0])
def test_homing_ends_at_zero_wherever_it_began(start_mm: float) -> None:
    with Bench(rail=Rail(start_mm=start_mm)) as bench:
        stage = bench.homed()
        assert stage.position_mm == 0.0
        assert bench.controller.drive.carriage_mm == PULL_OFF_MM


def test_it_moves_where_there_are_no_pseudo_terminals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows has none: the emulated line is a socket there, which is opened again and again."""
    monkeypatch.setattr(terminal, "system_module", lambda name: None)
    with Bench() as bench:
        for mm in (3.0, 5.0):
            assert bench.homed().move_to(mm, 5.0) == pytest.approx(mm, abs=HALF_STEP)
            bench.stage.close()


AS_DELIVERED = Modes()
SET_UPS: dict[str, tuple[dict[int, float], GrblPolicy, Modes]] = {
    "as delivered": ({}, GrblPolicy(), AS_DELIVERED),
    "switch at the negative end": ({23: 1}, GrblPolicy(), AS_DELIVERED),
    "origin forced": ({}, GrblPolicy(forces_origin=True), AS_DELIVERED),
    "origin forced at the negative end": ({23: 1}, GrblPolicy(forces_origin=True), AS_DELIVERED),
    "work positions": ({10: 0}, GrblPolicy(), AS_DELIVERED),
    "work positions with an offset": ({10: 0}, GrblPolicy(), Modes(offset=(-12.5, 0.0, 0.0))),
    "machine positions with an offset": ({}, GrblPolicy(), Modes(offset=(-12.5, 0.0, 0.0))),
    "inches": ({13: 1}, GrblPolicy(), Modes(in_inches=True)),
    "inches with an offset": ({13: 1, 10: 0}, GrblPolicy(), Modes(offset=(-12.5, 0.0, 0.0))),
    "relative": ({}, GrblPolicy(), Modes(is_relative=True)),
    "coarse steps": ({100: 80.5}, GrblPolicy(), AS_DELIVERED),
    "not locked": ({}, GrblPolicy(locks_at_power_up=False), AS_DELIVERED),
    "buffers told": ({10: 3}, GrblPolicy(), AS_DELIVERED),
}


@pytest.mark.parametrize("name", SET_UPS)
def test_the_carriage_goes_where_it_is_sent(name: str) -> None:
    """However the controller is set, and whatever modes and offset another program has left behind."""
    settings, policy, left_behind = SET_UPS[name]
    half_step = 0.5 / settings.get(100, 400.0)
    digit = 25.4 * 0.00005 if settings.get(13) else 0.0005
    with Bench(settings, policy=policy) as bench:
        stage = bench.homed()
        with bench.terminal.lock:
            bench.controller.leave_modes(replace(left_behind))
        for mm in (10.0, 150.1234, stage.caps.travel_mm[1], 0.0):
            back = stage.move_to(mm)
            moved = bench.controller.drive.carriage_mm - PULL_OFF_MM
            assert moved == pytest.approx(mm, abs=2 * half_step + digit)  # home is at a whole step itself
            assert back == pytest.approx(mm, abs=half_step + digit + 1e-4)
            assert stage.position_mm == back


def test_another_axis_is_driven() -> None:
    with Bench(rail=Rail(axis=1)) as bench:
        bench.stage = GrblStage("stage", {"port": bench.terminal.port, "axis": "Y"})
        bench.homed().move_to(25.0)
        assert bench.controller.drive.carriage_mm == pytest.approx(25.0 + PULL_OFF_MM, abs=HALF_STEP)


@pytest.mark.parametrize("axis", ["Y", "Z"])
@pytest.mark.parametrize("settings", [{}, {23: 7}])
def test_an_axis_that_is_not_homed_is_refused(axis: str, settings: dict[int, float]) -> None:
    """The controller answers `ok`, but its homing cycle has moved another axis."""
    with Bench(settings, rail=Rail(axis=0)) as bench:
        bench.stage = GrblStage("stage", {"port": bench.terminal.port, "axis": axis})
        bench.stage.open()
        with pytest.raises(DeviceError, match=f"axis {axis} at 0.000 mm.*does not home this axis"):
            bench.stage.home()
        assert bench.stage.state is State.FAULT


@pytest.mark.parametrize("policy", [GrblPolicy(), GrblPolicy(forces_origin=True)])
def test_a_controller_that_does_not_tell_its_build_options(policy: GrblPolicy) -> None:
    with Bench(policy=policy) as bench:
        bench.alter_line("[OPT:", "[TPO:")
        assert bench.homed().position_mm == 0.0


def test_nothing_is_sent_for_a_target_outside_the_travel(bench: Bench) -> None:
    stage = bench.homed()
    bench.heard.clear()
    for mm in (-0.001, stage.caps.travel_mm[1] + 0.001):
        with pytest.raises(LimitError, match="the travel is 0 to"):
            stage.move_to(mm)
    assert b"G" not in bench.heard
    assert stage.state is State.IDLE


def test_the_far_end_is_one_step_inside_the_limit_of_the_controller(bench: Bench) -> None:
    stage = bench.homed()
    limit_mm = bench.controller.settings.travel_mm(0) - PULL_OFF_MM
    assert stage.caps.travel_mm == (0.0, pytest.approx(limit_mm - STEP_MM, abs=1e-9))


def test_it_says_what_it_is(bench: Bench) -> None:
    bench.stage.open()
    info = bench.stage.info()
    assert (info.model, info.link) == ("GRBL 1.1f", f"serial {bench.terminal.port}")


# --- stopping


def test_a_halt_brakes_before_it_resets() -> None:
    """So that the position survives: GRBL would give ALARM:3 for a reset in motion."""
    with Bench(BRISK, times=4.0) as bench:
        stage = bench.homed()
        bench.jog(-100.0)
        time.sleep(0.1)  # up to speed
        stage.halt()
        assert bench.controller.mode is GrblState.IDLE
        drive = bench.controller.drive
        assert drive.motion is None
        assert drive.carriage_mm > PULL_OFF_MM + 2.0  # it was moving
        assert drive.carriage_mm == pytest.approx(-drive.position[0], abs=STEP_MM)


def test_a_move_that_takes_too_long_is_braked_and_reported() -> None:
    with Bench(BRISK, times=4.0) as bench:
        stage = bench.homed()
        with pytest.raises(DeviceTimeoutError, match=r"still at .* mm on its way to 100 mm"):
            stage.move_to(100.0, timeout_s=0.1)
        assert stage.state is State.FAULT
        stage.close()
        assert bench.controller.drive.motion is None
        assert bench.controller.drive.carriage_mm < 20.0
        assert bench.controller.mode is GrblState.IDLE  # no alarm: nothing was lost


@pytest.mark.parametrize("operation", ["move_to", "home"])
def test_an_interruption_leaves_it_at_rest(
    operation: str, monkeypatch: pytest.MonkeyPatch, impatient: None
) -> None:
    """Ctrl-C arrives while it moves; closing stops the stage."""
    wait = GrblWire.wait_for_answer

    def interrupted(line_to_it: GrblWire, doing: str, line: str, within_s: float) -> bool:
        if line in (device.HOME, device.AFTER_MOTION):
            time.sleep(0.1)  # on its way by now
            raise KeyboardInterrupt
        return wait(line_to_it, doing, line, within_s)

    with Bench(BRISK, times=4.0) as bench:
        stage = bench.homed()
        with monkeypatch.context() as patch:
            patch.setattr(GrblWire, "wait_for_answer", interrupted)
            with pytest.raises(KeyboardInterrupt):
                _use(stage, operation)
        assert bench.controller.mode is (GrblState.RUN if operation == "move_to" else GrblState.HOME)
        stage.close()
        assert bench.controller.drive.motion is None
        assert bench.controller.mode is (GrblState.IDLE if operation == "move_to" else GrblState.ALARM)


# --- what goes wrong on the rail


def test_a_limit_switch_ends_the_move(bench: Bench, impatient: None) -> None:
    stage = bench.homed()
    stage.move_to(100.0)
    bench.controller.drive.lose_steps(-30.0)
    with pytest.raises(DeviceError, match=r"ALARM:1, a limit switch was hit"):
        stage.move_to(0.0)
    assert stage.state is State.FAULT
    stage.close()


def test_steps_lost_towards_the_switch_are_seen_without_hard_limits() -> None:
    with Bench({21: 0}) as bench:
        stage = bench.homed()
        stage.move_to(100.0)
        bench.controller.drive.lose_steps(-30.0)
        assert stage.move_to(50.0) == 50.0  # nothing tells yet
        with pytest.raises(DeviceError, match=r"home switch is pressed although .* steps were lost"):
            stage.move_to(0.0)


def test_other_lost_steps_are_put_right_by_homing(bench: Bench) -> None:
    """GRBL cannot see them; the promise is only that homing again makes the position true."""
    stage = bench.homed()
    stage.move_to(100.0)
    bench.controller.drive.lose_steps(5.0)
    assert stage.move_to(50.0) == 50.0
    assert bench.controller.drive.carriage_mm == pytest.approx(57.0, abs=HALF_STEP)
    stage.home()
    stage.move_to(50.0)
    assert bench.controller.drive.carriage_mm == pytest.approx(52.0, abs=HALF_STEP)


def test_homing_without_a_switch_fails_though_ok_follows(bench: Bench) -> None:
    bench.stage.open()
    bench.controller.drive.switch_works = False
    with pytest.raises(DeviceError, match="ALARM:9, homing failed: no switch was found"):
        bench.stage.home()
    assert bench.stage.state is State.FAULT


def test_homing_with_a_stuck_switch_fails(bench: Bench) -> None:
    bench.stage.open()
    bench.controller.drive.switch_sticks = True
    with pytest.raises(DeviceError, match="ALARM:8, homing failed: the switch stays pressed"):
        bench.stage.home()


# --- what goes wrong with the controller


def test_a_reset_in_a_move_is_an_alarm(bench: Bench) -> None:
    stage = bench.homed()
    bench.at_mm(50.0, lambda: bench.controller.receive(b"\x18"))
    with pytest.raises(DeviceError, match="ALARM:3, it was reset while it moved"):
        stage.move_to(100.0)


def test_a_restart_in_a_move_loses_the_position(bench: Bench) -> None:
    stage = bench.homed()
    bench.at_mm(50.0, bench.controller.power_cycle)
    with pytest.raises(
        DeviceError, match=r"has restarted, and the stage.s position is lost; .* home it again"
    ):
        stage.move_to(100.0)
    stage.close()
    stage.open()
    stage.home()
    assert stage.move_to(20.0) == 20.0


@pytest.mark.parametrize("use", [lambda s: s.move_to(5.0), lambda s: s.position_mm, lambda s: s.home()])
def test_a_restart_while_it_stands_is_noticed(
    use: Callable[[GrblStage], object], bench: Bench, impatient: None
) -> None:
    stage = bench.homed()
    with bench.terminal.lock:
        bench.controller.power_cycle()
    with pytest.raises(DeviceError, match="has restarted"):
        use(stage)
    stage.close()


def test_a_restart_whose_welcome_was_lost_is_noticed(bench: Bench) -> None:
    stage = bench.homed()
    bench.type(b"\x18")
    with bench.terminal.lock:
        bench.controller.power_cycle()
        bench.controller.poll()
    with pytest.raises(DeviceError, match="is in state 'Alarm'"):
        stage.move_to(5.0)


def test_a_hold_by_somebody_else_is_reported(bench: Bench) -> None:
    stage = bench.homed()
    bench.at_mm(50.0, lambda: bench.controller.receive(b"!"))
    with pytest.raises(DeviceError, match="is in state 'Hold' and does not move"):
        stage.move_to(100.0)


def test_a_held_move_does_not_end_however_late_the_emulator_is_called() -> None:
    clock = [0.0]
    controller = GrblController(lambda: clock[0], {22: 0})
    controller.drive.call_at(-50.0, lambda: controller.receive(b"!"))
    controller.receive(b"G90G21G53G0X-100\nG4P0\n")
    controller.poll()
    clock[0] = 3600.0
    assert controller.poll() == b"", "the pause after the move is not over"
    controller.receive(b"?")
    assert controller.poll().startswith(b"<Hold:0|")


def test_a_move_cut_short_is_noticed(bench: Bench) -> None:
    """Held, and the rest of the move thrown away by another program that hides what it does."""
    stage = bench.homed()

    def meddle() -> None:
        bench.controller.drive.brake(bench.controller._clock())

    bench.at_mm(50.0, meddle)
    with pytest.raises(DeviceError, match=r"stopped at [5-9]\d\.\d* mm, not at 100 mm"):
        stage.move_to(100.0)


def test_homing_switched_off_is_said_at_once() -> None:
    with (
        Bench({22: 0, 20: 0}) as bench,
        pytest.raises(DeviceError, match=r"homing is switched off \(\$22=0\)"),
    ):
        bench.stage.open()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("$100=400.000", "$100=0.000", "incomplete or zero"),
        ("$120=100.000", "$120=0.000", "incomplete or zero"),
        ("$27=2.000\r\n", "", "incomplete or zero"),
        ("$130=200.000", "$130=2.000", r"the travel \$130=2 is within the pull-off \$27=2"),
    ],
)
def test_settings_that_cannot_be_are_refused(old: str, new: str, words: str, bench: Bench) -> None:
    bench.alter_line(old, new)
    with pytest.raises(DeviceError, match=words):
        bench.stage.open()


def test_another_version_is_refused(bench: Bench) -> None:
    bench.alter_line("Grbl 1.1f", "Grbl 0.9j")
    with pytest.raises(DeviceError, match=r"speaks GRBL 0\.9j"):
        bench.stage.open()


# --- what goes wrong on the wire


@pytest.mark.parametrize("use", ["open", "home", "move_to", "position_mm", "halt"])
def test_silence_is_a_time_out(
    use: str, bench: Bench, impatient: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = bench.stage
    if use != "open":
        bench.homed()
        monkeypatch.setattr(stage, "_mechanics", replace(stage._open_mechanics, homing_s=0.1))
    bench.controller.alter_line = lambda line: ""
    with pytest.raises(DeviceTimeoutError):
        _use(stage, use)
    assert stage.state is (State.CLOSED if use == "open" else State.FAULT)
    bench.controller.alter_line = lambda line: line


@pytest.mark.parametrize(("use", "line"), [("open", r"\$\$"), ("home", r"\$H"), ("move_to", "G90G21G53")])
def test_a_lost_ok_is_a_time_out(
    use: str, line: str, bench: Bench, impatient: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Status reports still come, so that nothing but the missing `ok` shows what was lost."""
    stage = bench.stage
    if use != "open":
        bench.homed()
        monkeypatch.setattr(stage, "_mechanics", replace(stage._open_mechanics, homing_s=0.1))
    bench.controller.alter_line = lambda sent: "" if sent.strip() == "ok" else sent
    with pytest.raises(DeviceTimeoutError, match=f"no answer to '{line}"):
        _use(stage, use)
    assert stage.state is (State.CLOSED if use == "open" else State.FAULT)
    bench.controller.alter_line = lambda sent: sent


@pytest.mark.parametrize(
    ("old", "new"),
    [("ok", "o\x00k"), ("ok", "okok"), ("MPos", "MPxs"), ("Idle", "Idel"), ("<", ""), (">", ""), (".", "..")],
)
def test_noise_is_never_ignored(old: str, new: str, bench: Bench) -> None:
    stage = bench.homed()
    bench.alter_line(old, new)
    with pytest.raises(ProtocolError, match="check the cable"):
        stage.move_to(20.0)
    assert stage.state is State.FAULT
    bench.alter_line("", "")


def test_lines_without_end_are_no_answer(bench: Bench, impatient: None) -> None:
    stage = bench.homed()
    bench.alter_line("\n", "")
    with pytest.raises(DeviceTimeoutError, match="no report"):
        stage.move_to(20.0)
    bench.alter_line("", "")


@pytest.mark.parametrize("use", ["home", "move_to"])
def test_a_refusal_is_told_in_words(use: str, bench: Bench) -> None:
    stage = bench.homed()
    bench.alter_line("ok", "error:3")
    with pytest.raises(DeviceError, match=r"refused '.*': error:3, an unknown \$ command"):
        _use(stage, use)
    bench.alter_line("", "")


def test_noise_without_end_is_not_collected(bench: Bench) -> None:
    stage = bench.homed()
    bench.controller.alter_line = lambda line: "\x7f" * 1000
    with pytest.raises(ProtocolError, match="set the controller to 115200 baud"):
        stage.move_to(20.0)
    bench.controller.alter_line = lambda line: line


def test_answers_to_another_program_are_noticed(bench: Bench) -> None:
    stage = bench.homed()
    with bench.terminal.lock:
        bench.controller.receive(b"G4P0\n")
    time.sleep(0.02)
    with pytest.raises(ProtocolError, match="another program uses the port"):
        stage.move_to(20.0)


def test_a_stage_moved_by_another_program_is_noticed(bench: Bench) -> None:
    stage = bench.homed()
    bench.jog(-PULL_OFF_MM - 5.0)
    time.sleep(0.05)
    with pytest.raises(DeviceError, match=r"was left at 0\.000 mm and is at 5\.000 mm; close other programs"):
        stage.move_to(20.0)


def _use(stage: GrblStage, use: str) -> object:
    return {
        "open": stage.open,
        "home": stage.home,
        "move_to": lambda: stage.move_to(150.0),
        "position_mm": lambda: stage.position_mm,
        "halt": stage.halt,
    }[use]()


@pytest.mark.parametrize("use", ["home", "move_to", "position_mm", "halt"])
def test_unplugged_before_an_operation(use: str, bench: Bench) -> None:
    stage = bench.homed()
    bench.terminal.unplug()
    time.sleep(0.02)
    with pytest.raises(DisconnectedError, match="is gone"):
        _use(stage, use)
    assert stage.state is State.FAULT


def test_unplugged_in_a_move(bench: Bench) -> None:
    """It may be moving still, which nobody can stop: closing says so as well."""
    stage = bench.homed()
    bench.at_mm(50.0, bench.terminal.unplug)
    with pytest.raises(DisconnectedError, match=r"move_to: .* is gone"):
        stage.move_to(150.0)
    with pytest.raises(DisconnectedError, match=r"close: .* is gone"):
        stage.close()
    assert stage.state is State.CLOSED


def test_unplugged_at_rest_it_closes_quietly(bench: Bench) -> None:
    stage = bench.homed()
    bench.terminal.unplug()
    time.sleep(0.02)
    stage.close()
    with pytest.raises(DisconnectedError, match=r"there is no /dev"):
        stage.open()


def test_a_port_in_use_is_said(bench: Bench) -> None:
    bench.stage.open()
    other = GrblStage("second stage", {"port": bench.terminal.port})
    with pytest.raises(DeviceError, match="is in use; close the other program"):
        other.open()


def test_a_port_that_may_not_be_used_is_said(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object, **__: object) -> None:
        raise OSError(13, "could not open port: Permission denied")

    monkeypatch.setattr(wire.serial, "Serial", forbidden)
    with pytest.raises(DeviceError, match=r"no permission to use .*; see `fpplab devices`"):
        bench.stage.open()


@pytest.mark.parametrize(
    ("options", "words"),
    [({}, "'port' is missing"), ({"axis": "A"}, "'axis' is 'A'"), ({"speed": 9}, "'speed'")],
)
def test_wrong_options_are_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        GrblStage("stage", options).open()


def test_homing_gets_the_time_it_may_need() -> None:
    """The longest search before ALARM:9, at 10 mm/s on three axes of 200 mm, and pull-offs at 1 mm/s."""
    assert 3 * (30.0 + 3 * 2.0 + 4 * 0.25) < Mechanics.of(DEFAULTS, 0).homing_s < 300.0
