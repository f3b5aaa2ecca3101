"""`fpplab bug-report`: what somebody else needs to see what went wrong."""

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import Force, Json, Out, app
from fpplab.cli.completion import option
from fpplab.core.files import check_new_file


@app.command("bug-report", rich_help_panel="system")
def bug_report_command(
    out: Out,
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[SESSION | FILE...]", help="Sessions, log files, rig files and plans."),
    ] = None,
    frames: Annotated[bool, option("--frames", "Include the frames of the sessions.")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Collect versions, host, logs, rig, plan and verdict in one ZIP file for a bug report.

    Nothing is sent. Frames, clouds and maps are left out; --frames includes the frames. The contents are
    listed in the terminal and in `contents.txt`. They include names of folders, computers and devices: check
    them before sending the file. The log of a session includes device traffic if it was recorded with
    --trace.

    Example: `fpplab bug-report pyramid run.log --out report.zip`
    """
    from fpplab.sessions.bug_report import write_bug_report

    check_new_file(out, force, ".zip")
    entries = write_bug_report(out, sources or [], frames)
    rows = [[entry.name, entry.size, entry.what] for entry in entries]
    contents = [{"name": entry.name, "bytes": entry.size, "what": entry.what} for entry in entries]
    console.print_result(
        {"bug_report": str(out), "contents": contents},
        json,
        lambda: console.table(str(out), ["file", "bytes", "what it is"], rows),
    )
