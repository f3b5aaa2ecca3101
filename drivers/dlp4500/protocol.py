"""The commands of the DLPC350 that a projector needs: their numbers, and the layouts of their data.

Source: TI's DLPC350 client (API 4.0), GUI and SDK. Not yet tested on a board.
"""

from collections.abc import Mapping
from enum import IntEnum

from drivers.dlp4500.layout import Command, Layout, RawBytes, RegisterField, RegisterLayout


def _record(*fields: RegisterField) -> RegisterLayout:
    return RegisterLayout(fields)


def _fields(*names_and_bits: tuple[str, int]) -> RegisterLayout:
    return RegisterLayout(tuple(RegisterField(name, bits) for name, bits in names_and_bits))


def _gap(bits: int) -> RegisterField:
    return RegisterField("", bits)


def _flag(name: str) -> RegisterLayout:
    return _record(RegisterField(name, 1), _gap(7))


def _bytes(*names: str) -> RegisterLayout:
    return RegisterLayout(tuple(RegisterField(name, 8) for name in names))


_TABLE: dict[int, Command] = {}


def _declare(command: Command) -> Command:
    _TABLE[command.number] = command
    return command


def _register(name: str, number: int, record: Layout) -> Command:
    """Declare a command that is written and read back in the same layout."""
    return _declare(Command(name, number, record, record))


def _read_only(name: str, number: int, layout: Layout) -> Command:
    return _declare(Command(name, number, None, layout))


class DisplayMode(IntEnum):
    """Display modes."""

    VIDEO = 0
    PATTERN = 1


class Run(IntEnum):
    """States of the sequencer, and the commands to enter them."""

    STOP = 0
    PAUSE = 1
    START = 2


class Source(IntEnum):
    """Source of the patterns."""

    VIDEO = 0
    FLASH = 3


class TriggerMode(IntEnum):
    """What starts the next pattern of a sequence."""

    VSYNC = 0
    INTERNAL = 1
    ALTERNATING = 2
    INTERNAL_VARIABLE = 3
    VSYNC_VARIABLE = 4


class Mailbox(IntEnum):
    """Table that is open for writing."""

    CLOSED = 0
    IMAGES = 1
    PATTERNS = 2
    VARIABLE = 3


class PatternTrigger(IntEnum):
    """What starts one pattern of a sequence."""

    INTERNAL = 0
    RISING = 1
    FALLING = 2
    NONE = 3


MAX_ENTRIES, MAX_IMAGES = 128, 64
"""Largest tables of the modes with one exposure for all patterns, by TI's client."""
MAX_VARIABLE_ENTRIES, MAX_VARIABLE_IMAGES = 1824, 256
"""Largest tables of the modes with an exposure for each pattern, by TI's client."""

# --- status, identity, power

HARDWARE_STATUS = _read_only(
    "hardware status",
    0x1A0A,
    _fields(
        ("initialised", 1),
        ("", 1),
        ("reset_controller_error", 1),
        ("forced_swap_error", 1),
        ("", 2),
        ("sequencer_aborted", 1),
        ("sequencer_error", 1),
    ),
)
SYSTEM_STATUS = _read_only("system status", 0x1A0B, _flag("memory_test_passed"))
MAIN_STATUS = _read_only(
    "main status",
    0x1A0C,
    _fields(("parked", 1), ("running", 1), ("frozen", 1), ("gamma", 1), ("", 4)),
)
_VERSION_BITS = {"patch": 16, "minor": 8, "major": 8}
PARTS = ("application", "api", "software_config", "sequence_config")
"""Parts of the firmware that have a version."""
VERSION = _read_only(
    "version",
    0x0205,
    _fields(*((f"{part}_{n}", bits) for part in PARTS for n, bits in _VERSION_BITS.items())),
)
FIRMWARE_TAG = _read_only("firmware tag", 0x1AFF, RawBytes(1, 32))
IMAGES_IN_FLASH = _read_only("images in flash", 0x1A42, _bytes("count"))
POWER = _declare(
    Command(
        "power",
        0x0200,
        _record(RegisterField("standby", 8, range(2))),
        _record(RegisterField("standby", 2), _gap(6)),
    )
)
SOFTWARE_RESET = _declare(Command("software reset", 0x0802, RegisterLayout(), acknowledged=False))

