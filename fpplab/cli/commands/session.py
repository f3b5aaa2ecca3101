"""`fpplab session info|verify|repair`: what a session is, whether it is whole, and what can be kept of it."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import Commands, Json, app
from fpplab.cli.completion import existing_data
from fpplab.core.errors import DataError
from fpplab.core.units import readable_bytes

SessionPath = Annotated[
    Path, typer.Argument(metavar="SESSION", help="Session folder.", callback=existing_data)
]

session_app = typer.Typer(cls=Commands, help="Describe, verify or repair a session.", no_args_is_help=True)
app.add_typer(session_app, name="session", rich_help_panel="data")


@session_app.command("info")
def info_command(session: SessionPath, json: Json = False) -> None:
    """Describe a session: format, plan, frames, rig, devices, times and results. Reads no frames.

    Example: `fpplab session info pyramid`
    """
    from fpplab.sessions.inspection import describe_session
    from fpplab.sessions.session import Session

    description = describe_session(Session.open(session))
    console.print_result(description, json, lambda: _show(description))


def _show(description: dict[str, Any]) -> None:

    origin = description["origin"] or {}
    size = description["size"]
    devices = origin.get("devices") or {}
    rows = {
        "format": description["format"],
        "frames": f"{description['frames']} of {description['images']}",
        "size": f"{size[0]} x {size[1]} px, {description['bits']} bits" if size else "",
        "rig": "imported images" if description["imported"] else description["rig"],
        "taken": " to ".join(description["taken"]) if description["taken"] else "not recorded",
        "by": f"fpplab {origin['version']} on {origin['host']}" if origin else "not recorded",
        **{name: f"{device['model']} {device['serial']}".strip() for name, device in devices.items()},
        "results": ", ".join(description["results"]) or "none",
        "on disk": readable_bytes(description["bytes"]),
    }
    console.table(description["session"], ["", ""], [[name, value] for name, value in rows.items()])


@session_app.command("verify")
def verify_session_command(session: SessionPath, json: Json = False) -> None:
    """Read every file of a session, compare all checksums, and list everything that is wrong.

    Frames that have not been recorded yet are not an error. The exit code is 4 if anything is damaged or
    missing; `fpplab session repair` keeps what is intact.

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
            console.stdout.print(fault.message)
        summary = f"{len(faults)} faults; `fpplab session repair {session}` keeps what is whole"
        console.stdout.print(summary if faults else f"{session}: is whole")

    console.print_result({"session": str(session), **answer}, json, show)
    if faults:
        raise console.CommandExit(DataError.exit_code)


@session_app.command("repair")
def repair_command(session: SessionPath, json: Json = False) -> None:
    """Make a damaged session readable again: keep what is intact, and list what is lost.

    Nothing is deleted: damaged files are moved to SESSION.damaged, next to it. Plan and rig are restored
    from their copies in the session. The original scan command records lost frames again, which is only
    valid if the part has not moved since.

    Example: `fpplab session repair pyramid`
    """
    from fpplab.sessions.repair import repair_session

    with console.progress("Repairing") as report:
        repair = repair_session(session, report)

    def show() -> None:
        say = console.stdout.print
        for name in repair.restored:
            say(f"restored: {name}")
        for loss in repair.lost:
            say(f"lost: {loss}")
        for place in repair.aside:
            say(f"set aside: {place}")
        say(f"{session}: {'is whole, nothing was changed' if repair.is_unchanged else 'is readable again'}, "
            f"{repair.kept} frames")  # fmt: skip

    console.print_result(
        {"session": str(session), "unchanged": repair.is_unchanged, **asdict(repair)}, json, show
    )
