"""`fpplab session info|verify|repair`: what a session is, whether it is whole, and what can be kept of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli.app import MEASURE, Commands, app

SessionPath = Annotated[Path, typer.Argument(metavar="SESSION", help="Folder of the session.")]

session_app = typer.Typer(
    cls=Commands, help="Tell what a session is, verify it, or repair it.", no_args_is_help=True
)
app.add_typer(session_app, name="session", rich_help_panel=MEASURE)


@session_app.callback()
def _session() -> None:
    """Tell what a session is, verify it, or repair it."""


from fpplab.cli.commands.session import info, repair, verify  # noqa: E402 - each adds its command

__all__ = ["info", "repair", "verify"]
