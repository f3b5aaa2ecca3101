"""`fpplab plan`: look at a plan before it is measured."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Commands, Force, Json, RigName, app
from fpplab.cli.completion import names_of

plan_app = typer.Typer(cls=Commands, help="Look at a plan before it is measured.", no_args_is_help=True)
app.add_typer(plan_app, name="plan", rich_help_panel=PREPARE)


@plan_app.callback()
def _plan() -> None:
    """Look at a plan before it is measured."""


@plan_app.command("show")
def show_command(
    plan: Annotated[
        str,
        typer.Argument(
            metavar="PLAN",
            help="Plan file, or the name of one that comes with fpplab.",
            autocompletion=names_of("plan"),
        ),
    ],
    rig: RigName,
    out: Annotated[Path | None, typer.Option("--out", help="Picture of all patterns, as PNG.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show what a plan takes on a rig: images, bit planes, times; refuse one that cannot work.

    Opens the rig, configures the camera and loads the patterns, and projects nothing. Times are least
    times, by what the devices say of themselves; loading patterns comes on top.

    Example: `fpplab plan show plan_paper --rig rig_demo --out patterns.png`
    """
    from fpplab.acquisition.preview import preview_plan
    from fpplab.core.files import need_suffix, refuse_existing, write_atomic
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan

    if out:
        need_suffix(out, ".png")
        refuse_existing(out, force)
    wanted = Plan.load(plan)
    with Rig.load(rig) as bench:
        found, patterns = preview_plan(bench, wanted, plan)
    if out:
        from fpplab.report.pattern_sheet import pattern_sheet

        drawn = pattern_sheet(patterns)
        write_atomic(out, lambda stream: stream.write(drawn))
    console.answer(asdict(found), json)
