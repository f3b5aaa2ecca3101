"""`fpplab camera …`: a Basler camera by itself. Its commands live with its driver."""

from __future__ import annotations

from importlib import import_module

import typer

from fpplab.cli.app import Commands, app

camera = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    help="The settings of a Basler camera, between the camera and a file.",
)
app.add_typer(camera, name="camera")

import_module("drivers.basler.commands")
