"""`fpplab session repair`: what is whole of a damaged session is kept, what is lost is named."""

from __future__ import annotations

from dataclasses import asdict

from fpplab.cli import console
from fpplab.cli.app import Json
from fpplab.cli.commands.session.group import SessionPath, session_app


@session_app.command("repair")
def repair_command(session: SessionPath, json: Json = False) -> None:
    """Make a damaged session readable again: keep what is whole, and name what is lost.

    Nothing is deleted: damaged files go to SESSION.damaged, next to it. Plan and rig are restored from their
    copies in the session. Frames that are lost are missing then: the scan's own command takes them again,
    which is right only where the part has not moved since.

    Example: `fpplab session repair pyramid`
    """
    from fpplab.sessions.repair import repair_session

    with console.progress("Repairing") as report:
        repair = repair_session(session, report)

    def show() -> None:
        say = console.stdout.print
        for name in repair.restored:
            say(f"restored: {name}", markup=False)
        for loss in repair.lost:
            say(f"lost: {loss}", markup=False)
        for place in repair.aside:
            say(f"set aside: {place}", markup=False)
        say(f"{session}: {'is whole, nothing was changed' if repair.is_unchanged else 'is readable again'}, "
            f"{repair.kept} frames", markup=False)  # fmt: skip

    console.print_result(
        {"session": str(session), "unchanged": repair.is_unchanged, **asdict(repair)}, json, show
    )
