"""`fpplab dlp4500 status|power|led|test-pattern`: control of the projector by hand."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import Commands, Json
from fpplab.cli.completion import option
from fpplab.core.confirmation import ConfirmationRequired, confirm, how_to_confirm
from fpplab.core.errors import ConfigError, LimitError

if TYPE_CHECKING:
    from drivers.dlp4500.controller import Controller
    from drivers.dlp4500.transport import Link

dlp4500 = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_help_panel="system",
    help="Operate a LightCrafter 4500 projector directly.",
)
"""`fpplab dlp4500 …`."""

NAME = "projector"  # the projector's name in errors

ProjectorSerialOption = Annotated[
    str | None, option("--serial", "Serial number of the projector, if several are connected.")
]

EchoOption = Annotated[
    bool,
    option(
        "--echo/--no-echo",
        "Whether replies repeat the number and flags of their request; some boards do not.",
    ),
]

LedOption = Annotated[int, option("", "0 is off, 255 full.", min=0, max=255)]


class Power(StrEnum):
    """Actions of the command `power`."""

    ON = "on"
    OFF = "off"
    RESET = "reset"


def connect_projector(serial: str | None, checks_echo: bool = True) -> Link:
    from drivers.clock import RealClock
    from drivers.dlp4500.transport import Link, connect, load_hidapi

    return Link(connect(load_hidapi(NAME), NAME, serial)[0], RealClock(), NAME, checks_echo)


@contextmanager
def _opened_controller(serial: str | None, echo: bool) -> Iterator[Controller]:
    from drivers.clock import RealClock
    from drivers.dlp4500.controller import Controller

    with closing(connect_projector(serial, echo)) as link:
        link.drain()
        yield Controller(link, RealClock(), NAME)


@dlp4500.command()
def status(serial: ProjectorSerialOption = None, echo: EchoOption = True, json: Json = False) -> None:
    """Show the state of the projector and its faults.

    Example: `fpplab dlp4500 status`
    """
    with _opened_controller(serial, echo) as board:
        status_now = board.status()
        result = {
            "firmware": board.version(),
            "tag": board.firmware_tag(),
            "standby": board.is_standby(),
            "images": board.images_in_flash() if not board.is_standby() else None,
            "state": status_now.descriptions,
            "faults": status_now.faults,
        }
    console.print_result(result, json)


@dlp4500.command()
def power(
    state: Annotated[Power, typer.Argument(help="Wake the projector, put it in standby, or restart it.")],
    serial: ProjectorSerialOption = None,
    echo: EchoOption = True,
    json: Json = False,
) -> None:
    """Wake the projector, put it in standby, or restart it; its light is off afterwards.

    Example: `fpplab dlp4500 power off`
    """
    with _opened_controller(serial, echo) as board:
        if state is Power.ON:
            board.wake()
            board.go_dark()
        elif state is Power.OFF:
            board.enter_standby()
        else:
            board.reset()
    console.print_result({"power": state.value}, json)


@dlp4500.command()
def led(
    red: LedOption = 0,
    green: LedOption = 0,
    blue: LedOption = 0,
    inverted: Annotated[
        bool, option("--inverted/--not-inverted", "Whether the board treats level 255 as off.")
    ] = True,
    rig: Annotated[
        str | None,
        option("--rig", "Rig file whose projector states `led_limits`, which replace the default limits."),
    ] = None,
    dry_run: Annotated[
        bool, option("--dry-run", "Report whether a limit is exceeded, without switching anything on.")
    ] = False,
    serial: ProjectorSerialOption = None,
    echo: EchoOption = True,
    json: Json = False,
) -> None:
    """Switch the LEDs on manually; LEDs that are not given are switched off.

    Levels above the limits, those of the rig file or else the evaluation module's own (red 104, green 135,
    blue 130), need consent: in the terminal, or with `--allow led-current`.

    Example: `fpplab dlp4500 led --green 100`
    """
    levels = {"red": red, "green": green, "blue": blue}
    limits = _led_limits(rig)
    above = [
        f"{name} {level} (limit {limits[name]})" for name, level in levels.items() if level > limits[name]
    ]
    if dry_run:
        console.print_result({**levels, "above_limits": above, "dry_run": True}, json)
        return
    operation = ConfirmationRequired.LED_CURRENT
    if above and not confirm(operation, f"LEDs above their limits: {', '.join(above)}."):
        remedy = how_to_confirm(operation)
        raise LimitError(NAME, "led", f"levels above the limits: {', '.join(above)}", remedy)
    with _opened_controller(serial, echo) as board:
        board.set_led_levels(levels, inverted)
        board.switch_on_leds([colour for colour, level in levels.items() if level])
    console.print_result(levels, json)


def _led_limits(rig: str | None) -> dict[str, int]:
    """The greatest levels by colour: of a rig file, or those that the evaluation module begins with."""
    from drivers.dlp4500.device import LedLevels
    from fpplab.core import config
    from fpplab.devices.rig import Rig

    if rig is None:
        return LedLevels().model_dump()
    stated = Rig.load(rig).file.projector.options.get("led_limits")
    return config.validate(stated or {}, LedLevels, f"{rig}: projector.led_limits").model_dump()


@dlp4500.command("test-pattern")
def show_test_pattern(
    name: Annotated[str, typer.Argument(help="solid, grid, checker and others, or off.")],
    serial: ProjectorSerialOption = None,
    echo: EchoOption = True,
    json: Json = False,
) -> None:
    """Show one of the projector's built-in test patterns in white, or none with `off`.

    Example: `fpplab dlp4500 test-pattern grid`
    """
    from drivers.dlp4500.protocol import TEST_PATTERNS

    if name != "off" and name not in TEST_PATTERNS:
        raise ConfigError(f"there is no test pattern '{name}'; there are {', '.join(TEST_PATTERNS)} and off")
    with _opened_controller(serial, echo) as board:
        if name == "off":
            board.go_dark()
        else:
            board.show_test_pattern(name)
    console.print_result({"test_pattern": name}, json)
