"""The emulated stage controller by itself, compared with GRBL's documentation."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.emulators.grbl import GrblController, GrblPolicy, GrblState, Rail
from drivers.emulators.grbl.drive import Brake, Ramp
from drivers.emulators.grbl.gcode import Modes

POSITIVE = st.floats(0.01, 500.0)


class Talk:
    """A controller, and a clock that only the test moves."""

    def __init__(self, settings: dict[int, float] | None = None, policy: GrblPolicy | None = None) -> None:
        self.now = 0.0
        self.controller = GrblController(lambda: self.now, settings, Rail(), policy)
        self.controller.poll()

    def __call__(self, text: str | bytes, after_s: float = 0.0) -> list[str]:
        """Send, let time pass, and return the lines that came."""
        self.controller.receive(text.encode() if isinstance(text, str) else text)
        self.now += after_s
        return [line for line in self.controller.poll().decode().split("\r\n") if line]

    def homed(self) -> Talk:
        assert self("$H\n", 60.0) == ["ok"]
        return self


# --- motion


@given(POSITIVE, POSITIVE, POSITIVE, st.floats(0.0, 1.0))
def test_ramps_are_symmetric(distance: float, rate: float, acceleration: float, share: float) -> None:
    ramp = Ramp(distance, rate, acceleration)
    assert ramp.travelled_mm(ramp.duration_s) == distance
    t = share * ramp.duration_s
    assert ramp.travelled_mm(t) + ramp.travelled_mm(ramp.duration_s - t) == pytest.approx(distance)
    assert ramp.speed_mm_s(t) <= rate


@given(POSITIVE, POSITIVE, POSITIVE, st.floats(0.0, 1.0))
def test_brakes_go_on_with_the_speed_they_find(
    distance: float, rate: float, acceleration: float, share: float
) -> None:
    ramp = Ramp(distance, rate, acceleration)
    t = share * ramp.duration_s
    brake = Brake(ramp.speed_mm_s(t), acceleration)
    assert ramp.travelled_mm(t) + brake.distance_mm <= distance * (1 + 1e-9)
    step = 1e-4 * ramp.duration_s
    assert brake.travelled_mm(min(step, brake.duration_s)) <= ramp.speed_mm_s(t) * step * (1 + 1e-9)


def test_a_move_takes_its_time() -> None:
    """100 mm at 20 mm/s and 100 mm/s²: 5 s, and 0.2 s for both ramps together."""
    talk = Talk().homed()
    assert talk("G53G0X-102\n") == ["ok"]
    assert talk("?", 2.6)[0].startswith("<Run|MPos:-2.000,")
    assert talk("?")[0].startswith("<Run|MPos:-52.000,0.000,0.000|FS:1200,0")
    talk("", 2.59)
    assert talk.controller.mode is GrblState.RUN
    talk("", 0.02)
    assert talk("?")[0].startswith("<Idle|MPos:-102.000,")


def test_a_pause_is_answered_when_the_motion_has_ended() -> None:
    talk = Talk().homed()
    assert talk("G53G0X-102\nG4P0\n", 5.1) == ["ok"]
    assert talk("", 0.2) == ["ok"]


@given(st.floats(0.0, 5.2))
def test_a_hold_stops(at_s: float) -> None:
    talk = Talk().homed()
    talk("G53G0X-102\n", at_s)
    where = talk.controller.drive.position[0]
    speed = talk.controller.drive.speed_mm_s(talk.now)
    talk("!", 1.0)
    stopped = talk.controller.drive.position[0]
    assert talk.controller.mode is GrblState.HOLD
    assert where - stopped == pytest.approx(speed**2 / 200, abs=1 / 400)
    assert talk("?")[0].startswith("<Hold:0|")
    assert talk.controller.drive.carriage_mm == pytest.approx(-stopped)
    assert talk("G53G0X-10\n$$\n", 60.0) == []  # until a reset


def test_homing_takes_its_time_and_tells_nothing_meanwhile() -> None:
    """42 mm at 10 mm/s, then off, slowly back and off again, with a pause of 0.25 s each."""
    legs = [Ramp(42.0, 10.0, 100.0), Ramp(2.0, 10.0, 100.0), Ramp(2.0, 1.0, 100.0), Ramp(2.0, 10.0, 100.0)]
    seconds = sum(leg.duration_s + 0.25 for leg in legs)
    talk = Talk()
    assert talk("$H\n", seconds - 0.01) == []
    assert talk("?") == []
    assert talk("", 0.02) == ["ok"]
    assert talk("?")[0].startswith("<Idle|MPos:-2.000,")


def test_moves_wait_for_each_other_and_lines_in_the_buffer() -> None:
    talk = Talk().homed()
    assert talk("".join(f"G53G0X-{n}\n" for n in range(10, 20))) == ["ok"]
    assert [line for _ in range(30) for line in talk("", 1.0)] == ["ok"] * 9
    assert talk.controller.drive.position[0] == -19.0
    talk("G53G0X-100\nG4P0\n")
    talk("G4P0\n" * 100)  # 500 bytes for 127 places
    assert len(talk("", 60.0)) <= 1 + 127 / 5 + 1


# --- limits, alarms, resets


def test_it_is_locked_until_homed() -> None:
    talk = Talk()
    assert talk("G0X-5\n") == ["error:9"]
    assert talk.homed()("G0X-5\n") == ["ok"]


def test_a_target_outside_locks_it_until_a_reset() -> None:
    talk = Talk().homed()
    assert talk("G53G0X1\n") == ["ALARM:2", "[MSG:Reset to continue]"]
    assert talk("?$X\n") == []
    assert talk(b"\x18") == ["ok", "Grbl 1.1f ['$' for help]", "[MSG:'$H'|'$X' to unlock]"]
    assert talk.controller.drive.position[0] == -2.0


def test_a_reset_in_motion_is_an_alarm_and_at_rest_is_none() -> None:
    talk = Talk().homed()
    assert talk(b"\x18") == ["Grbl 1.1f ['$' for help]"]
    talk("G53G0X-100\n", 1.0)
    assert talk(b"\x18")[0] == "ALARM:3"
    assert talk("?")[0].startswith("<Alarm|")


def test_a_reset_in_homing_is_an_alarm() -> None:
    talk = Talk()
    talk("$H\n", 1.0)
    assert talk(b"\x18")[:2] == ["ALARM:6", "ok"]
    assert Talk(policy=GrblPolicy(ok_after_abort=False))("$H\n\x18")[:2] == [
        "ALARM:6",
        "Grbl 1.1f ['$' for help]",
    ]


def test_a_failed_homing_restarts_it() -> None:
    talk = Talk()
    talk.controller.drive.switch_works = False
    assert talk("$H\n", 100.0) == [
        "ALARM:9",
        "ok",
        "Grbl 1.1f ['$' for help]",
        "[MSG:'$H'|'$X' to unlock]",
    ]


def test_an_end_stop_makes_it_lose_steps() -> None:
    talk = Talk({20: 0, 21: 0}).homed()
    talk("G53G0X-300\n", 60.0)
    assert talk.controller.drive.position[0] == -300.0
    assert talk.controller.drive.carriage_mm == 205.0


# --- lines


ERRORS_OF_LINES = {
    "5X": 1, "G0X": 2, "$Q": 3, "$J=G91X-1F5": 3, "G0X-5" + "0" * 90: 11, "G20.5": 20, "M3": 20,
    "G1X-5F60": 20, "G0X-5Y-5": 20, "G4P1": 20, "G0G0X-5": 21, "G0X-5X-6": 25, "G4": 28,
}  # fmt: skip


@pytest.mark.parametrize("line", ERRORS_OF_LINES)
def test_wrong_lines_have_their_numbers(line: str) -> None:
    talk = Talk().homed()
    assert talk(line + "\n")[0] == f"error:{ERRORS_OF_LINES[line]}"
    assert talk.controller.mode is GrblState.IDLE


@given(st.text("GXYZFPLN0123456789.-$=H?!~ JM;()\n", max_size=40), st.binary(max_size=40))
def test_nothing_that_is_sent_makes_it_fall(text: str, noise: bytes) -> None:
    talk = Talk().homed()
    talk(text + "\n", 1.0)
    talk(noise + b"\n", 1.0)
    assert talk(b"\x18", 0.0)[-1].startswith(("Grbl 1.1f", "[MSG:'$H'"))


def test_homing_that_is_switched_off_is_refused() -> None:
    assert Talk({20: 0, 22: 0})("$H\n") == ["error:5"]


def test_settings_are_told() -> None:
    told = Talk({10: 3, 130: 123.4567})("$$\n")
    assert "$130=123.457" in told
    assert "$10=3" in told
    assert told[-1] == "ok"


def test_what_needs_rest_is_refused_in_motion() -> None:
    talk = Talk().homed()
    assert talk("G53G0X-100\n$$\n$H\n$I\n", 0.1) == ["ok", "error:8", "error:8", "error:8"]


def test_an_offset_left_behind_is_told_and_obeyed_and_outlives_a_reset() -> None:
    talk = Talk({10: 0}).homed()
    talk("?")
    talk.controller.leave_modes(Modes(offset=(-2.0, 0.0, 0.0)))
    assert talk("?")[0] == "<Idle|WPos:0.000,0.000,0.000|FS:0,0|WCO:-2.000,0.000,0.000>"
    talk("G0X-10\n", 10.0)
    assert talk.controller.drive.position[0] == -12.0
    talk(b"\x18")
    talk("G0X-15\n", 10.0)
    assert talk.controller.drive.position[0] == -17.0


def test_modes_left_behind_hold_until_a_line_says_otherwise() -> None:
    talk = Talk().homed()
    talk.controller.leave_modes(Modes(in_inches=True, is_relative=True))
    talk("G0X-1\n", 20.0)
    assert talk.controller.drive.position[0] == pytest.approx(-2.0 - 25.4, abs=1 / 400)
    talk("G90G21G0X-10\n", 20.0)
    talk("G0X-20\n", 20.0)
    assert talk.controller.drive.position[0] == -20.0


def test_the_offset_comes_in_the_first_report_and_in_every_tenth() -> None:
    talk = Talk()
    told = ["WCO" in talk("?")[0] for _ in range(21)]
    assert [i for i, yes in enumerate(told) if yes] == [0, 10, 20]


def test_a_jog_is_braked_and_forgotten() -> None:
    talk = Talk().homed()
    talk.controller.jog(-102.0, 10.0)
    assert talk("", 1.0) == []
    assert talk("?")[0].startswith("<Jog|")
    assert talk("G0X0\n$H\n") == ["error:9", "error:8"]
    talk("!", 1.0)
    assert talk("?")[0].startswith("<Idle|MPos:-12.000")  # 9.5 mm, and 0.5 mm to brake from 10 mm/s
