"""`fpplab exposure`: which exposures suit a scene."""

from pathlib import Path
from typing import Annotated, Any

from fpplab.cli import console
from fpplab.cli.app import Force, Json, PlanName, RigName, app
from fpplab.cli.completion import option
from fpplab.core.files import check_new_file, write_text


@app.command("exposure", rich_help_panel="plan")
def exposure_command(
    rig: RigName,
    plan: PlanName = "plan_scan.yaml",
    seconds: Annotated[float, option("--seconds", "Maximum duration of the plan in s.", min=0.01)] = 30.0,
    calibration: Annotated[
        Path | None, option("--calibration", "Calibration file; the noise is then also given in µm.")
    ] = None,
    item: Annotated[str | None, option("--item", "Item to mount before measuring.")] = None,
    pose: Annotated[int, option("--pose", "Pose of the item.", min=0)] = 0,
    out: Annotated[Path | None, option("--out", "Plan file to write, with the chosen exposures.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Find the one to four exposures that measure most of the scene with the least noise in a given time.

    Projects white, black and two images of the finest fringes of the plan at several exposures.
    `completeness` is the fraction of the pixels lit by the projector that can be measured, `sigma_px` the
    noise of the coordinate along the first axis.

    Example: `fpplab exposure --rig rig_demo --plan plan_scan --seconds 20 --out plan_exposures.yaml`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.core.config import dump
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.setup.exposures import choose_exposures, measure_light, um_per_px

    if out:
        check_new_file(out, force, ".yaml", ".yml")
    loaded = Plan.load(plan)
    known = Calibration.load(calibration) if calibration else None
    with Rig.load(rig) as bench:
        if item:
            bench.need_fixture(f"--item {item}").mount(item, pose)
        light, limits, other_s = measure_light(bench, loaded, seconds)
        choice = choose_exposures(light, loaded, bench.projector.caps.size, limits, seconds, other_s)
    several = choice.exposures_s
    changed = {"exposure_s": several[len(several) // 2], "exposures_s": several if len(several) > 1 else None}
    if out:
        write_text(out, dump(loaded.model_copy(update=changed)))
    answer: dict[str, Any] = {
        "exposures_s": list(several),
        "seconds": choice.seconds,
        "completeness": choice.completeness,
        "sigma_px": choice.sigma_px,
        "sigma_um": choice.sigma_px * um_per_px(known, loaded) if known else None,
        "plan": str(out) if out else None,
    }
    console.print_result(answer, json)
