"""`fpplab plan`: look at a plan before it is measured, write one of fine fringes, or guess one."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import (
    PREPARE,
    CalibrationOption,
    Commands,
    FirstIndex,
    FirstStep,
    Force,
    FrameNames,
    ImageBits,
    ImagePlaces,
    Json,
    Out,
    RigName,
    SkippedImages,
    app,
)
from fpplab.cli.completion import existing_config, names_of, option
from fpplab.core.errors import DataError
from fpplab.core.files import check_new_file, write_atomic, write_text

plan_app = typer.Typer(
    cls=Commands,
    help="Inspect a plan, or write one from a goal or from images.",
    no_args_is_help=True,
)
app.add_typer(plan_app, name="plan", rich_help_panel=PREPARE)


@plan_app.command("show")
def show_command(
    plan: Annotated[
        str,
        typer.Argument(
            metavar="PLAN",
            help="Plan file, or the name of a plan supplied with fpplab.",
            autocompletion=names_of("plan"),
            callback=existing_config("plan"),
        ),
    ],
    rig: RigName,
    calibration: Annotated[
        Path | None,
        option("--calibration", "Calibration of the rig; the uncertainty of depth is then given as well."),
    ] = None,
    noise: Annotated[
        float,
        option(
            "--noise", "Standard deviation of a grey level, as a fraction of the modulation.", min=1e-6, max=1
        ),
    ] = 0.02,
    out: Annotated[Path | None, option("--out", "PNG file for a picture of all patterns.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show what a plan needs on a rig and what it gives: images, bit planes, times, uncertainties.

    Opens the rig, configures the camera and loads the patterns, but projects nothing. A plan that cannot
    work is refused. The times are minimum times according to the devices, without the time to load patterns.
    The uncertainties are due to noise alone, for a standard deviation of the grey levels of --noise times
    the modulation.

    Example: `fpplab plan show plan_paper --rig rig_demo --out patterns.png`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.setup.plan_preview import preview_plan

    if out:
        check_new_file(out, force, ".png")
    loaded_plan = Plan.load(plan)
    with Rig.load(rig) as bench:
        known = Calibration.load(calibration) if calibration else None
        preview, patterns = preview_plan(bench, loaded_plan, plan, noise, known)
    if out:
        from fpplab.report.figures import pattern_sheet

        drawn = pattern_sheet(patterns)
        write_atomic(out, lambda stream: stream.write(drawn))
    result = asdict(preview)
    console.print_result(result | result.pop("precision"), json)


@plan_app.command("fine")
def fine_command(
    calibration: CalibrationOption,
    depth: Annotated[
        tuple[float, float],
        option(
            "--depth",
            "Nearest and farthest distance of the object from the camera in mm.",
            metavar="NEAR FAR",
        ),
    ],
    out: Out,
    blur: Annotated[
        float | None,
        option(
            "--blur",
            "Blur of the projected fringes, as a standard deviation in projector px. Default: that of "
            "a sharp projector.",
            min=0,
            max=2.5,
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a plan of fine fringes only, for parts with faces that light each other.

    Light reflected by another face is nearly uniform over fine fringes, and disturbs their phase only where
    the faces meet. The fringe orders follow from the calibration and the depth range; the narrower the
    range, the more reliable they are.

    Example: `fpplab plan fine --calibration calibration.yaml --depth 425 475 --out fine.yaml`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.core.config import dump
    from fpplab.phase.fine_plan import fine_plan
    from fpplab.pipeline.depth import given_depth

    check_new_file(out, force, ".yaml", ".yml")
    given_depth(depth)
    plan = fine_plan(Calibration.load(calibration), depth, blur)
    write_text(out, f"# Fine fringes alone, for faces that light each other.\n{dump(plan)}")
    sets = [{"axis": s.axis, "stripes": s.stripes, "images": s.images} for s in plan.fringes]
    console.print_result({"fringes": sets, "images": plan.images, "plan": str(out)}, json)


@plan_app.command("guess")
def guess_command(
    projector_size: Annotated[
        tuple[int, int], option("--projector-size", "Width and height of the projector image in px.")
    ],
    out: Out,
    places: ImagePlaces = None,
    frames: FrameNames = None,
    bits: ImageBits = None,
    first: FirstIndex = 0,
    first_step: FirstStep = None,
    skip: SkippedImages = None,
    finest: Annotated[
        float | None, option("--finest", "Number of stripes of the finest set, if known.", min=1)
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write the plan that describes images of another program: sets, steps, axes, stripes, signs, bits.

    The images must be consecutive sets of phase-shifted sinusoids with equal steps, apart from those listed
    with --skip, or Gray code, also with inverses, white and black. Whatever the images do not show is
    assumed to be as usual and noted at the top of the plan.

    Example: `fpplab plan guess images --frames '{index:02d}.png' --projector-size 912 1140 --out p.yaml`
    """
    from fpplab.core.config import dump
    from fpplab.diagnosis.plan import guess_plan
    from fpplab.patterns.fringe_sets import FringeSet
    from fpplab.sessions.image_selection import ImageSelection, numbers_of
    from fpplab.sessions.importing import read_images

    check_new_file(out, force, ".yaml", ".yml")
    source = ImageSelection(tuple(places or ()), frames, first, first_step, numbers_of(skip))
    images, depth = read_images(
        source,
        bits,
        warn=lambda sentence: console.log_status(f"warning: {sentence}"),
        tell=console.log_status,
    )
    try:
        guess = guess_plan(images, depth, projector_size, finest)
    except DataError as error:
        raise DataError(f"{source.title}: {error}") from error
    head = "".join(f"# Assumed: {sentence}.\n" for sentence in guess.assumed)
    write_text(out, f"# Of the images in {Path(source.title).name}.\n{head}{dump(guess.plan)}")
    for sentence in guess.assumed:
        console.log_status(f"assumed: {sentence}")
    sets = [
        {"axis": each.coded_axis, "stripes": each.stripes, "images": each.images}
        if isinstance(each, FringeSet)
        else {"axis": each.coded_axis, "kind": each.model_dump()["kind"], "images": each.images}
        for each in guess.plan.sets
    ]
    console.print_result(
        {
            "fringes": sets,
            "disagreement": guess.disagreement,
            "assumed": list(guess.assumed),
            "plan": str(out),
        },
        json,
    )
