"""`fpplab import`: import image files as a session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import MEASURE, FirstIndex, Force, FrameNames, ImageBits, Json, Out, PlanName, app
from fpplab.core.conventions import Lattice


@app.command("import", rich_help_panel=MEASURE)
def import_command(
    folder: Annotated[Path, typer.Argument(help="Folder of grey images, one per pattern of the plan.")],
    plan: PlanName,
    frames: FrameNames,
    out: Out,
    bits: ImageBits = 8,
    first: FirstIndex = 0,
    projector_size: Annotated[
        tuple[int, int] | None,
        typer.Option("--projector-size", help="Width and height of the projector, if the plan does not say."),
    ] = None,
    lattice: Annotated[
        Lattice, typer.Option("--lattice", help="How the projector's mirrors lie.")
    ] = Lattice.SQUARE,
    force: Force = False,
    json: Json = False,
) -> None:
    """Import image files that other programs recorded as a session.

    Every file is checked first: none missing, none left over, greyscale, of one size and of the bit depth
    given. A plan that does not seem to describe the images is told as a warning, with what to write instead;
    `fpplab plan guess` writes one from the images.

    Example: `fpplab import captures/pose1 --plan plan_slstudio_board --frames '{index:02d}.png' --out pose1`
    """
    from fpplab import pipeline
    from fpplab.patterns.plan import Plan
    from fpplab.sessions.importing import import_images

    warnings: list[str] = []
    with console.progress("Importing") as report:
        session = import_images(
            folder, Plan.load(plan), frames, out, bits, force, report,
            first=first, projector_size=projector_size, lattice=lattice, warn=warnings.append,
        )  # fmt: skip
        warnings += pipeline.doubts(session)
    for warning in warnings:
        console.say(f"warning: {warning}")
    console.answer({"frames": len(session.records), "session": str(session.path), "warnings": warnings}, json)
