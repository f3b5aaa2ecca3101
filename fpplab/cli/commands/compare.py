"""`fpplab compare`: how far a cloud is from the true shape."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import JUDGE, Force, Json, ReportOption, app
from fpplab.cli.viewing import KeepOpen, ViewOption, open_viewer
from fpplab.core.errors import DataError

if TYPE_CHECKING:
    import trimesh

    from fpplab.calibration.model import Calibration
    from fpplab.clouds import Cloud
    from fpplab.comparison import Comparison


@app.command("compare", rich_help_panel=JUDGE)
def compare_command(
    context: typer.Context,
    cloud: Annotated[Path, typer.Argument(help="Measured cloud: .ply, .xyz or .npz, or a session.")],
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
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Write a picture of the errors (.png), or the points coloured by them (.ply)."
        ),
    ] = None,
    page: ReportOption = None,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """How far a cloud is from the true shape.

    SMCD is the paper's point-set distance, given with its floor: what a perfect measurement
    sampled alike would score. The surface figures have no floor.

    With --align, both are nearly blind to an error of scale or shear. So the scale of the cloud, as that of
    the best-fit similarity in ppm with its standard uncertainty, is given beside them, and for meshes written
    by `fpplab artefact` lengths such as step heights, measured and true. `warnings` tells where these
    contradict the distances.

    The first line tells how far the cloud is from the shape. Where that is far only because the mesh stands
    elsewhere, such as one of `fpplab artefact`, which stands on z = 0, it says so instead.

    Example: `fpplab compare pyramid/cloud.ply pyramid.stl --align --out errors.png`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.clouds import load_cloud, load_mesh
    from fpplab.comparison import find_misplacement
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.diagnosis.record import load_diagnosis
    from fpplab.pipeline import CALIBRATION, CLOUD
    from fpplab.report.comparison_page import write_comparison_report
    from fpplab.results.provenance import cloud_provenance
    from fpplab.sessions.session import JOURNAL
    from fpplab.viewer.measurement import MeasurementView

    for path, suffixes in ((out, (".png", ".ply")), (page, (".html",))):
        if path:
            need_suffix(path, *suffixes)
            refuse_existing(path, force)
    cloud = cloud / CLOUD if cloud.is_dir() else cloud
    beside = cloud.parent / CALIBRATION
    source = calibration or (beside if beside.is_file() else None)
    known = Calibration.load(source) if source else None
    measured = load_cloud(cloud)
    if known and measured.size:
        known.check_camera(measured.size, source or cloud)
    written = page or out
    recording = written.with_suffix(".rrd") if written else None
    viewer = open_viewer(context, MeasurementView, view, keep_open, recording)
    with console.progress("Comparing"):
        truth = load_mesh(mesh)
        result = _aligned(measured, truth, known) if align else _as_placed(measured, truth, known, mesh)
        misplaced = None if align else find_misplacement(measured, truth)
    viewer.show(MeasurementView.results, None, measured, None, 1e3 * result.distances_mm)
    if out:
        _write_errors(out, measured, result)
    for warning in result.warnings():
        console.log_status(warning)
    summary = result.summary()
    if misplaced:
        summary["warnings"] = [misplaced.describe(), *result.warnings()]
    said = misplaced.describe() if misplaced else None
    whence = cloud_provenance(cloud, known).with_values(true_shape=str(mesh))
    if page:
        judged = load_diagnosis(cloud.parent) if (cloud.parent / JOURNAL).is_file() else None
        write_comparison_report(
            *(page, _name(cloud), measured, result, _headline(result)),
            misplaced=said,
            diagnosis=judged.diagnosis() if judged else None,
            provenance=whence,
            answer=summary,
        )
    files = {"provenance": whence.summary(), "report": str(page) if page else None}
    console.print_result({**summary, **files}, json, lambda: _show(result, said))


def _write_errors(out: Path, cloud: Cloud, result: Comparison) -> None:
    from fpplab.core.files import write_atomic
    from fpplab.report.error_cloud import write_error_cloud
    from fpplab.report.figures import error_map

    if out.suffix.lower() == ".ply":
        write_error_cloud(out, cloud, result.distances_mm, result.counted)
        return
    picture = error_map(cloud, result.distances_mm, result.counted)
    write_atomic(out, lambda stream: stream.write(picture))


def _name(cloud: Path) -> str:
    """What a page calls a cloud: its session, or its file."""
    from fpplab.pipeline import CLOUD

    return cloud.absolute().parent.name if cloud.name == CLOUD else cloud.stem


def _aligned(cloud: Cloud, mesh: trimesh.Trimesh, calibration: Calibration | None) -> Comparison:
    from fpplab.artefacts.recognition import recognise
    from fpplab.comparison import compare

    return compare(cloud, mesh, calibration, align=True, artefact=recognise(mesh))


def _as_placed(
    cloud: Cloud, mesh: trimesh.Trimesh, calibration: Calibration | None, source: Path
) -> Comparison:
    """Compare without an alignment; where nothing can be compared for want of one, say so: `DataError`."""
    from fpplab.comparison import UnseenMeshError, compare, find_misplacement

    try:
        return compare(cloud, mesh, calibration)
    except UnseenMeshError as error:
        misplaced = find_misplacement(cloud, mesh)
        if misplaced is None:
            raise
        raise DataError(f"{source}: {misplaced.describe()}") from error


def _headline(result: Comparison) -> str:
    """What matters, in one line."""
    mean_um, kind = result.surface_smcd_um, "surface SMCD"
    if mean_um is None:
        mean_um, kind = result.smcd_um, "SMCD"
    return (
        f"{mean_um:.1f} µm from the true shape ({kind}), {result.surface_rms_um:.1f} µm RMS, "
        f"{100 * result.completeness:.1f} % complete, {'aligned' if result.alignment else 'not aligned'}"
    )


def _show(result: Comparison, misplaced: str | None) -> None:
    """Print what matters, then the figures, and the lengths as a table."""
    console.stdout.print(misplaced or _headline(result), markup=False)
    apart = ("lengths", "warnings", "scale")
    console.print_result(
        {name: value for name, value in result.summary().items() if name not in apart}, False
    )
    if (scale := result.scale) is not None:
        console.stdout.print(f"scale {scale.ppm:+.1f} ± {scale.sigma_ppm:.1f} ppm", markup=False)
    if result.lengths:
        heads = ["", "true mm", "measured mm", "error µm", "standard uncertainty µm"]
        console.table("Lengths", heads, [[m.name, *m.texts()] for m in result.lengths])
