"""`fpplab compare`: how far a cloud is from the true shape."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import JUDGE, Force, Json, ReportOption, app
from fpplab.cli.completion import existing_data, option
from fpplab.cli.viewing import KeepOpen, MeasurementObserver, ViewOption, make_observer

if TYPE_CHECKING:
    from fpplab.results.comparison import ComparisonResult


@app.command("compare", rich_help_panel=JUDGE)
def compare_command(
    context: typer.Context,
    cloud: Annotated[
        Path, typer.Argument(help="Measured cloud: .ply, .xyz or .npz, or a session.", callback=existing_data)
    ],
    mesh: Annotated[Path, typer.Argument(help="True shape: .stl, .ply or .obj, in mm.")],
    align: Annotated[
        bool, option("--align", "Align the mesh with the cloud first, by a rigid motion.")
    ] = False,
    calibration: Annotated[
        Path | None,
        option(
            "--calibration",
            "Compare only surfaces visible to both devices of this calibration. Default: the "
            "calibration next to the cloud.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        option("--out", "Write a picture of the errors (.png) or the points coloured by error (.ply)."),
    ] = None,
    page: ReportOption = None,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure how far a cloud is from the true shape.

    SMCD, the symmetric mean closest-point distance, is a distance between point sets, reported with its
    floor: the value of a perfect measurement with the same sampling. The distances to the surface have no
    floor.

    With --align both hardly respond to errors of scale or shear. The scale of the cloud in ppm, with its
    standard uncertainty, is therefore reported with them, from the best-fit similarity transform; for meshes
    written by `fpplab artefact` also lengths such as step heights, measured and true. `warnings` says if
    these contradict the distances.

    The first line states the distance from the shape. If the distance is large only because the mesh is in
    another place (meshes of `fpplab artefact` stand on z = 0), the first line says so instead.

    Example: `fpplab compare pyramid/cloud.ply pyramid.stl --align --out errors.png`
    """
    from fpplab.workflows.compare import ComparisonRequest, run_comparison

    request = ComparisonRequest(cloud, mesh, align, calibration, out, page, force)
    written = page or out
    recording = written.with_suffix(".rrd") if written else None
    observer = make_observer(context, MeasurementObserver, view, keep_open, recording)
    result = run_comparison(request, observer)
    console.print_result(result.summary(), json, lambda: _show(result))


def _show(result: ComparisonResult) -> None:
    comparison = result.comparison
    console.stdout.print(result.misplaced or result.headline)
    shown_separately = ("lengths", "warnings", "scale")
    console.print_result(
        {name: value for name, value in comparison.summary().items() if name not in shown_separately}, False
    )
    if (scale := comparison.scale) is not None:
        console.stdout.print(f"scale {scale.ppm:+.1f} ± {scale.sigma_ppm:.1f} ppm")
    if comparison.lengths:
        heads = ["", "true mm", "measured mm", "error µm", "standard uncertainty µm"]
        console.table("Lengths", heads, [[m.name, *m.texts()] for m in comparison.lengths])
