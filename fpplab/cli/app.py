"""The program, and the options that commands have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from fpplab.core.errors import Cancelled


class Commands(TyperGroup):
    """A group of commands that reports Ctrl-C as `Cancelled`, with its exit code."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was named.

        Parameters
        ----------
        ctx : click.Context
            Of the command line.

        Returns
        -------
        object
            What the command returns.

        Raises
        ------
        Cancelled
            The user pressed Ctrl-C.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise Cancelled("cancelled") from None


app = typer.Typer(
    name="fpplab",
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="""Measure surfaces by fringe projection, on a bench or on its digital twin.

A **rig** file says which devices, a **plan** what to project, a **target** which board. The usual
order: `characterise` once, then `scan`, then `compare` with the true shape. `fpplab demo` does all
of it on the virtual bench and leaves a report to look at.

Exit codes: 0 done, 2 wrong input, 3 device, 4 data, 5 calibration, 130 cancelled.""",
)

START, PREPARE, MEASURE = "Start here", "Prepare a rig", "Measure"
JUDGE, TWIN, INSTRUMENTS = "Compare with the true shape", "Use the digital twin", "Instruments"
PANELS = (START, PREPARE, MEASURE, JUDGE, TWIN, INSTRUMENTS)
"""Headings of `fpplab --help`, in its order; a command names its own."""


def sort_commands() -> None:
    """Put the commands in the order of their headings, and of their names under each."""
    app.registered_commands.sort(
        key=lambda command: (PANELS.index(str(command.rich_help_panel)), command.name or "")
    )


Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, all else on stderr.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the output if it exists.")]
AsRecorded = Annotated[
    bool,
    typer.Option(
        "--as-recorded", help="Take the frames as they are where they seem out of step with the plan."
    ),
]
RigName = Annotated[str, typer.Option("--rig", help="Rig file, or the name of one that comes with fpplab.")]
PlanName = Annotated[str, typer.Option("--plan", help="Plan file: what to project and capture.")]
CalibrationOption = Annotated[Path, typer.Option("--calibration", help="Written by `fpplab characterise`.")]
DepthOption = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--depth",
        metavar="NEAR FAR",
        help="Distances from the camera in mm between which the object lies; by default "
        "`depth_mm` of the plan, or else of the rig file.",
    ),
]
Out = Annotated[Path, typer.Option("--out", help="Where the result goes.")]
