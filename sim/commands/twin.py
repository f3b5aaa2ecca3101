"""`fpplab twin extension|describe|record|export`: simulated rigs in Blender."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from fpplab.cli import console
from fpplab.cli.app import TWIN, Commands, Force, Json, Out, RigName
from fpplab.cli.completion import option
from fpplab.core.files import check_new_file, write_atomic
from fpplab.core.session_names import CLOUD

twin = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_help_panel=TWIN,
    help="Data sets, comparison with a bench, and Blender.",
)
"""`fpplab twin …`."""

ItemOption = Annotated[str | None, option("--item", "Item of the world. Default: the mounted item.")]
PoseOption = Annotated[int, option("--pose", "Pose of the item.", min=0)]
BaselineOption = Annotated[
    float | None,
    option(
        "--baseline",
        "Distance between projector and camera in mm, set by the stage. Default: the distance "
        "with the stage at 0.",
        min=0,
    ),
]
AxisOption = Annotated[Literal["x", "y"], option("--axis", "Projector axis along which the phase increases.")]
StripesOption = Annotated[
    float, option("--stripes", "Number of fringe periods across the projector image.", min=0.01)
]
StepsOption = Annotated[int, option("--steps", "Number of phase-shifted images.", min=3, max=1000)]
StepOption = Annotated[int, option("--step", "Index of the image shown.", min=0)]
ExposureOption = Annotated[float, option("--exposure", "Exposure of each frame in s.", min=1e-6, max=60)]


@twin.command("extension")
def write_archive(out: Out, force: Force = False, json: Json = False) -> None:
    """Write the Blender extension as an archive that Blender 4.5 and 5 install from disk.

    Example: `fpplab twin extension --out fpplab-blender.zip`
    """
    from sim.extension import archive_files, write_extension

    check_new_file(out, force, ".zip")
    write_atomic(out, write_extension)
    console.print_result({"extension": str(out), "files": len(archive_files())}, json)


@twin.command("describe")
def describe_rig(
    rig: RigName,
    out: Out,
    item: ItemOption = None,
    pose: PoseOption = 0,
    baseline: BaselineOption = None,
    axis: AxisOption = "x",
    stripes: StripesOption = 64.0,
    phase_steps: StepsOption = 12,
    shown_step: StepOption = 0,
    exposure: ExposureOption = 0.02,
    force: Force = False,
    json: Json = False,
) -> None:
    """Describe a simulated rig, an item and the fringes on it, for the Blender extension.

    Example: `fpplab twin describe --rig rig_demo --stripes 20 --out preview.npz`
    """
    from sim.preview import Arrangement, arrangement_summary, load_simulated_rig, save_preview

    check_new_file(out, force, ".npz")
    arrangement = Arrangement(item, pose, baseline, axis, stripes, phase_steps, exposure)
    with load_simulated_rig(rig) as bench:
        save_preview(bench, arrangement, shown_step, out)
        summary = arrangement_summary(bench, arrangement)
    console.print_result({"preview": str(out), **summary}, json)


@twin.command("export")
def export_blend(
    rig: RigName,
    out: Out,
    item: ItemOption = None,
    pose: PoseOption = 0,
    baseline: BaselineOption = None,
    axis: AxisOption = "x",
    stripes: StripesOption = 64.0,
    phase_steps: StepsOption = 12,
    shown_step: StepOption = 0,
    exposure: ExposureOption = 0.02,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a simulated rig as a .blend file: camera, projector with its fringes, and the item.

    Blender opens the file without fpplab and without the extension.

    Example: `fpplab twin export --rig matched/rig.yaml --item pyramid --out matched.blend`
    """
    from sim.preview import Arrangement, arrangement_summary, export_preview, load_simulated_rig, make_preview

    check_new_file(out, force, ".blend")
    arrangement = Arrangement(item, pose, baseline, axis, stripes, phase_steps, exposure)
    with load_simulated_rig(rig) as bench:
        with console.progress("Exporting"):
            export_preview(make_preview(bench, arrangement, shown_step), out)
        summary = arrangement_summary(bench, arrangement)
    console.print_result({"blend": str(out), **summary}, json)


@twin.command("record")
def record_on_twin(
    rig: RigName,
    out: Out,
    item: ItemOption = None,
    pose: PoseOption = 0,
    baseline: BaselineOption = None,
    axis: AxisOption = "x",
    stripes: StripesOption = 64.0,
    steps: StepsOption = 12,
    exposure: ExposureOption = 0.02,
    calibration: Annotated[
        Path | None,
        option("--calibration", "Calibration of the rig at this baseline. Default: the simulation's own."),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Scan an item of a simulated rig with these fringes, and with coarser ones to find the fringe orders.

    OUT contains the session as `fpplab scan` writes it, except for the report.

    Example: `fpplab twin record --rig rig_demo --item pyramid --baseline 165 --stripes 48 --out pyramid`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.sessions.session import require_session_folder
    from sim.preview import Arrangement, arrangement_summary, load_simulated_rig
    from sim.preview_scan import record_scan

    loaded = Calibration.load(calibration) if calibration else None
    require_session_folder(out)
    arrangement = Arrangement(item, pose, baseline, axis, stripes, steps, exposure)
    with load_simulated_rig(rig) as bench, console.stopwatch() as seconds:
        summary = arrangement_summary(bench, arrangement)
        with console.progress("Scanning") as report:
            scan = record_scan(bench, arrangement, out, calibration=loaded, force=force, progress=report)
    figures = scan.figures()
    results = {"points": figures["points"], "images": arrangement.plan().images, "seconds": seconds()}
    console.print_result({"session": str(out), "cloud": str(out / CLOUD), **results, **summary}, json)
