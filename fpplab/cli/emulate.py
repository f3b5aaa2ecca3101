"""Devices that are not there, for training and for trying things out."""

from __future__ import annotations

import sys
import threading
from contextlib import suppress
from typing import Annotated

import typer

from fpplab import console
from fpplab.cli.app import Json, app
from fpplab.errors import ConfigError

EMULATORS = {"stage": "drivers.emulators.grbl:served"}
"""By name, a function that serves one between `with` and its end, and says how to use it."""


@app.command()
def emulate(
    name: Annotated[str, typer.Argument(help=f"{', '.join(EMULATORS)}.")],
    json: Json = False,
) -> None:
    """Be a device at the far end of its wire, in real time, until Ctrl-C.

    `stage` is a GRBL 1.1 controller with a rail of 200 mm, on a serial port whose name is printed: for a rig
    file, and for any other program that speaks GRBL.

    Example: `fpplab emulate stage`
    """
    from fpplab.rig import load_backend

    if name not in EMULATORS:
        raise ConfigError(f"there is no emulator '{name}'; there are {', '.join(EMULATORS)}")
    with load_backend(EMULATORS[name], "fpplab", "emulate")() as use, suppress(KeyboardInterrupt):
        console.answer(use, json)
        sys.stdout.flush()  # whoever reads it waits for it
        console.say("Ctrl-C ends it.")
        threading.Event().wait()
