"""The language of GRBL: every kind of line, and nothing else; and the driver under noise."""

import re
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.emulators.grbl import GrblController
from drivers.stage_grbl import GrblStage, device, wire
from drivers.stage_grbl.lines import (
    ALARMS,
    ERRORS,
    STATES,
    Alarm,
    GrblError,
    GrblMessage,
    Ok,
    OtherLine,
    Setting,
    StatusReport,
    Welcome,
    describe_alarm,
    describe_error,
    parse_line,
)
from fpplab.core.errors import DeviceError
from tests.drivers.grbl_stage import DirectLine, VirtualTime

LINES: dict[str, GrblMessage] = {
    "ok": Ok(),
    "error:9": GrblError(9),
    "ALARM:1": Alarm(1),
    "Grbl 1.1f ['$' for help]": Welcome("1.1f"),
    "Grbl 0.9j ['$' for help]": Welcome("0.9j"),
    "$100=250.000": Setting(100, 250.0),
    "$10=255": Setting(10, 255.0),
    "<Idle|MPos:0.000,-10.000,5.000|FS:0,0>": StatusReport("Idle", None, (0.0, -10.0, 5.0), None, None, ""),
    "<Hold:1|WPos:-2.500,0.000,11.000|Bf:15,128|FS:500,8000|Pn:XP>": StatusReport(
        "Hold", 1, None, (-2.5, 0.0, 11.0), None, "XP"
    ),
    "<Run|MPos:0.0000,0.3937,0.0000|F:5|WCO:0.0000,1.5510,5.6640|Ov:100,100,100|A:SFM>": StatusReport(
        "Run", None, (0.0, 0.3937, 0.0), None, (0.0, 1.551, 5.664), ""
    ),
    "[MSG:'$H'|'$X' to unlock]": OtherLine("[MSG:'$H'|'$X' to unlock]"),
    "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]": OtherLine("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]"),
    ">G54G20:ok": OtherLine(">G54G20:ok"),
    "$N0=G54": OtherLine("$N0=G54"),
}


@pytest.mark.parametrize("line", LINES)
def test_every_kind_of_line_is_understood(line: str) -> None:
    assert parse_line(line) == LINES[line]


@pytest.mark.parametrize("line", LINES)
def test_half_a_line_is_not_understood(line: str) -> None:
    """But for a number cut short, which nobody could see: of settings and codes alone."""
    for end in range(1, len(line)):
        if re.fullmatch(r"\$\d+=\d+\.?\d*|error:\d+|ALARM:\d+|\$N\d=.*", line[:end]):
            continue
        with pytest.raises(ValueError, match="not a"):
            parse_line(line[:end])


@pytest.mark.whole
@given(st.text(max_size=60))
def test_any_text_is_a_line_or_refused(text: str) -> None:
    with suppress(ValueError):
        assert isinstance(parse_line(text), GrblMessage)


COORDINATES = st.tuples(*[st.integers(-999_999, 999_999).map(lambda n: n / 1000)] * 3)


@given(st.sampled_from(STATES), COORDINATES, st.none() | COORDINATES, st.sampled_from(["", "X", "XYZ"]))
def test_reports_are_read_as_they_are_written(
    state: str, machine: tuple[float, ...], offset: tuple[float, ...] | None, pins: str
) -> None:
    def written(axes: tuple[float, ...]) -> str:
        return ",".join(f"{mm:.3f}" for mm in axes)

    fields = [state, f"MPos:{written(machine)}", "FS:0,0"]
    fields += [f"Pn:{pins}"] if pins else []
    fields += [f"WCO:{written(offset)}"] if offset else []
    assert parse_line(f"<{'|'.join(fields)}>") == StatusReport(state, None, machine, None, offset, pins)


def test_every_code_has_its_words() -> None:
    """The codes of GRBL's own tables."""
    assert set(ERRORS) == {*range(1, 18), *range(20, 39)}
    assert set(ALARMS) == set(range(1, 10))
    assert describe_error(9) == "error:9, locked by an alarm or while jogging"
    assert describe_alarm(77) == "ALARM:77, which GRBL 1.1 does not document"


def direct(patch: pytest.MonkeyPatch, spoil: dict[int, tuple[int, int]]) -> tuple[GrblStage, GrblController]:
    """A stage without a wire, where bytes of what the controller says are replaced: (line, (place, byte))."""
    clock, said = [0.0], [0]
    controller = GrblController(lambda: clock[0])

    def spoiled(line: str) -> str:
        said[0] += 1
        if said[0] not in spoil:
            return line
        place, byte = spoil[said[0]]
        place %= len(line)
        return line[:place] + chr(byte) + line[place + 1 :]

    controller.alter_line = spoiled
    patch.setattr(wire.serial, "Serial", DirectLine(controller, clock))
    for module in (wire, device):
        patch.setattr(module, "time", VirtualTime(clock))
    return GrblStage("stage", {"port": "direct"}), controller


def test_a_board_that_dtr_holds_in_reset_is_released(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that answers neither way is not said to be held."""
    stage, controller = direct(monkeypatch, {})
    line = wire.serial.Serial
    line.dtr = line.rts = True
    receive = controller.receive
    monkeypatch.setattr(controller, "receive", lambda data: None if line.dtr or line.rts else receive(data))
    with stage:
        assert stage.position_mm == 0.0
    monkeypatch.setattr(controller, "receive", lambda data: None)
    with pytest.raises(DeviceError, match=r"no GRBL controller answers at .*, nor with DTR and RTS off"):
        stage.open()


def test_without_noise_the_direct_line_works(monkeypatch: pytest.MonkeyPatch) -> None:
    stage, controller = direct(monkeypatch, {})
    with stage:
        stage.home()
        assert stage.move_to(50.0) == 50.0
        assert controller.drive.carriage_mm == 52.0


@settings(max_examples=200)
@given(st.dictionaries(st.integers(1, 60), st.tuples(st.integers(0, 80), st.integers(0, 127)), max_size=3))
def test_noise_never_makes_a_wrong_success(spoil: dict[int, tuple[int, int]]) -> None:
    """Wherever bytes of the answers are damaged, the move ends where it should, or in an error of the stage.

    By what the controller tells: that a digit of the position was damaged on the way, no line can show.
    """
    with pytest.MonkeyPatch.context() as patch:
        stage, controller = direct(patch, spoil)
        try:
            with stage:
                stage.home()
                back = stage.move_to(50.0)
                assert controller.drive.motion is None
        except DeviceError:
            return
        assert abs(back - 50.0) < 0.01
