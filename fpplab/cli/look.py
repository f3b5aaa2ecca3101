"""What has been measured, and what it should have been."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import Force, Json, Out, app
from fpplab.core.errors import ConfigError


@app.command()
def compare(
    cloud: Annotated[Path, typer.Argument(help="Measured cloud: .ply, .xyz or .npz.")],
    mesh: Annotated[Path, typer.Argument(help="True shape: .stl, .ply or .obj, in mm.")],
    align: Annotated[
        bool, typer.Option("--align", help="Move the mesh onto the cloud first (rigidly).")
    ] = False,
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration", help="Count only what both devices see. Default: the one beside the cloud."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write a picture of the errors, as PNG.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """How far a cloud is from the true shape.

    SMCD is the paper's point-set distance, given with its floor: what a perfect measurement
    sampled alike would score. The surface figures have no floor.
    """
    from fpplab import comparison
    from fpplab.calibration.model import Calibration
    from fpplab.clouds import load_cloud, load_mesh
    from fpplab.core.files import need_suffix, refuse_existing, write_atomic
    from fpplab.pipeline import CALIBRATION
    from fpplab.report import figures

    if out:
        need_suffix(out, ".png")
        refuse_existing(out, force)
    beside = cloud.parent / CALIBRATION
    source = calibration or (beside if beside.is_file() else None)
    known = Calibration.load(source) if source else None
    measured = load_cloud(cloud)
    if known and measured.size:
        known.check_camera(measured.size, source or cloud)
    with console.progress("Comparing"):
        result = comparison.compare(measured, load_mesh(mesh), known, align=align)
    if out:
        picture = figures.error_map(measured, result.distances_mm, result.counted)
        write_atomic(out, lambda stream: stream.write(picture))
    console.answer(result.summary(), json)


@app.command()
def artefact(
    name: Annotated[str, typer.Argument(help="pyramid, pillars, steps or ball_bar.")],
    out: Out,
    layer: Annotated[
        float | None, typer.Option("--layer", help="As printed in layers of this height, in mm.")
    ] = None,
    bead: Annotated[
        float | None, typer.Option("--bead", help="Depth of the marks between layers on a wall, in mm.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write the true shape of an artefact as STL, in mm: to print it, and to compare with it.

    Print it as drawn, but compare the print with the sliced shape: in layers of 0.2 mm a slope is a staircase
    up to 0.1 mm off, and walls are marked, which would count as errors of the measurement.

    Example: `fpplab artefact pyramid --out pyramid.stl`, and once it is printed
    `fpplab artefact pyramid --layer 0.2 --bead 0.03 --out printed.stl`
    """
    from fpplab import artefacts
    from fpplab.core.files import need_suffix, refuse_existing

    need_suffix(out, ".stl")
    refuse_existing(out, force)
    if bead is not None and layer is None:
        raise ConfigError("--bead: marks lie between layers; give the height of a layer too, with --layer")
    mesh = artefacts.make(name)
    printed = {}
    if layer is not None:
        printed["layers"] = artefacts.layer_count(mesh.extents[2], layer)
        with console.progress("Slicing"):
            mesh = artefacts.sliced(mesh, layer, bead or 0.0)
    artefacts.save_stl(mesh, out)
    result = {"size_mm": mesh.extents.tolist(), "faces": len(mesh.faces), "mesh": str(out)}
    console.answer(result | printed, json)


@app.command()
def view(
    session: Annotated[Path, typer.Argument(help="A recorded session.")],
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Default: the one in the session.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Save as .rrd instead of showing.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show a session in the rerun viewer: images, phase, modulation, cloud and both devices in place.

    Without a display it is served to a browser on this computer, at the address that is printed.
    """
    from fpplab.calibration.model import Calibration
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.pipeline import CALIBRATION
    from fpplab.report import viewer
    from fpplab.sessions.session import Session

    if out:
        need_suffix(out, ".rrd")
        refuse_existing(out, force)
    beside = session / CALIBRATION
    source = calibration or (beside if beside.is_file() else None)
    known = Calibration.load(source) if source else None
    shown = viewer.view_session(
        Session.open(session), known, out, lambda where: console.say(f"Shown at {where}")
    )
    console.answer({"session": str(session), "shown": shown}, json)
