"""The commands `fpplab session ...` as a group, and the argument that they share."""

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