# --- display mode and video input

DISPLAY_MODE = _register("display mode", 0x1A1B, _record(RegisterField("mode", 8, range(2))))
INPUT_SOURCE = _register(
    "input source",
    0x1A00,
    _record(RegisterField("source", 3, range(4)), RegisterField("width", 3, range(6)), _gap(2)),
)
PIXEL_FORMAT = _register("pixel format", 0x1A02, _record(RegisterField("format", 3, range(3)), _gap(5)))
PORT_CLOCK = _register("port clock", 0x1A03, _record(RegisterField("clock", 3, range(3)), _gap(5)))
CHANNEL_SWAP = _register(
    "channel swap", 0x1A37, _record(RegisterField("swap", 3, range(6)), _gap(4), RegisterField("port", 1))
)
LONG_AXIS_FLIP = _register("long-axis flip", 0x1008, _flag("on"))
SHORT_AXIS_FLIP = _register("short-axis flip", 0x1009, _flag("on"))
FREEZE = _register("freeze buffer", 0x100A, _flag("on"))
AREA = _register(
    "input and display area",
    0x1000,
    _fields(
        *((f"{part}_{n}", 16) for part in ("crop", "display") for n in ("pixel", "line", "pixels", "lines"))
    ),
)
TEST_PATTERNS = (
    "solid",
    "horizontal-ramp",
    "vertical-ramp",
    "horizontal-lines",
    "diagonal-lines",
    "vertical-lines",
    "grid",
    "checker",
    "rgb-ramp",
    "colour-bars",
    "step-bars",
)
"""Names of the test patterns, in the order of their numbers."""
TEST_PATTERN = _register(
    "test pattern", 0x1203, _record(RegisterField("pattern", 8, range(len(TEST_PATTERNS))))
)
TEST_PATTERN_COLOURS = _register(
    "test pattern colours",
    0x1204,
    RegisterLayout(
        tuple(
            RegisterField(f"{ground}_{colour}", 16, range(1024))
            for ground in ("front", "back")
            for colour in ("red", "green", "blue")
        )
    ),
)
IMAGE_LOAD_TIMING = _declare(
    Command("image load timing", 0x1A3A, _bytes("first", "count"), _record(RegisterField("ticks", 32)))
)
TICKS_PER_MS = 18667  # unit of the image load time, as TI's client converts it
VIDEO_SIGNAL = _read_only(
    "video signal",
    0x071C,
    _fields(
        *(("lock", 2), ("", 6), ("horizontal_resolution", 16), ("vertical_resolution", 16), ("", 8)),
        *(("horizontal_sync_polarity", 8), ("vertical_sync_polarity", 8), ("pixel_clock", 32)),
        *(("horizontal_frequency", 16), ("vertical_frequency", 16)),
        *(("total_pixels", 16), ("total_lines", 16), ("active_pixels", 16), ("active_lines", 16)),
        *(("first_pixel", 16), ("first_line", 16)),
    ),
)
LOCKED = 2  # value of `lock` in the video signal for a stable signal (TI's client)
GAMMA = _register("gamma", 0x1A0E, _record(RegisterField("table", 1), _gap(6), RegisterField("on", 1)))

# --- LEDs

COLOURS = ("red", "green", "blue")
LED_ENABLE = _register(
    "LED enable",
    0x1A07,
    _record(*(RegisterField(c, 1) for c in COLOURS), RegisterField("sequenced", 1), _gap(4)),
)
LED_CURRENT = _register("LED current", 0x0B01, _bytes(*COLOURS))
LED_POLARITY = _register("LED polarity", 0x1A05, _flag("inverted"))
LED_DELAYS = {
    colour: _register(f"{colour} LED delays", 0x1A1F + i, _bytes("rising", "falling"))
    for i, colour in enumerate(COLOURS)
}

# --- triggers

