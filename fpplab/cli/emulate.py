"""Devices that are not there, for training and for trying things out."""

from __future__ import annotations

import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import Json, app
from fpplab.core.errors import ConfigError

EMULATORS = {
    "dlp4500": "drivers.emulators.dlpc350.training:served",
    "stage": "drivers.emulators.grbl:served",
}
"""By name, a function that serves one between `with` and its end, and says how to use it."""
FLASHED = "dlp4500"
"""The one that takes a firmware file."""


@app.command()
def emulate(
    name: Annotated[str, typer.Argument(help=f"{', '.join(EMULATORS)}.")],
    firmware: Annotated[
        Path | None, typer.Option("--firmware", help="For dlp4500: what is in its flash.")
    ] = None,
    json: Json = False,
) -> None:
    """Be a device at the far end of its wire, in real time, until Ctrl-C.

    `dlp4500` is a LightCrafter 4500 on this computer's USB, for `fpplab` and for any other program. It holds
    the patterns of plan_paper.yaml, or what a firmware file has, and says what it shows. It needs Linux, its
    module vhci-hcd, and the right to plug into it: sudo.

    `stage` is a GRBL 1.1 controller with a rail of 200 mm, on a serial port whose name is printed: for a rig
    file, and for any other program that speaks GRBL.

    Example: `fpplab emulate stage`
    """
    from fpplab.devices.rig import load_backend

    if name not in EMULATORS:
        raise ConfigError(f"there is no emulator '{name}'; there are {', '.join(EMULATORS)}")
    if firmware is not None and name != FLASHED:
        raise ConfigError(f"--firmware is for {FLASHED}: '{name}' has none")
    serve = load_backend(EMULATORS[name], "fpplab", "emulate")
    with serve(firmware) if firmware else serve() as use, suppress(KeyboardInterrupt):
        console.answer(use, json)
        sys.stdout.flush()  # whoever reads it waits for it
        console.say("Ctrl-C ends it.")
        threading.Event().wait()
