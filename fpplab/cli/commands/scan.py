"""`fpplab scan`: from a plan to points."""

from __future__ import annotations

import os
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from fpplab.cli import console
from fpplab.cli.app import (
    MEASURE,
    CalibrationOption,
    DepthOption,
    DrawReport,
    Force,
    Json,
    LimitsOption,
    Out,
    PlanName,
    RigName,
    YesNo,
    app,
)
from fpplab.cli.completion import option
from fpplab.cli.viewing import KeepOpen, MeasurementObserver, ViewOption, make_observer
from fpplab.core.errors import ConfigError
from fpplab.core.progress import no_progress
from fpplab.core.session_names import RECORDING

if TYPE_CHECKING:
    from fpplab.service.client import ServiceClient
    from fpplab.service.order import ScanOrder


@app.command("scan", rich_help_panel=MEASURE)
def scan_command(
    context: typer.Context,
    rig: RigName,
    calibration: CalibrationOption,
    out: Out,
    plan: PlanName = "plan_scan.yaml",
    item: Annotated[str | None, option("--item", "Item to mount before measuring.")] = None,
    pose: Annotated[int, option("--pose", "Pose of the item.", min=0)] = 0,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    depth: DepthOption = None,
    limits: LimitsOption = None,
    report: DrawReport = YesNo.YES,
    dry_run: Annotated[
        bool, option("--dry-run", "Report where the stage would move, without moving or projecting.")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure: project a plan; write frames, points and report.

    The same command completes an interrupted scan. If `fpplab serve` has the rig open, the scan is done by
    the service, with the same files and results. OUT contains the frames, `decoded.npz`, `cloud.ply` and
    `report.html`. `verdict` says whether the points can be trusted, `findings` why not; unusable points are
    not written, and the exit code is 4. `removed` says how many points each rule of the plan's filter
    removed.

    Example: `fpplab scan --rig rig_demo --calibration calibration.yaml --item pyramid --out pyramid`
    """
    from fpplab.core.confirmation import confirmed_in_advance
    from fpplab.service.order import ScanOrder

    order = ScanOrder(
        plan=plan,
        calibration=str(calibration),
        out=str(out),
        item=item,
        pose=pose,
        depth_mm=depth,
        limits=None if limits is None else str(limits),
        report=report is YesNo.YES,
        force=force,
        allow=tuple(confirmed_in_advance()),
    )
    if not dry_run and _scan_by_service(rig, order, view or keep_open, json):
        return
    _scan_here(context, rig, order, Watching(view, keep_open, dry_run), json)


class Watching(NamedTuple):
    """What is wanted besides the scan, or instead of it."""

    view: bool
    keep_open: bool
    dry_run: bool


def _scan_here(context: typer.Context, rig: str, order: ScanOrder, watching: Watching, json: bool) -> None:
    from fpplab.calibration.model import Calibration
    from fpplab.devices.rig import Rig
    from fpplab.workflows.scan import preview_scan, request_of_order, run_scan

    out = Path(str(order.out))
    calibration = Path(str(order.calibration))
    request = request_of_order(order, Rig.load(rig), out, calibration, Calibration.load)
    if watching.dry_run:
        console.print_result(preview_scan(request), json)
        return
    observer = make_observer(context, MeasurementObserver, watching.view, watching.keep_open, out / RECORDING)
    result = run_scan(request, observer)
    result.require_usable()
    console.print_result(result.summary(), json)


def _scan_by_service(rig: str, order: ScanOrder, is_viewed: bool, json: bool) -> bool:
    """Have the rig's service measure, if one runs; return whether it has."""
    from fpplab.core.config import find_config
    from fpplab.service.client import ServiceClient

    file = find_config(rig, "rig")
    client = ServiceClient.find(file)
    if client is None:
        return False
    if is_viewed:
        raise ConfigError(f"--view: a service at {client.url} holds {file}; end it, or leave --view out")
    console.log_status(f"Measured by the service at {client.url}")
    options = order.model_dump(mode="json", exclude_defaults=True) | {"rig": str(file), "folder": os.getcwd()}
    scan = client.order(options.pop("plan", order.plan), **options)
    status = _follow(client, scan)
    if status["error"] or status["state"] != "finished":
        raise client.fault_of(status)
    console.log_verdict(status["sentence"])
    console.print_result(status["result"], json)
    return True


def _follow(client: ServiceClient, scan: int) -> dict[str, Any]:
    """Show progress until a scan has ended; Ctrl-C cancels it."""
    status = client.show(scan)
    try:
        while not client.has_ended(status):
            stage = status["stage"]
            with console.progress(stage) if stage else nullcontext(no_progress) as report:
                while status["stage"] == stage and not client.has_ended(status):
                    report(status["progress"])
                    status = client.show(scan, after=status["version"], wait_s=client.MAX_WAIT_S)
    except KeyboardInterrupt:
        client.cancel(scan)
        client.show(scan, until="finished", wait_s=client.MAX_WAIT_S)
        raise
    return status
