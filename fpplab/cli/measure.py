"""From a plan, or from loose images, to points."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import CalibrationOption, Force, Json, Out, PlanName, RigName, app
from fpplab.core.errors import ConfigError, DataError


@app.command("import")
def import_(
    folder: Annotated[Path, typer.Argument(help="Folder of grey images, one per pattern of the plan.")],
    plan: PlanName,
    frames: Annotated[
        str, typer.Option("--frames", help="Name of image {index}, from 0, such as 'f_{index:02d}.png'.")
    ],
    out: Out,
    bits: Annotated[int, typer.Option("--bits", help="Depth of the grey levels: 8, 10, 12 or 16.")] = 8,
    force: Force = False,
    json: Json = False,
) -> None:
    """Bring loose images from elsewhere into a session.

    Every file is checked first: all there, grey, of one size and of the depth promised.

    Example: `fpplab import captures/pose1 --plan plan_slstudio_board --frames '{index:02d}.png' --out pose1`
    """
    from fpplab.patterns.plan import Plan
    from fpplab.sessions.importing import import_images

    if bits not in (8, 10, 12, 16):
        raise ConfigError(f"--bits is {bits}: one of 8, 10, 12, 16")
    with console.progress("Importing") as report:
        session = import_images(folder, Plan.load(plan), frames, out, bits, force, report)
    console.answer({"frames": len(session.records), "session": str(session.path)}, json)


@app.command()
def scan(
    rig: RigName,
    calibration: CalibrationOption,
    out: Out,
    plan: PlanName = "plan_paper.yaml",
    item: Annotated[
        str | None, typer.Option("--item", help="Have the rig's fixture put this up first.")
    ] = None,
    pose: Annotated[int, typer.Option("--pose", min=0, help="In which of its poses.")] = 0,
    view: Annotated[bool, typer.Option("--view", help="Watch it live in the viewer.")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure: project the plan, and leave the session with its cloud in OUT.

    An interrupted scan is completed by the same command. OUT holds the frames, `decoded.npz`,
    `cloud.ply` and `report.html`. `removed` says how many points the plan's filter took out, by rule.

    Example: `fpplab scan --rig rig_demo --calibration calibration.yaml --item pyramid --out pyramid`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.phase import check_unwrapping
    from fpplab.sessions.session import refuse_foreign

    wanted, known = Plan.load(plan), Calibration.load(calibration)
    check_unwrapping(wanted, plan)
    refuse_foreign(out)
    with ExitStack() as stack, console.stopwatch() as seconds:
        bench = stack.enter_context(Rig.load(rig))
        caps = bench.projector.caps
        wanted.check_projector(caps.size, plan)
        known.check_camera(bench.camera.caps.size, calibration)
        known.check_projector(caps.size, caps.lattice, calibration)
        if item:
            bench.need_fixture(f"--item {item}").check(item, pose)

        # Only now the heavy modules: wrong input is told at once.
        from fpplab.core.progress import ignore
        from fpplab.pipeline import CLOUD, REPORT, finish_scan, take
        from fpplab.reconstruction.filtering import removal
        from fpplab.report import write_scan_report
        from fpplab.report.viewer import Viewer

        # The report is written last: without it, all that is left may be to finish.
        finished = (out / REPORT).is_file()
        viewer = stack.enter_context(Viewer.open()) if view else None
        if viewer and viewer.fault is None:
            console.say(f"Watch it at {viewer.where}")
            viewer.plan(wanted, caps.size, caps.lattice)
            viewer.calibration(known)
        mount = (item, pose) if item else None
        observe = viewer.frame if viewer else ignore
        with console.progress("Scanning") as report:
            session = take(
                bench,
                wanted,
                out,
                mount,
                force=force,
                complete_too=not finished,
                progress=report,
                observe_frame=observe,
            )
        with console.progress("Reconstructing") as report:
            decoded, cloud = finish_scan(session, known, report)
            write_scan_report(out / REPORT, session, decoded, cloud)
        result = {
            "points": len(cloud.points),
            "images": wanted.images,
            "removed": removal(decoded),
            "seconds": seconds(),
        }
        if viewer and viewer.fault is None:
            viewer.decoded(decoded)
            viewer.cloud(cloud)
            viewer.wait(lambda where: console.say(f"{where}: close it, or press Ctrl-C, to end."))
    console.answer({**result, "cloud": str(out / CLOUD), "report": str(out / REPORT)}, json)


@app.command()
def decode(
    session: Annotated[Path, typer.Argument(help="A recorded session.")],
    out: Out,
    force: Force = False,
    json: Json = False,
) -> None:
    """Projector coordinates of every camera pixel, as NPZ.

    Arrays `u`, `v` (projector pixels), `modulation` (grey levels of 255) and `sigma` (projector
    pixels), float32, NaN where not measured.
    """
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.pipeline import decode_session
    from fpplab.sessions.session import Session

    need_suffix(out, ".npz")
    refuse_existing(out, force)
    with console.stopwatch() as seconds, console.progress("Decoding") as report:
        decoded = decode_session(Session.open(session), report)
        if not decoded.valid.any():
            raise DataError(
                f"{session}: no pixel could be measured; see that the fringes reach the object, "
                "and that they are neither faint nor saturated"
            )
        decoded.save(out)
    console.answer({"valid": int(decoded.valid.sum()), "seconds": seconds()}, json)


@app.command()
def reconstruct(
    session: Annotated[Path, typer.Argument(help="A recorded session.")],
    calibration: CalibrationOption,
    out: Out,
    filtering: Annotated[
        bool | None,
        typer.Option("--filter/--no-filter", help="Remove points that lie on no surface; as the plan says."),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """The cloud of a recorded session: `.ply` (with normals and colour), `.xyz` or `.npz`.

    A report with its pictures is left beside it. `removed` says how many points the plan's filter took out,
    by rule.
    """
    from fpplab import pipeline
    from fpplab.calibration.model import Calibration
    from fpplab.clouds import CLOUD_SUFFIXES, save_cloud
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.reconstruction.filtering import removal
    from fpplab.report import write_scan_report
    from fpplab.sessions.session import Session

    page = out.with_suffix(".html")
    need_suffix(out, *CLOUD_SUFFIXES)
    refuse_existing(out, force)
    refuse_existing(page, force)
    known = Calibration.load(calibration)
    recorded = Session.open(session)
    with console.stopwatch() as seconds, console.progress("Reconstructing") as report:
        decoded, cloud = pipeline.reconstruct(recorded, known, report, filtering=filtering)
        save_cloud(cloud, out)
        write_scan_report(page, recorded, decoded, cloud)
    result = {"points": len(cloud.points), "removed": removal(decoded), "seconds": seconds()}
    console.answer({**result, "cloud": str(out), "report": str(page)}, json)
