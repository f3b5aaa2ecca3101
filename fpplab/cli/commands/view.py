"""`fpplab view`: a session in the rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import MEASURE, Force, Json, app


@app.command("view", rich_help_panel=MEASURE)
def view_command(
    session: Annotated[Path, typer.Argument(help="A recorded session.")],
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Default: the one in the session.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Save as .rrd instead of showing.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show a session in the rerun viewer: images, phase, modulation, cloud and both devices in place.

    Without a display it is served to a browser on this computer, at the address that is printed.
    """
    from fpplab.calibration.model import Calibration
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.pipeline import CALIBRATION
    from fpplab.report import viewer
    from fpplab.sessions.session import Session

    if out:
        need_suffix(out, ".rrd")
        refuse_existing(out, force)
    beside = session / CALIBRATION
    source = calibration or (beside if beside.is_file() else None)
    known = Calibration.load(source) if source else None
    shown = viewer.view_session(
        Session.open(session), known, out, lambda where: console.say(f"Shown at {where}")
    )
    console.answer({"session": str(session), "shown": shown}, json)
