"""The command group `fpplab dlp4500`, which the modules of commands extend, and what these share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli.app import INSTRUMENTS, Commands

if TYPE_CHECKING:
    from drivers.dlp4500.transport import Link

dlp4500 = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_help_panel=INSTRUMENTS,
    help="The projector LightCrafter 4500 by itself.",
)
"""`fpplab dlp4500 …`."""

NAME = "projector"  # the projector's name in errors

ProjectorSerialOption = Annotated[
    str | None, typer.Option("--serial", help="Serial number, where several projectors are connected.")
]

EchoOption = Annotated[
    bool,
    typer.Option(
        "--echo/--no-echo",
        help="Whether replies return number and flags of their request; not all boards may do so.",
    ),
]


def connect_projector(serial: str | None, checks_echo: bool = True) -> Link:
    from drivers.clock import RealClock
    from drivers.dlp4500.transport import Link, connect, load_hidapi

    return Link(connect(load_hidapi(NAME), NAME, serial)[0], RealClock(), NAME, checks_echo)
