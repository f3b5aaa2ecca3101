"""`fpplab emulate`: device emulators, for training and tests."""

import sys
import threading
from contextlib import suppress
from inspect import signature
from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import Json, app
from fpplab.cli.completion import option
from fpplab.core import plugins
from fpplab.core.errors import ConfigError


@app.command("emulate", rich_help_panel="system")
def emulate_command(
    name: Annotated[str, typer.Argument(help=f"{', '.join(plugins.plugin_names(plugins.EMULATORS))}.")],
    firmware: Annotated[
        Path | None, option("--firmware", "For dlp4500: firmware file to place in its flash.")
    ] = None,
    json: Json = False,
) -> None:
    """Run a device emulator until Ctrl-C.

    `dlp4500` is a LightCrafter 4500 on the USB of this computer, for `fpplab` and any other program. It
    contains the patterns of plan_scan.yaml or those of a firmware file, and reports what it shows. It needs
    Linux, the kernel module vhci-hcd, and sudo to attach to it.

    `stage` is a GRBL 1.1 controller with a rail of 200 mm on a serial port whose name is printed, for a rig
    file or any other program that speaks GRBL.

    Example: `fpplab emulate stage`
    """
    serve = plugins.load_plugin(plugins.EMULATORS, name)
    if firmware is not None and "firmware" not in signature(serve).parameters:
        raise ConfigError(f"--firmware: the emulator '{name}' has no flash; leave it out")
    with serve(firmware) if firmware else serve() as use, suppress(KeyboardInterrupt):
        console.print_result(use, json)
        sys.stdout.flush()  # whoever reads it waits for it
        console.log_status("Ctrl-C ends it.")
        threading.Event().wait()
