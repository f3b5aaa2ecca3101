"""`fpplab import`: import image files as a session."""

from pathlib import Path
from typing import Annotated

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
    ProjectorLattice,
    ProjectorSize,
    SkippedImages,
    app,
)
from fpplab.cli.completion import config_option, option
from fpplab.core.errors import ConfigError


@app.command("import", rich_help_panel=MEASURE)
def import_command(
    out: Out,
    plan: Annotated[str | None, config_option("plan", "Plan file: what the images show.")] = None,
    places: ImagePlaces = None,
    frames: FrameNames = None,
    bits: ImageBits = None,
    bayer: Annotated[
        str | None,
        option(
            "--bayer", "Colours of the camera's filter, where images are raw frames: RGGB, GRBG, GBRG, BGGR."
        ),
    ] = None,
    first: FirstIndex = 0,
    first_step: FirstStep = None,
    skip: SkippedImages = None,
    projector_size: ProjectorSize = None,
    lattice: ProjectorLattice = None,
    phase: Annotated[
        Path | None, option("--phase", "Instead of images: a map along x that another program decoded.")
    ] = None,
    phase_y: Annotated[Path | None, option("--phase-y", "The map along y, with --phase or alone.")] = None,
    period: Annotated[
        float | None,
        option("--period", "Maps are absolute phases in rad, of fringes of this period in projector px."),
    ] = None,
    sigma: Annotated[
        float | None, option("--sigma", "Standard deviation of the maps in projector px, where it is known.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Import image files that other programs recorded as a session, or maps that they decoded.

    Every image is checked first: none missing, none left over, greyscale, of one size and depth. A plan that
    does not seem to describe the images gives a warning, with what to write instead; `fpplab plan guess`
    writes one from the images. Images that --skip names, such as white and black ones, are not used.

    With `--phase`, `--phase-y` or both, maps of one array each (NPY, NPZ, TIFF, MATLAB) become the maps that
    `fpplab reconstruct` takes. Their values are projector px, (0, 0) at the centre of the first one, or with
    `--period` unwrapped phases, 0 at the projector's left and upper edge. Pixels that are not finite, or
    exactly 0, are not measured.

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
    from fpplab import pipeline
    from fpplab.patterns.plan import Plan
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


def _import_maps(
    x: Path | None, y: Path | None, period: float | None, sigma: float | None,
    projector_size: tuple[int, int] | None, out: Path, force: bool, json: bool, unused: dict[str, object],
) -> None:  # fmt: skip
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.phase.phase_maps import PhaseMapSource, import_phase_maps

    for name, value in unused.items():
        if value:
            raise ConfigError(f"{name} goes with images, not with --phase")
    if projector_size is None:
        raise ConfigError("--projector-size: is missing; maps do not say it")
    need_suffix(out, ".npz")
    refuse_existing(out, force)
    with console.progress("Reading maps") as report:
        imported = import_phase_maps(PhaseMapSource(projector_size, x, y, period, sigma))
        imported.decoded.save(out)
        report(1.0)
    for note in imported.notes:
        console.log_status(f"warning: {note}")
    valid = int(imported.decoded.valid.sum())
    console.print_result({"valid": valid, "warnings": list(imported.notes), "maps": str(out)}, json)
