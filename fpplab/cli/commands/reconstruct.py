"""`fpplab reconstruct`: the cloud of a recorded session."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import MEASURE, AsRecorded, CalibrationOption, DepthOption, Force, Json, Out, app
from fpplab.cli.viewing import KeepOpen, ViewOption, open_viewer


@app.command("reconstruct", rich_help_panel=MEASURE)
def reconstruct_command(
    context: typer.Context,
    session: Annotated[Path, typer.Argument(help="A recorded session.")],
    calibration: CalibrationOption,
    out: Out,
    filtering: Annotated[
        bool | None,
        typer.Option("--filter/--no-filter", help="Remove points that lie on no surface; as the plan says."),
    ] = None,
    depth: DepthOption = None,
    as_recorded: AsRecorded = False,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """The cloud of a recorded session: `.ply` (with normals and colour), `.xyz` or `.npz`.

    A report with its pictures is left beside it. `verdict` says whether to believe the points, `findings` why
    not; useless points are not written, and the exit code is 4. `removed` says how many points the plan's
    filter took out, by rule.
    """
    from fpplab import pipeline
    from fpplab.calibration.model import Calibration
    from fpplab.clouds import CLOUD_SUFFIXES, save_cloud
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.diagnosis import UselessScanError
    from fpplab.phase.precision import uncertain_orders
    from fpplab.reconstruction.filtering import removal
    from fpplab.report import is_report, write_scan_report
    from fpplab.report.provenance import session_provenance
    from fpplab.sessions.session import Session
    from fpplab.viewer.measurement import MeasurementView

    page = out.with_suffix(".html")
    need_suffix(out, *CLOUD_SUFFIXES)
    refuse_existing(out, force)
    refuse_existing(page, force or is_report(page))  # of a run that ended before its result
    known = Calibration.load(calibration)
    recorded = Session.open(session)
    used = pipeline.depth_range_of(recorded, depth)
    viewer = open_viewer(context, MeasurementView, view, keep_open, out.with_suffix(".rrd"))
    viewer.show(MeasurementView.plan, recorded.plan, *recorded.projector())
    viewer.show(MeasurementView.calibration, known)
    with console.stopwatch() as seconds, console.progress("Reconstructing") as report:
        source = session_provenance(recorded, known, calibration)
        try:
            decoded, cloud = pipeline.reconstruct(
                *(recorded, known, report),
                filtering=filtering,
                depth_mm=depth,
                as_recorded=as_recorded,
                maps_ready=lambda maps: viewer.show(MeasurementView.maps, maps),
            )
        except UselessScanError as error:
            found = error.diagnosis
            write_scan_report(
                *(page, recorded, None, None, used, found),
                provenance=source,
                calibration=known,
                answer=found.summary(),
            )
            raise
        viewer.show(MeasurementView.results, None, cloud, used, None)
        diagnosis = pipeline.diagnose(recorded, decoded, cloud, known)
        result = {
            **diagnosis.summary(),
            "points": len(cloud.points),
            "removed": removal(decoded),
            "depth_range": asdict(used) if used else None,
            "warnings": list(decoded.outside.warnings()) if decoded.outside else [],
            "uncertain_orders": uncertain_orders(decoded, recorded.plan),
            "seconds": seconds(),
        }
        write_scan_report(
            *(page, recorded, decoded, cloud, used, diagnosis),
            provenance=source,
            calibration=known,
            answer=result,
        )
        diagnosis.require_usable(str(session))
        save_cloud(cloud, out)
    console.log_status(diagnosis.sentence)
    files = {"cloud": str(out), "report": str(page)}
    console.print_result({**result, "provenance": source.summary(), **files}, json)
