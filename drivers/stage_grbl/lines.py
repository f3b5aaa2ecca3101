"""Messages of a GRBL 1.1 controller, line by line, and the meaning of its error and alarm codes.

Every line is of one kind, recognised by its beginning: an answer to the one line sent before (`ok`,
`error:9`), or a message that may come at any time.

Source: GRBL's interface documentation, `doc/markdown/interface.md` and `doc/csv` of github.com/gnea/grbl.
"""

import re
from dataclasses import dataclass

RESET, HOLD, STATUS = b"\x18", b"!", b"?"
"""Real-time commands: single bytes that are executed at once and are not answered by `ok`."""

AXES = "XYZ"
STATES = ("Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep")

Axes = tuple[float, ...]
"""One number for each axis of the controller, X first; in mm or inches, as set by `$13`."""

ERRORS = {
    1: "a word has no letter",
    2: "a number is missing or malformed",
    3: "an unknown $ command",
    4: "a negative value where none is allowed",
    5: "homing is switched off ($22=0)",
    6: "step pulses under 3 µs",
    7: "its settings memory could not be read and was reset to defaults",
    8: "a $ command that needs the controller to be idle",
    9: "locked by an alarm or while jogging",
    10: "soft limits need homing ($22=1)",
    11: "the line is too long",
    12: "more steps per second than the controller can generate",
    13: "the safety door is open",
    14: "the line is too long to be stored",
    15: "the jog would leave the travel",
    16: "a malformed jog",
    17: "laser mode needs a controllable output",
    20: "an unsupported G-code command",
    21: "two G-code commands of one group",
    22: "the feed rate is not set",
    23: "a whole number is needed",
    24: "two commands that both need axis words",
    25: "a word is repeated",
    26: "axis words are missing",
    27: "the line number is out of range",
    28: "a value word is missing",
    29: "a work coordinate system that does not exist",
    30: "G53 needs G0 or G1",
    31: "axis words that nothing uses",
    32: "an arc without axis words in its plane",
    33: "the target of the motion is invalid",
    34: "the radius of the arc is invalid",
    35: "an arc without offsets in its plane",
    36: "words that nothing uses",
    37: "the tool offset is for another axis",
    38: "the tool number is too great",
}
"""Meaning of the codes of `error:N`."""

ALARMS = {
    1: "a limit switch was hit, and steps were lost in the sudden stop",
    2: "the target lies outside the travel",
    3: "it was reset while it moved, and steps were lost in the sudden stop",
    4: "the probe was not in its initial state",
    5: "the probe made no contact",
    6: "homing failed: it was reset meanwhile",
    7: "homing failed: the safety door was opened",
    8: "homing failed: the switch stays pressed after the pull-off ($27)",
    9: "homing failed: no switch was found within 1.5 times the travel ($130 to $132)",
}
"""Meaning of the codes of `ALARM:N`."""


@dataclass(frozen=True)
class Ok:
    """`ok`: the line sent was accepted; a motion is then planned, not yet carried out."""


@dataclass(frozen=True)
class GrblError:
    """`error:N`: the line sent was not executed."""

    code: int  # see `ERRORS`


@dataclass(frozen=True)
class Alarm:
    """`ALARM:N`: the controller has stopped and locked itself."""

    code: int  # see `ALARMS`


@dataclass(frozen=True)
class Welcome:
    """Startup message: the controller has started or restarted."""

    version: str  # GRBL's version, such as "1.1h"


@dataclass(frozen=True)
class StatusReport:
    """Answer to the status query `?`.

    A report holds the machine position or the work position; the work coordinate offset is sent only in some
    reports. Positions are in mm or inches, as set by `$13`.
    """

    state: str  # one of `STATES`
    substate: int | None  # number behind the state, such as 0 in `Hold:0`
    machine: Axes | None  # machine position (MPos)
    work: Axes | None  # work position (WPos)
    offset: Axes | None  # work coordinate offset (WCO): machine minus work position
    pins: str  # letters of the inputs that are active (Pn), X for the limit switch of axis X


@dataclass(frozen=True)
class Setting:
    """One line of the answer to `$$`."""

    number: int  # number of the setting, 130 for `$130`
    value: float  # its value


@dataclass(frozen=True)
class OtherLine:
    """Any other line that the protocol allows: bracketed messages, startup lines."""

    text: str  # the whole line


GrblMessage = Ok | GrblError | Alarm | Welcome | StatusReport | Setting | OtherLine

_WELCOME = re.compile(r"Grbl (\d\S*) \[.*\]")
_STATE = re.compile(r"([A-Z][a-z]+)(?::(\d))?")
_SETTING = re.compile(r"\$(\d{1,3})=(\d+\.?\d*)")
_NUMBERS = re.compile(r"-?\d+\.\d+(?:,-?\d+\.\d+){2,}")
_OTHER = re.compile(r"\[[^\[\]]*\]|>.*:(ok|error:\d+)|\$N\d=.*")


def parse_line(line: str) -> GrblMessage:
    if line == "ok":
        return Ok()
    for beginning, kind in (("error:", GrblError), ("ALARM:", Alarm)):
        if line.startswith(beginning) and line.removeprefix(beginning).isdecimal():
            return kind(int(line.removeprefix(beginning)))
    if match := _WELCOME.fullmatch(line):
        return Welcome(match[1])
    if match := _SETTING.fullmatch(line):
        return Setting(int(match[1]), float(match[2]))
    if line.startswith("<") and line.endswith(">"):
        return _parse_report(line[1:-1])
    if _OTHER.fullmatch(line):
        return OtherLine(line)
    raise ValueError(f"{line!r} is not a line of GRBL 1.1")


def _parse_report(inside: str) -> StatusReport:
    head, *rest = inside.split("|")
    state = _STATE.fullmatch(head)
    fields = dict(field.partition(":")[::2] for field in rest)
    if state is None or state[1] not in STATES or not rest or rest[0][:5] not in ("MPos:", "WPos:"):
        raise ValueError(f"'<{inside}>' is not a report of GRBL 1.1")
    return StatusReport(
        state[1],
        int(state[2]) if state[2] else None,
        _parse_axes(fields.get("MPos")),
        _parse_axes(fields.get("WPos")),
        _parse_axes(fields.get("WCO")),
        fields.get("Pn", ""),
    )


def _parse_axes(text: str | None) -> Axes | None:
    if text is None:
        return None
    if not _NUMBERS.fullmatch(text):
        raise ValueError(f"{text!r} is not a position")
    return tuple(float(number) for number in text.split(","))


def describe_error(code: int) -> str:
    return f"error:{code}, {ERRORS.get(code, 'which GRBL 1.1 does not document')}"


def describe_alarm(code: int) -> str:
    return f"ALARM:{code}, {ALARMS.get(code, 'which GRBL 1.1 does not document')}"
