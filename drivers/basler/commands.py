"""`fpplab camera save|load`: save the settings of a Basler camera to a file, and load them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import Commands, Force, Json
from fpplab.cli.completion import existing_file, option
from fpplab.core.errors import DeviceError, DisconnectedError
from fpplab.core.files import check_new_file

if TYPE_CHECKING:
    from drivers.basler.camera import CameraAsLeft

camera = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_help_panel="system",
    help="Save and load the settings of a Basler camera.",
)
"""`fpplab camera …`."""

NAME = "camera"

CameraSerialOption = Annotated[
    str | None, option("--serial", "Serial number of the camera, if several are connected.")
]
SettingsFile = Annotated[Path, typer.Argument(metavar="FILE", help="Settings file (.pfs).")]


@camera.command("save")
def save_settings(
    file: SettingsFile, serial: CameraSerialOption = None, force: Force = False, json: Json = False
) -> None:
    """Save the current settings of the camera to a .pfs file.

    A rig file that names this file as `features` of its camera loads it first whenever the rig is opened.

    Example: `fpplab camera save camera.pfs`
    """
    check_new_file(file, force, ".pfs")
    with _select_camera(serial) as device:
        device.save_features(file)
        info = device.info()
    console.print_result({"settings": str(file), "model": info.model, "serial": info.serial}, json)


@camera.command("load")
def load_settings(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Settings file (.pfs).", callback=existing_file)
    ],
    serial: CameraSerialOption = None,
    json: Json = False,
) -> None:
    """Load a .pfs file into a camera; the settings last until it is switched off.

    A file that does not fit the camera is refused; settings before the error may already have been applied.

    Example: `fpplab camera load camera.pfs`
    """
    with _select_camera(serial) as device:
        device.load_features(file)
        info = device.info()
    console.print_result({"settings": str(file), "model": info.model, "serial": info.serial}, json)


def _select_camera(serial: str | None) -> CameraAsLeft:
    """Return the camera of that serial number, or the only one, not open yet, or raise `DeviceError`."""
    from drivers.basler.camera import CameraAsLeft
    from drivers.basler.transport import Pylon

    if serial is None:
        serials = sorted(Pylon().cameras())
        if not serials:
            raise DisconnectedError(NAME, "open", "no camera is connected", "check its cable and power")
        if len(serials) > 1:
            named = f"name one of {', '.join(serials)} with --serial"
            raise DeviceError(NAME, "open", f"{len(serials)} cameras are connected", named)
        serial = serials[0]
    return CameraAsLeft(NAME, {"serial": serial})
