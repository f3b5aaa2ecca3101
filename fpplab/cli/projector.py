"""`fpplab dlp4500 …`: the LightCrafter 4500 by itself. Its commands live with its driver."""

from __future__ import annotations

from importlib import import_module

import typer

from fpplab.cli.app import Commands, app

dlp4500 = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    help="The projector LightCrafter 4500 by itself.",
)
app.add_typer(dlp4500, name="dlp4500")

import_module("drivers.dlp4500.commands")
import_module("drivers.dlp4500.bench_commands")
