"""`fpplab compare`: how far a cloud is from the true shape."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import JUDGE, Force, Json, app


@app.command("compare", rich_help_panel=JUDGE)
def compare_command(
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
