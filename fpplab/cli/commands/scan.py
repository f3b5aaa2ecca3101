"""`fpplab scan`: from a plan to points."""

from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import (
    MEASURE,
    CalibrationOption,
    DepthOption,
    Force,
    Json,
    LimitsOption,
    Out,
    PlanName,
    RigName,
    app,
)
from fpplab.cli.completion import option
from fpplab.cli.viewing import KeepOpen, ViewOption, observe_measurement


@app.command("scan", rich_help_panel=MEASURE)
def scan_command(
    context: typer.Context,
    rig: RigName,
    calibration: CalibrationOption,
    out: Out,
    plan: PlanName = "plan_scan.yaml",
    item: Annotated[str | None, option("--item", "Have the rig's fixture put this up first.")] = None,
    pose: Annotated[int, option("--pose", "In which of its poses.", min=0)] = 0,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    depth: DepthOption = None,
    limits: LimitsOption = None,
    dry_run: Annotated[
        bool, option("--dry-run", "Say where the stage would go, and move and project nothing.")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure: project the plan, and leave the session with its cloud in OUT.

    An interrupted scan is completed by the same command. OUT holds the frames, `decoded.npz`,
    `cloud.ply` and `report.html`. `verdict` says whether to believe the points, `findings` why not; useless
    points are not written, and the exit code is 4. `removed` says how many points the plan's filter took out,
    by rule.

    Example: `fpplab scan --rig rig_demo --calibration calibration.yaml --item pyramid --out pyramid`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.core.session_names import RECORDING
    from fpplab.devices.rig import Rig
    from fpplab.diagnosis import load_limits
    from fpplab.patterns.plan import Plan
    from fpplab.workflows.scan import ScanRequest, preview_scan, run_scan

    request = ScanRequest(
        rig=Rig.load(rig),
        plan=Plan.load(plan),
        calibration=Calibration.load(calibration),
        out=out,
        mount=(item, pose) if item else None,
        depth_mm=depth,
        force=force,
        limits=load_limits(limits) if limits else None,
        plan_name=plan,
        calibration_file=calibration,
    )
    if dry_run:
        console.print_result(preview_scan(request), json)
        return
    observer = observe_measurement(context, view, keep_open, out / RECORDING)
    result = run_scan(request, observer)
    result.require_usable()
    console.log_status(result.diagnosis.sentence)
    console.print_result(result.summary(), json)
