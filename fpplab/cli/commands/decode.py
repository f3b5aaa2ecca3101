"""`fpplab decode`: projector coordinates of a session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import MEASURE, AsRecorded, Force, Json, Out, app
from fpplab.core.errors import DataError


@app.command("decode", rich_help_panel=MEASURE)
def decode_command(
    session: Annotated[Path, typer.Argument(help="A recorded session.")],
    out: Out,
    as_recorded: AsRecorded = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Projector coordinates of every camera pixel, as NPZ.

    Arrays `u`, `v` (projector pixels), `modulation` (grey levels of 255) and `sigma` (projector
    pixels), float32, NaN where not measured. A plan that does not describe the frames is refused,
    with what to write instead.
    """
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.pipeline import decode_session
    from fpplab.sessions.session import Session

    need_suffix(out, ".npz")
    refuse_existing(out, force)
    with console.stopwatch() as seconds, console.progress("Decoding") as report:
        decoded = decode_session(Session.open(session), report, as_recorded=as_recorded)
        if not decoded.valid.any():
            raise DataError(
                f"{session}: no pixel could be measured; see that the fringes reach the object, "
                "and that they are neither faint nor saturated"
            )
        decoded.save(out)
    console.print_result({"valid": int(decoded.valid.sum()), "seconds": seconds()}, json)
