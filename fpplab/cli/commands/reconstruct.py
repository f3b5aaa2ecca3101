"""`fpplab reconstruct`: the cloud of a recorded session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import (
    MEASURE,
    AsRecorded,
    CalibrationOption,
    DepthOption,
    Force,
    Json,
    LimitsOption,
    Out,
    app,
)
from fpplab.cli.viewing import KeepOpen, ViewOption, observe_measurement


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
    limits: LimitsOption = None,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """The cloud of a recorded session: `.ply` (with normals and colour), `.xyz` or `.npz`.

    A report with its pictures is written next to it. `verdict` says whether to believe the points,
    `findings` why not; useless points are not written, and the exit code is 4. `removed` says how many points
    the plan's filter took out, by rule.
    """
    from fpplab.calibration.model import Calibration
    from fpplab.diagnosis import load_limits
    from fpplab.sessions.session import Session
    from fpplab.workflows.reconstruct import ReconstructionRequest, run_reconstruction

    request = ReconstructionRequest(
        session=Session.open(session),
        calibration=Calibration.load(calibration),
        out=out,
        depth_mm=depth,
        filtering=filtering,
        as_recorded=as_recorded,
        force=force,
        limits=load_limits(limits) if limits else None,
        calibration_file=calibration,
    )
    observer = observe_measurement(context, view, keep_open, out.with_suffix(".rrd"))
    result = run_reconstruction(request, observer)
    result.require_usable()
    console.log_status(result.diagnosis.sentence)
    console.print_result(result.summary(), json)
