"""The command line: one function per command, each a few lines over `measurement`.

Heavy modules are imported where they are used, so that `--help` is at once.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from fpplab import console
from fpplab.errors import Cancelled, ConfigError, DataError


class Commands(TyperGroup):
    """Turns Ctrl-C into the project's own word for it, with its exit code."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise Cancelled("cancelled") from None


app = typer.Typer(
    name="fpplab",
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="""Measure surfaces by fringe projection, on a bench or on its digital twin.

A **rig** file says which devices, a **plan** what to project, a **target** which board. The usual
order: `characterise` once, then `scan`, then `compare` with the true shape. `fpplab demo` does all
of it on the virtual bench and leaves a report to look at.

Exit codes: 0 done, 2 wrong input, 3 device, 4 data, 5 calibration, 130 cancelled.""",
)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, all else on stderr.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the output if it exists.")]
RigName = Annotated[str, typer.Option("--rig", help="Rig file, or the name of one that comes with fpplab.")]
PlanName = Annotated[str, typer.Option("--plan", help="Plan file: what to project and capture.")]
CalibrationFile = Annotated[Path, typer.Option("--calibration", help="Written by `fpplab characterise`.")]
Out = Annotated[Path, typer.Option("--out", help="Where the result goes.")]


@app.command()
def demo(
    out: Out = Path("fpplab-demo"),
    quick: Annotated[bool, typer.Option("--quick", help="684 x 456 pixels instead of 1368 x 912.")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure three artefacts on the virtual bench, from gamma to report.

    Shows the whole method: response, characterisation with a circle board, scans of a pyramid,
    pillars and steps, comparison with their true shapes. Open the report it names.

    Example: `fpplab demo --quick --out first-look`
    """
    from fpplab.demo import run_demo

    result = run_demo(out, quick, force)
    console.answer(result, json, lambda: _show_demo(result))


@app.command()
def devices(json: Json = False) -> None:
    """List the cameras, projectors and stages that this computer sees."""
    from fpplab.rig import load_backend

    found = [asdict(d) for d in load_backend("drivers.discovery:find", "fpplab", "devices")()]

    def words() -> None:
        if not found:
            console.say("No camera, projector or stage is connected; see their power and cables.")
            return
        console.table("Devices", ["kind", "model", "serial", "link"], [list(d.values()) for d in found])

    console.answer({"devices": found}, json, words)


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
    from fpplab.importing import import_images
    from fpplab.plan import Plan

    if bits not in (8, 10, 12, 16):
        raise ConfigError(f"--bits is {bits}: one of 8, 10, 12, 16")
    with console.progress("Importing") as report:
        session = import_images(folder, Plan.load(plan), frames, out, bits, force, report)
    console.answer({"frames": len(session.records), "session": str(session.path)}, json)


@app.command()
def gamma(
    rig: RigName,
    out: Out,
    exposure_s: Annotated[float, typer.Option("--exposure", help="Exposure in s.")] = 0.02,
    item: Annotated[str, typer.Option("--item", help="What to look at: an evenly white card.")] = "grey_card",
    force: Force = False,
    json: Json = False,
) -> None:
    """Fit the response `I_out = a I_in^g + b` of projector and camera together."""
    from fpplab.files import refuse_existing
    from fpplab.measurement import measure_response
    from fpplab.rig import Rig

    refuse_existing(out, force)
    with Rig.load(rig) as bench, console.progress("Response") as report:
        if bench.fixture:
            bench.fixture.mount(item)
        response, _ = measure_response(bench, exposure_s, progress=report)
    response.save(out)
    console.answer(response.summary(), json)


@app.command()
def characterise(
    target: Annotated[str, typer.Option("--target", help="Target file: the board that was shown.")],
    out: Out,
    sessions: Annotated[
        list[Path] | None, typer.Argument(help="Sessions, one per pose, or the folder that holds them.")
    ] = None,
    rig: Annotated[str | None, typer.Option("--rig", help="Take the poses now, on this rig.")] = None,
    plan: PlanName = "plan_board.yaml",
    poses: Annotated[int, typer.Option("--poses", min=3, help="How many poses to take with --rig.")] = 12,
    item: Annotated[str, typer.Option("--item", help="What the rig's fixture calls the board.")] = "board",
    force: Force = False,
    json: Json = False,
) -> None:
    """Find the models of camera and projector, and the pose between them.

    Either from recorded sessions, or with `--rig` by taking the poses now (their sessions stay in
    a folder beside the result). Ten poses or more, tilted up to 30 degrees, over the whole
    field and depth, make a good characterisation. Writes OUT and a report beside it.

    Examples: `fpplab characterise poses/ --target target_paper --out calibration.yaml`;
    `fpplab characterise --rig rig_demo --target target_paper --out calibration.yaml`
    """
    from fpplab.files import refuse_existing
    from fpplab.measurement import characterise_sessions, take_poses
    from fpplab.phase import check_unwrapping
    from fpplab.plan import Plan
    from fpplab.report import write_report
    from fpplab.rig import Rig
    from fpplab.session import recorded_sessions
    from fpplab.targets import Target

    if bool(sessions) == bool(rig):
        raise ConfigError("give either sessions or --rig, to say where the poses come from")
    page = out.with_suffix(".html")
    refuse_existing(out, force)
    refuse_existing(page, force)
    board = Target.load(target)
    if rig:
        folder, chosen = out.with_name(out.stem + "_poses"), Plan.load(plan)
        check_unwrapping(chosen, plan)
        if chosen.axes != ("x", "y"):
            raise ConfigError(
                f"{plan}: has fringes along {chosen.axes[0]} alone; characterisation needs x and y"
            )
        if folder.exists() and not force:
            console.say(f"{folder}: complete poses there are kept; --force takes all anew")
        with Rig.load(rig) as bench, console.progress("Taking poses") as report:
            recorded = take_poses(bench, chosen, item, poses, folder, force, report)
    else:
        recorded = recorded_sessions(sessions or [])
    with console.progress("Characterising") as report:
        result = characterise_sessions(recorded, board, report)
    for reason in result.left_out.values():
        console.say(f"left out: {reason}")
    result.calibration.save(out)
    write_report(page, f"Characterisation {out.stem}", characterisation=result)
    console.answer({**result.summary(), "left_out": result.left_out, "report": str(page)}, json)


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
    from fpplab.files import need_suffix, refuse_existing
    from fpplab.measurement import decode_session
    from fpplab.session import Session

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
def scan(
    rig: RigName,
    calibration: CalibrationFile,
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
    `cloud.ply` and `report.html`.

    Example: `fpplab scan --rig rig_demo --calibration calibration.yaml --item pyramid --out pyramid`
    """
    from fpplab.calibration import Calibration
    from fpplab.phase import check_unwrapping
    from fpplab.plan import Plan
    from fpplab.rig import Rig
    from fpplab.session import refuse_foreign

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
        from fpplab.acquisition import unseen
        from fpplab.live import Viewer
        from fpplab.measurement import CLOUD, REPORT, finish_scan, take
        from fpplab.report import write_scan_report

        # The report is written last: without it, all that is left may be to finish.
        finished = (out / REPORT).is_file()
        viewer = stack.enter_context(Viewer.open()) if view else None
        if viewer and viewer.fault is None:
            console.say(f"Watch it at {viewer.where}")
            viewer.plan(wanted, caps.size, caps.lattice)
            viewer.calibration(known)
        mount = (item, pose) if item else None
        observe = viewer.frame if viewer else unseen
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
        result = {"points": len(cloud.points), "images": wanted.images, "seconds": seconds()}
        if viewer and viewer.fault is None:
            viewer.decoded(decoded)
            viewer.cloud(cloud)
            console.say("Close the viewer, or press Ctrl-C, to end.")
            viewer.wait()
    console.answer({**result, "cloud": str(out / CLOUD), "report": str(out / REPORT)}, json)


@app.command()
def reconstruct(
    session: Annotated[Path, typer.Argument(help="A recorded session.")],
    calibration: CalibrationFile,
    out: Out,
    force: Force = False,
    json: Json = False,
) -> None:
    """The cloud of a recorded session: `.ply` (with normals and colour), `.xyz` or `.npz`.

    A report with its pictures is left beside it.
    """
    from fpplab import measurement
    from fpplab.calibration import Calibration
    from fpplab.clouds import CLOUD_SUFFIXES, save_cloud
    from fpplab.files import need_suffix, refuse_existing
    from fpplab.report import write_scan_report
    from fpplab.session import Session

    page = out.with_suffix(".html")
    need_suffix(out, *CLOUD_SUFFIXES)
    refuse_existing(out, force)
    refuse_existing(page, force)
    known = Calibration.load(calibration)
    recorded = Session.open(session)
    with console.stopwatch() as seconds, console.progress("Reconstructing") as report:
        decoded, cloud = measurement.reconstruct(recorded, known, report)
        save_cloud(cloud, out)
        write_scan_report(page, recorded, decoded, cloud)
    result = {"points": len(cloud.points), "seconds": seconds()}
    console.answer({**result, "cloud": str(out), "report": str(page)}, json)


@app.command()
def compare(
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
    from fpplab.calibration import Calibration
    from fpplab.clouds import load_cloud, load_mesh
    from fpplab.files import need_suffix, refuse_existing, write_atomic
    from fpplab.measurement import CALIBRATION
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


@app.command()
def artefact(
    name: Annotated[str, typer.Argument(help="pyramid, pillars or steps.")],
    out: Out,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write the true shape of an artefact as STL, in mm: to print it, and to compare with it.

    Example: `fpplab artefact pyramid --out pyramid.stl`
    """
    from fpplab import artefacts
    from fpplab.files import need_suffix, refuse_existing

    need_suffix(out, ".stl")
    refuse_existing(out, force)
    mesh = artefacts.make(name)
    artefacts.save_stl(mesh, out)
    console.answer({"size_mm": mesh.extents.tolist(), "faces": len(mesh.faces), "mesh": str(out)}, json)


@app.command()
def view(
    session: Annotated[Path, typer.Argument(help="A recorded session.")],
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Default: the one in the session.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Save as .rrd instead of showing.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show a session in the rerun viewer: images, phase, modulation, cloud and both devices in place.

    Without a display it is served to a browser on this computer, at the address that is printed.
    """
    from fpplab import live
    from fpplab.calibration import Calibration
    from fpplab.files import need_suffix, refuse_existing
    from fpplab.measurement import CALIBRATION
    from fpplab.session import Session

    if out:
        need_suffix(out, ".rrd")
        refuse_existing(out, force)
    beside = session / CALIBRATION
    source = calibration or (beside if beside.is_file() else None)
    known = Calibration.load(source) if source else None
    shown = live.view_session(
        Session.open(session), known, out, lambda where: console.say(f"Shown at {where}")
    )
    console.answer({"session": str(session), "shown": shown}, json)


@app.command()
def bench(
    name: Annotated[str | None, typer.Argument(help="One benchmark; all without a name.")] = None,
    json: Json = False,
) -> None:
    """Benchmarks, each figure beside its baseline in the same run; the ratio is what counts."""
    from fpplab.benchmarks import REGISTRY, benchmark

    results = []
    for one in [name] if name else list(REGISTRY):
        console.say(f"Running {one} …")
        results += [asdict(r) for r in benchmark(one)()]
    rows = [list(r.values()) for r in results]
    columns = ["name", "value", "unit", "baseline", "ratio"]
    console.answer({"results": results}, json, lambda: console.table("Benchmarks", columns, rows))


def _show_demo(result: dict[str, Any]) -> None:
    scans = [[s[k] for k in DEMO_COLUMNS] for s in result["scans"]]
    console.table("Scans", list(DEMO_COLUMNS.values()), scans)
    found = result["characterisation"]
    console.stdout.print(
        f"camera {found['camera']['rms_px']:.3f} px, projector {found['projector']['rms_px']:.3f} px, "
        f"mean surface SMCD {result['mean_surface_smcd_um']:.1f} µm, {result['seconds']:.0f} s"
    )
    console.stdout.print(f"report: {result['report']}")


DEMO_COLUMNS = {
    "artefact": "artefact",
    "images": "images",
    "points": "points",
    "surface_rms_um": "RMS µm",
    "surface_smcd_um": "surface SMCD µm",
    "smcd_um": "SMCD µm",
    "smcd_floor_um": "its floor µm",
    "completeness": "complete",
}


def main() -> None:
    """Entry point: run the command and leave with its exit code."""
    console.run(app, as_json="--json" in sys.argv)
