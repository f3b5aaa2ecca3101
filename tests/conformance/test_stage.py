"""What every stage does, and what it refuses."""

import math

import pytest

from fpplab.core.errors import DeviceTimeoutError, LimitError, StateError
from fpplab.devices import Stage, State

TOLERANCE_MM = 0.05


def somewhere(stage: Stage, share: float) -> float:
    least, most = stage.caps.travel_mm
    return least + share * (most - least)


def test_caps_make_sense(stage: Stage) -> None:
    least, most = stage.caps.travel_mm
    assert least < most


def test_moves_before_homing_are_refused(stage: Stage) -> None:
    before = stage.position_mm
    with pytest.raises(StateError, match="not homed"):
        stage.move_to(somewhere(stage, 0.5))
    assert stage.position_mm == before
    assert stage.state is State.IDLE


def test_the_position_is_read_back(stage: Stage) -> None:
    stage.home()
    for share in (0.1 / math.pi, 0.02, 0.05):
        wanted = somewhere(stage, share)
        back = stage.move_to(wanted)
        assert back == pytest.approx(wanted, abs=TOLERANCE_MM)
        assert stage.position_mm == back
        assert stage.move_to(back) == back


def test_moves_out_of_the_travel_are_refused(stage: Stage) -> None:
    stage.home()
    here = stage.move_to(somewhere(stage, 0.02))
    least, most = stage.caps.travel_mm
    for mm in (math.nextafter(least, -math.inf), math.nextafter(most, math.inf), math.nan, math.inf):
        with pytest.raises(LimitError, match="the travel is"):
            stage.move_to(mm)
        with pytest.raises(LimitError, match="the travel is"):
            stage.check(mm)
        assert stage.position_mm == here
    stage.check(most)
    assert stage.position_mm == here
    assert stage.state is State.IDLE


def test_both_ends_of_the_travel_are_reached(stage: Stage) -> None:
    stage.home()
    for end in reversed(stage.caps.travel_mm):
        assert stage.move_to(end) == pytest.approx(end, abs=TOLERANCE_MM)
        assert stage.state is State.IDLE


def test_after_a_halt_it_must_be_homed_again(stage: Stage) -> None:
    stage.home()
    stage.halt()
    with pytest.raises(StateError, match="not homed"):
        stage.move_to(somewhere(stage, 0.02))
    stage.home()
    assert stage.move_to(somewhere(stage, 0.02)) == pytest.approx(somewhere(stage, 0.02), abs=TOLERANCE_MM)


def test_after_reopening_it_must_be_homed_again(stage: Stage) -> None:
    stage.home()
    stage.close()
    stage.open()
    with pytest.raises(StateError, match="not homed"):
        stage.move_to(somewhere(stage, 0.02))


def test_a_move_that_takes_too_long_is_a_fault(stage: Stage) -> None:
    """No time at all is enough only for a stage that is there at once."""
    stage.home()
    wanted = somewhere(stage, 0.5)
    try:
        assert stage.move_to(wanted, timeout_s=0.0) == pytest.approx(wanted, abs=TOLERANCE_MM)
    except DeviceTimeoutError:
        assert stage.state is State.FAULT
