"""`fpplab reconstruct`: the cloud of a recorded session."""

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import (
    MEASURE,
    AsRecorded,
    CalibrationOption,
    DepthOption,
    DrawReport,
    Force,
    Json,
    LimitsOption,
    Out,
    YesNo,
    app,
)
from fpplab.cli.completion import existing_data, option
from fpplab.cli.viewing import (
    ConsoleObserver,
    KeepOpen,
    MeasurementObserver,
    ViewOption,
    make_observer,
)
from fpplab.core.errors import ConfigError


@app.command("reconstruct", rich_help_panel=MEASURE)
def reconstruct_command(
    context: typer.Context,
    session: Annotated[
        Path, typer.Argument(help="Recorded session, or decoded maps (.npz).", callback=existing_data)
    ],
    calibration: CalibrationOption,
    out: Out,
    filtering: Annotated[
        bool | None,
        option("--filter/--no-filter", "Remove points that lie on no surface. Default: the plan's setting."),
    ] = None,
    depth: DepthOption = None,
    known: Annotated[
        list[str] | None,
        option(
            "--known",
            "Known distance at a camera pixel, for plans with spatial unwrapping; may be repeated.",
            metavar="COLUMN,ROW,MM",
        ),
    ] = None,
    as_recorded: AsRecorded = False,
    limits: LimitsOption = None,
    report: DrawReport = YesNo.YES,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Compute the points of a recorded session.

    Writes `.ply` (with normals and colour), `.xyz` or `.npz`. A report with pictures is written next to it.
    `verdict` says whether the points can be trusted, `findings` why not; unusable points are not written, and
    the exit code is 4. `removed` says how many points each rule of the plan's filter removed.

    Maps from `fpplab import --phase` or `fpplab decode` are triangulated without filter and report; as there
    are no frames to check, their points are `doubtful` at best.
    """
    if session.is_file() and session.suffix.lower() == ".npz":
        _triangulate_maps(
            session, calibration, out, force, json, {"--depth": depth, "--known": known, "--limits": limits}
        )
        return
    from fpplab.calibration.model import Calibration
    from fpplab.sessions.session import Session

    opened, known_calibration = Session.open(session), Calibration.load(calibration)
    # What is wrong so far is refused before the heavy modules are loaded.
    from fpplab.diagnosis import load_limits
    from fpplab.pipeline.decoding import parse_known
    from fpplab.workflows.reconstruct import ReconstructionRequest, run_reconstruction

    request = ReconstructionRequest(
        session=opened,
        calibration=known_calibration,
        out=out,
        depth_mm=depth,
        known_mm=parse_known(known or ()),
        filtering=filtering,
        as_recorded=as_recorded,
        report=report is YesNo.YES,
        force=force,
        limits=load_limits(limits) if limits else None,
        calibration_file=calibration,
    )
    observer = make_observer(context, MeasurementObserver, view, keep_open, out.with_suffix(".rrd"))
    result = run_reconstruction(request, observer)
    result.require_usable()
    console.print_result(result.summary(), json)


def _triangulate_maps(
    maps: Path, calibration: Path, out: Path, force: bool, json: bool, unused: dict[str, object]
) -> None:
    from fpplab.calibration.model import Calibration
    from fpplab.workflows.maps import MapsRequest, run_triangulation

    for name, value in unused.items():
        if value is not None:
            raise ConfigError(f"{name} goes with a session; {maps} holds maps without frames")
    request = MapsRequest(maps, Calibration.load(calibration), out, force)
    result = run_triangulation(request, ConsoleObserver())
    console.log_status(result.diagnosis.sentence)
    console.print_result(result.summary(), json)