ZERO_DELAY_CODE, MAX_DELAY_CODE = 0xBB, 0xD5
"""Codes of a trigger delay of zero, and of the longest one that TI documents (2.787 µs)."""
DELAY_STEP_US = 0.1072  # step of a trigger delay in µs, by TI's client
TRIGGER_OUT_1 = _register(
    "trigger output 1",
    0x1A1D,
    _record(
        RegisterField("inverted", 8, range(2)),
        RegisterField("rising", 8, range(MAX_DELAY_CODE + 1)),
        RegisterField("falling", 8, range(MAX_DELAY_CODE + 1)),
    ),
)
TRIGGER_OUT_2 = _register(
    "trigger output 2",
    0x1A1E,
    _record(RegisterField("inverted", 8, range(2)), RegisterField("rising", 8, range(MAX_DELAY_CODE + 1))),
)
TRIGGER_IN_1 = _register("trigger input 1", 0x1A35, _record(RegisterField("delay", 32, range(1 << 19))))
TRIGGER_IN_2 = _register("trigger input 2", 0x1A36, _flag("inverted"))

# --- pattern sequence

PATTERN_SOURCE = _register("pattern source", 0x1A22, _record(RegisterField("source", 8, (0, 3))))
TRIGGER_MODE = _register("trigger mode", 0x1A23, _record(RegisterField("mode", 8, range(5))))
SEQUENCE = _register("sequence", 0x1A24, _record(RegisterField("run", 2, range(3)), _gap(6)))
EXPOSURE = _register(
    "exposure", 0x1A29, _record(RegisterField("exposure_us", 32), RegisterField("period_us", 32))
)
INVERT = _register("invert data", 0x1A30, _flag("on"))
PATTERN_CONFIG = _register(
    "pattern configuration",
    0x1A31,
    _record(
        RegisterField("entries", 8, range(1, MAX_ENTRIES + 1), offset=1),
        RegisterField("repeat", 8, range(2)),
        RegisterField("patterns", 8, range(1, 257), offset=1),
        RegisterField("images", 8, range(1, MAX_IMAGES + 1), offset=1),
    ),
)
VARIABLE_CONFIG = _register(
    "variable-exposure configuration",
    0x1A40,
    _record(
        RegisterField("entries", 16, range(1, MAX_VARIABLE_ENTRIES + 1), offset=1),
        RegisterField("patterns", 16, range(1, MAX_VARIABLE_ENTRIES + 1), offset=1),
        RegisterField("images", 8, range(1, MAX_VARIABLE_IMAGES + 1), offset=1),
        RegisterField("repeat", 8, range(2)),
    ),
)
MAILBOX_ADDRESS = _register(
    "mailbox address", 0x1A32, _record(RegisterField("address", 8, range(MAX_ENTRIES)))
)
MAILBOX = _register("mailbox", 0x1A33, _record(RegisterField("table", 8, range(4))))
MAILBOX_DATA = _register("mailbox data", 0x1A34, RawBytes(1, 3 * MAX_ENTRIES))
VARIABLE_ADDRESS = _register(
    "variable-exposure address", 0x1A3F, _record(RegisterField("address", 16, range(MAX_VARIABLE_ENTRIES)))
)

_ENTRY_BITS = (
    RegisterField("trigger", 2),
    RegisterField("pattern", 6),
    RegisterField("depth", 4),
    *(RegisterField(colour, 1) for colour in COLOURS),
    _gap(1),
    RegisterField("invert", 1),
    RegisterField("black_after", 1),
    RegisterField("swap", 1),
    RegisterField("share_trigger", 1),
    _gap(4),
)
ENTRY = RegisterLayout(_ENTRY_BITS)
"""One entry of the pattern table, 3 bytes.

Unlike the fields of a command, these take any value that their bits hold: wrong ones are reported by the
validation.
"""
VARIABLE_DATA = _register(
    "variable-exposure data",
    0x1A3E,
    _record(*_ENTRY_BITS, _gap(8), RegisterField("exposure_us", 32), RegisterField("period_us", 32)),
)
VALIDATION = _fields(
    ("exposure_invalid", 1),
    ("pattern_invalid", 1),
    ("trigger_overlap", 1),
    ("black_missing", 1),
    ("gap_too_short", 1),
    ("", 2),
    ("busy", 1),
)
VALIDATE = _declare(Command("validation", 0x1A1A, _record(_gap(8)), VALIDATION))

COMMANDS: Mapping[int, Command] = _TABLE  # all commands by number
