"""`fpplab session verify`: whether a session is whole."""

from __future__ import annotations

from fpplab.cli import console
from fpplab.cli.app import Json
from fpplab.cli.commands.session.group import SessionPath, session_app
from fpplab.core.errors import DataError


@session_app.command("verify")
def verify_session_command(session: SessionPath, json: Json = False) -> None:
    """Read every file of a session, compare all checksums, and name everything that is wrong.

    Frames that have not been taken yet are no fault. The exit code is 4 where anything is damaged or gone;
    `fpplab session repair` keeps what is whole.

    Example: `fpplab session verify pyramid`
    """
    from fpplab.sessions.inspection import session_faults

    with console.progress("Reading") as report:
        faults = session_faults(session, report)
    answer = {
        "whole": not faults,
        "faults": [{"file": fault.file, "found": fault.message} for fault in faults],
    }

    def show() -> None:
        for fault in faults:
            console.stdout.print(fault.message, markup=False)
        summary = f"{len(faults)} faults; `fpplab session repair {session}` keeps what is whole"
        console.stdout.print(summary if faults else f"{session}: is whole", markup=False)

    console.print_result({"session": str(session), **answer}, json, show)
    if faults:
        raise console.CommandExit(DataError.exit_code)
