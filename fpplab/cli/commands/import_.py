"""`fpplab import`: import image files as a session."""

from pathlib import Path
from typing import Annotated

from fpplab.cli import console
from fpplab.cli.app import (
    FirstIndex,
    FirstStep,
    Force,
    FrameNames,
    ImageBits,
    ImagePlaces,
    Json,
    Out,
    ProjectorLattice,
    ProjectorSize,
    SkippedImages,
    app,
)
from fpplab.cli.completion import config_option, option
from fpplab.core.errors import ConfigError
from fpplab.core.files import check_new_file


@app.command("import", rich_help_panel="data")
def import_command(
    out: Out,
    plan: Annotated[str | None, config_option("plan", "Plan file that describes the images.")] = None,
    places: ImagePlaces = None,
    frames: FrameNames = None,
    bits: ImageBits = None,
    bayer: Annotated[
        str | None,
        option(
            "--bayer",
            "Colour filter of the camera, if the images are raw Bayer frames: RGGB, GRBG, GBRG, BGGR.",
        ),
    ] = None,
    first: FirstIndex = 0,
    first_step: FirstStep = None,
    skip: SkippedImages = None,
    projector_size: ProjectorSize = None,
    lattice: ProjectorLattice = None,
    phase: Annotated[
        Path | None,
        option("--phase", "Instead of images: a map of coordinates along x decoded by another program."),
    ] = None,
    phase_y: Annotated[
        Path | None, option("--phase-y", "The map along y, together with --phase or alone.")
    ] = None,
    period: Annotated[
        float | None,
        option("--period", "The maps are absolute phases in rad; fringe period in projector px."),
    ] = None,
    sigma: Annotated[
        float | None, option("--sigma", "Standard deviation of the maps in projector px, if known.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Import images recorded by other programs as a session, or maps that they decoded.

    All images are checked first: none missing, none left over, greyscale, of the same size and depth. If the
    plan does not seem to describe the images, a warning says how to correct it; `fpplab plan guess` writes a
    plan from the images. Images listed with --skip, such as white and black ones, are ignored.

    With `--phase`, `--phase-y` or both, maps with one array each (NPY, NPZ, TIFF, MATLAB) are converted to
    the maps that `fpplab reconstruct` takes. Their values are projector px, with (0, 0) at the centre of the
    first pixel, or with `--period` unwrapped phases, 0 at the left and upper edge of the projector image.
    Pixels that are not finite, or exactly 0, count as not measured.

    Examples: `fpplab import captures/pose1 --plan plan_slstudio_board --frames '{index:02d}.png' --out p`;
    `fpplab import stack.tif --plan plan_paper --projector-size 912 1140 --lattice diamond --out p`;
    `fpplab import --phase phi.npy --period 18 --projector-size 912 1140 --out maps.npz`
    """
    if phase is not None or phase_y is not None:
        unused: dict[str, object] = {
            "--plan": plan, "PLACES": places, "--frames": frames, "--bits": bits, "--skip": skip,
            "--bayer": bayer,
        }  # fmt: skip
        _import_maps(phase, phase_y, period, sigma, projector_size, out, force, json, unused)
        return
    for name, value in (("--period", period), ("--sigma", sigma)):
        if value is not None:
            raise ConfigError(f"{name} goes with --phase")
    if plan is None:
        raise ConfigError("--plan: is missing; name the plan that the images show")
    from fpplab.patterns.plan import Plan
    from fpplab.pipeline.decoding import doubts_about_session
    from fpplab.sessions.image_selection import ImageSelection, numbers_of
    from fpplab.sessions.importing import import_images

    source = ImageSelection(tuple(places or ()), frames, first, first_step, numbers_of(skip))
    warnings: list[str] = []
    with console.progress("Reading images") as report:
        session = import_images(
            source, Plan.load(plan), out, bits, force, report,
            projector_size=projector_size, lattice=lattice, bayer=bayer,
            warn=warnings.append, tell=console.log_status,
        )  # fmt: skip
        warnings += doubts_about_session(session)
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


def _import_maps(
    x: Path | None, y: Path | None, period: float | None, sigma: float | None,
    projector_size: tuple[int, int] | None, out: Path, force: bool, json: bool, unused: dict[str, object],
) -> None:  # fmt: skip
    from fpplab.phase.phase_maps import PhaseMapSource, import_phase_maps

    for name, value in unused.items():
        if value:
            raise ConfigError(f"{name} goes with images, not with --phase")
    if projector_size is None:
        raise ConfigError("--projector-size: is missing; maps do not say it")
    check_new_file(out, force, ".npz")
    with console.progress("Reading maps") as report:
        imported = import_phase_maps(PhaseMapSource(projector_size, x, y, period, sigma))
        imported.decoded.save(out)
        report(1.0)
    for note in imported.notes:
        console.log_status(f"warning: {note}")
    valid = int(imported.decoded.valid.sum())
    console.print_result({"valid": valid, "warnings": list(imported.notes), "maps": str(out)}, json)
