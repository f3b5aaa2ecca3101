"""`fpplab bug-report`: what somebody else needs to see what went wrong."""

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import START, Force, Json, Out, app
from fpplab.cli.completion import option


@app.command("bug-report", rich_help_panel=START)
def bug_report_command(
    out: Out,
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[SESSION | FILE...]", help="Sessions, log files, rig files, plans."),
    ] = None,
    frames: Annotated[bool, option("--frames", "Put the frames of the sessions in, too.")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Collect versions, host, logs, rig, plan and verdict in one ZIP file, to be sent to somebody.

    Nothing is sent anywhere. Frames, clouds and maps are left out: --frames puts the frames in. What is in it
    is listed on the terminal and in `contents.txt`; names of folders, computers and devices are among it, so
    look before you send it. A session's log has device traffic where the scan was made with --trace.

    Example: `fpplab bug-report pyramid run.log --out report.zip`
    """
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.sessions.bug_report import write_bug_report

    need_suffix(out, ".zip")
    refuse_existing(out, force)
    entries = write_bug_report(out, sources or [], frames)
    rows = [[entry.name, entry.size, entry.what] for entry in entries]
    contents = [{"name": entry.name, "bytes": entry.size, "what": entry.what} for entry in entries]
    console.print_result(
        {"bug_report": str(out), "contents": contents},
        json,
        lambda: console.table(str(out), ["file", "bytes", "what it is"], rows),
    )
