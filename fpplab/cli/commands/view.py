"""`fpplab view`: a session, or a recording that `--view` left, in the rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import MEASURE, Force, Json, app
from fpplab.cli.completion import existing_data, option
from fpplab.core.errors import ConfigError
from fpplab.core.extras import need_extra
from fpplab.core.files import check_new_file
from fpplab.core.session_names import CALIBRATION, JOURNAL, RECORDING

if TYPE_CHECKING:
    from fpplab.viewer.recorded import CloudErrors


@app.command("view", rich_help_panel=MEASURE)
def view_command(
    session: Annotated[
        Path,
        typer.Argument(
            help="Session; or a recording made with `--view` (.rrd file or its folder).",
            callback=existing_data,
        ),
    ],
    calibration: Annotated[
        Path | None, option("--calibration", "Calibration file. Default: the one in the session.")
    ] = None,
    mesh: Annotated[
        Path | None, option("--mesh", "True shape; the cloud is then coloured by its distance from it.")
    ] = None,
    align: Annotated[
        bool, option("--align", "Align the cloud with the mesh first, as `compare` does.")
    ] = False,
    out: Annotated[Path | None, option("--out", "Save as an .rrd file instead of showing.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show a session in the rerun viewer.

    Shows images, phase, maps, the cloud by uncertainty, and the devices. Without a display it is served to a
    browser on this computer, at the address printed. It ends when its window or page is closed, or with
    Ctrl-C. A folder that is not a session is shown by its `view.rrd`.

    Example: `fpplab view pyramid --mesh pyramid.stl --align`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.sessions.session import Session
    from fpplab.viewer.recorded import view_recording, view_session

    def announce(where: str) -> None:
        console.log_status(f"Shown at {where}")

    need_extra("rerun")
    recording = session if session.suffix == ".rrd" else session / RECORDING
    if recording.is_file() and not (session / JOURNAL).is_file():
        if out or mesh or calibration:
            raise ConfigError(f"{recording}: is a recording, shown as it is; give a session instead")
        console.print_result(
            {"session": str(session), "shown": view_recording(recording, announce=announce)}, json
        )
        return
    if align and not mesh:
        raise ConfigError("--align needs --mesh, the true shape that the cloud is moved onto")
    if out:
        check_new_file(out, force, ".rrd")
    stored = session / CALIBRATION
    source = calibration or (stored if stored.is_file() else None)
    loaded = Calibration.load(source) if source else None
    opened = Session.open(session)
    errors = _errors(mesh, align) if mesh else None
    with console.progress("Reading the session") as report:
        shown = view_session(opened, loaded, out or "anywhere", announce, errors, report)
    console.print_result({"session": str(session), "shown": shown}, json)


def _errors(mesh: Path, align: bool) -> CloudErrors:
    from fpplab.clouds import load_mesh
    from fpplab.comparison import compare

    shape = load_mesh(mesh)
    return lambda cloud: 1e3 * compare(cloud, shape, align=align).distances_mm
