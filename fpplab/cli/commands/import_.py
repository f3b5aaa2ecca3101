"""`fpplab import`: import image files as a session."""

from __future__ import annotations

from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import (
    MEASURE,
    FirstIndex,
    FirstStep,
    Force,
    FrameNames,
    ImageBits,
    ImagePlaces,
    Json,
    Out,
    PlanName,
    SkippedImages,
    app,
)
from fpplab.core.lattice import Lattice


@app.command("import", rich_help_panel=MEASURE)
def import_command(
    plan: PlanName,
    out: Out,
    places: ImagePlaces = None,
    frames: FrameNames = None,
    bits: ImageBits = None,
    first: FirstIndex = 0,
    first_step: FirstStep = None,
    skip: SkippedImages = None,
    projector_size: Annotated[
        tuple[int, int] | None,
        typer.Option("--projector-size", help="Width and height of the projector, if the plan does not say."),
    ] = None,
    lattice: Annotated[
        Lattice | None,
        typer.Option("--lattice", help="How the projector's mirrors lie; a LightCrafter's lie in a diamond."),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Import image files that other programs recorded as a session.

    Every image is checked first: none missing, none left over, greyscale, of one size and depth. A plan that
    does not seem to describe the images gives a warning, with what to write instead; `fpplab plan guess`
    writes one from the images. Images that --skip names, such as white and black ones, are not used.

    Examples: `fpplab import captures/pose1 --plan plan_slstudio_board --frames '{index:02d}.png' --out p`;
    `fpplab import stack.tif --plan plan_paper --projector-size 912 1140 --lattice diamond --out p`
    """
    from fpplab import pipeline
    from fpplab.patterns.plan import Plan
    from fpplab.sessions.image_selection import ImageSelection, numbers_of
    from fpplab.sessions.importing import import_images

    source = ImageSelection(tuple(places or ()), frames, first, first_step, numbers_of(skip))
    warnings: list[str] = []
    with console.progress("Reading images") as report:
        session = import_images(
            source, Plan.load(plan), out, bits, force, report,
            projector_size=projector_size, lattice=lattice, warn=warnings.append, tell=console.log_status,
        )  # fmt: skip
        warnings += pipeline.doubts_about_session(session)
    for warning in warnings:
        console.log_status(f"warning: {warning}")
    size, shown_in = session.projector()
    console.print_result(
        {
            "frames": len(session.records),
            "bits": session.bits,
            "projector_size": list(size),
            "lattice": str(shown_in),
            "session": str(session.path),
            "warnings": warnings,
        },
        json,
    )
