"""`fpplab scan`: from a plan to points."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import MEASURE, CalibrationOption, DepthOption, Force, Json, Out, PlanName, RigName, app
from fpplab.cli.viewing import KeepOpen, ViewOption, open_viewer

if TYPE_CHECKING:
    from fpplab.clouds import Cloud
    from fpplab.diagnosis import Diagnosis
    from fpplab.phase import Decoded


@app.command("scan", rich_help_panel=MEASURE)
def scan_command(
    context: typer.Context,
    rig: RigName,
    calibration: CalibrationOption,
    out: Out,
    plan: PlanName = "plan_paper.yaml",
    item: Annotated[
        str | None, typer.Option("--item", help="Have the rig's fixture put this up first.")
    ] = None,
    pose: Annotated[int, typer.Option("--pose", min=0, help="In which of its poses.")] = 0,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    depth: DepthOption = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say where the stage would go, and move and project nothing.")
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
    from fpplab.core.files import refuse_existing
    from fpplab.core.session_names import REPORT
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.pipeline import check_plan, plan_with_depth
    from fpplab.sessions.session import Session, require_session_folder

    wanted, known = plan_with_depth(Plan.load(plan), depth), Calibration.load(calibration)
    bench = Rig.load(rig)
    check_plan(wanted, plan, known, bench, depth)
    require_session_folder(out)
    # The report is written last: without it, all that is left may be to finish.
    finished = (out / REPORT).is_file()
    if finished and not dry_run and not Session.open(out).missing():
        refuse_existing(out, force)
    with ExitStack() as stack, console.stopwatch() as seconds:
        stack.enter_context(bench)
        caps = bench.projector.caps
        wanted.check_projector(caps.size, plan)
        known.check_camera(bench.camera.caps.size, calibration)
        known.check_projector(caps.size, caps.lattice, calibration)
        if item:
            bench.need_fixture(f"--item {item}").check(item, pose)
        if dry_run:
            from fpplab.pipeline import plan_stage_moves

            console.print_result(plan_stage_moves(bench, wanted, out, force), json)
            return

        # Only now the heavy modules: wrong input is told at once. The viewer loads its own meanwhile.
        from fpplab.core.session_names import RECORDING
        from fpplab.viewer.measurement import MeasurementView, frame_observer

        viewer = open_viewer(context, MeasurementView, view, keep_open, out / RECORDING)
        viewer.show(MeasurementView.plan, wanted, caps.size, caps.lattice)
        viewer.show(MeasurementView.calibration, known)

        from fpplab.diagnosis import UselessScanError
        from fpplab.phase.precision import uncertain_orders
        from fpplab.pipeline import CLOUD, depth_range_of, finish_scan, take
        from fpplab.reconstruction.filtering import removal
        from fpplab.report import write_scan_report
        from fpplab.report.provenance import session_provenance
        from fpplab.sessions.lock import exclusive_write

        mount = (item, pose) if item else None
        with exclusive_write(out):
            with console.progress("Scanning") as report:
                session = take(
                    bench,
                    wanted,
                    out,
                    mount,
                    force=force,
                    complete_too=not finished,
                    progress=report,
                    observe_frame=frame_observer(viewer),
                )
            with console.progress("Reconstructing") as report:
                used, source = depth_range_of(session, depth), session_provenance(session, known, calibration)
                judged: list[tuple[Decoded, Cloud, Diagnosis]] = []

                def found(decoded: Decoded, cloud: Cloud, diagnosis: Diagnosis) -> None:
                    judged.append((decoded, cloud, diagnosis))
                    viewer.show(MeasurementView.results, decoded, cloud, used, None)

                try:
                    finish_scan(session, known, report, found)
                except UselessScanError as error:
                    results = judged[0][:2] if judged else (None, None)
                    write_scan_report(
                        *(out / REPORT, session, *results, used, error.diagnosis),
                        provenance=source,
                        calibration=known,
                        answer=error.diagnosis.summary(),
                    )
                    raise
            ((decoded, cloud, diagnosis),) = judged
            result = {
                **diagnosis.summary(),
                "points": len(cloud.points),
                "images": wanted.images,
                "removed": removal(decoded),
                "depth_range": asdict(used) if used else None,
                "warnings": list(decoded.outside.warnings()) if decoded.outside else [],
                "uncertain_orders": uncertain_orders(decoded, wanted),
                "seconds": seconds(),
            }
            with console.progress("Drawing the report"):
                write_scan_report(
                    *(out / REPORT, session, decoded, cloud, used, diagnosis),
                    provenance=source,
                    calibration=known,
                    answer=result,
                )
            session.check_kept()
    console.log_status(diagnosis.sentence)
    files = {"cloud": str(out / CLOUD), "report": str(out / REPORT)}
    console.print_result({**result, "provenance": source.summary(), **files}, json)
