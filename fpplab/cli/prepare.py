"""What a bench needs before it measures."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fpplab.cli import console
from fpplab.cli.app import Force, Json, Out, PlanName, RigName, app
from fpplab.core.errors import ConfigError, DeviceError

if TYPE_CHECKING:
    from fpplab.acquisition.sync_check import Checked


class ModelName(StrEnum):
    """Levels of distortion that `characterise` can fit; `auto` chooses."""

    K1 = "k1"
    K2 = "k2"
    TANGENTIAL = "tangential"
    K3 = "k3"
    RATIONAL = "rational"
    AUTO = "auto"


@app.command()
def devices(json: Json = False) -> None:
    """List the cameras, projectors and stages that this computer sees, and what keeps others from showing."""
    from fpplab.devices.rig import load_backend

    found = load_backend("drivers.discovery:find", "fpplab", "devices")()
    rows = [asdict(d) for d in found.devices]

    def words() -> None:
        if rows:
            console.table("Devices", ["kind", "model", "serial", "link"], [list(d.values()) for d in rows])
        else:
            console.say("No camera, projector or stage is connected; see their power and cables.")
        for sentence in found.missing:
            console.say(f"missing: {sentence}")

    console.answer({"devices": rows, "missing": found.missing}, json, words)


@app.command()
def check(
    rig: RigName,
    plan: PlanName = "plan_paper.yaml",
    item: Annotated[str, typer.Option("--item", help="What to look at: an evenly white card.")] = "grey_card",
    out: Annotated[Path | None, typer.Option("--out", help="Picture of the levels seen, as PNG.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Open the rig, see that each frame shows its own pattern, and name what is wrong.

    Shows twelve uniform greys, stepped and, where camera and projector can, triggered, with the plan's
    exposure and settling time; says which settling time the display needs. The exit code is 0 when all is
    well, 3 with findings.

    Example: `fpplab check --rig rig_demo --plan plan_paper --out check.png`
    """
    from fpplab.acquisition import sync_check
    from fpplab.core.files import need_suffix, refuse_existing, write_atomic
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.report import figures

    if out:
        need_suffix(out, ".png")
        refuse_existing(out, force)
    wanted, bench = Plan.load(plan), Rig.load(rig)
    with console.progress("Checking") as report:
        found = sync_check.check_rig(bench, wanted, item, report)
    if out and found.runs:
        drawn = figures.marker_levels(found.shown, {run.how: run.levels for run in found.runs})
        write_atomic(out, lambda stream: stream.write(drawn))
    console.answer(found.summary(), json, lambda: _show_check(found))
    if found.findings:
        raise console.Answered(DeviceError.exit_code)


def _show_check(found: Checked) -> None:
    for run in found.runs:
        console.say(
            f"{run.how}: {len(run.levels)} greys, white brighter by {100 * run.rise:.2g} % of full scale"
        )
    for finding in found.findings:
        console.stdout.print(f"{finding.cause}: {finding.evidence}; {finding.remedy}", markup=False)
    if not found.findings:
        console.stdout.print("ok")


@app.command()
def gamma(
    rig: RigName,
    out: Out,
    plan: PlanName = "plan_paper.yaml",
    levels: Annotated[
        int | None,
        typer.Option("--levels", min=5, max=256, help="Grey levels to show; the plan's by default."),
    ] = None,
    repeats: Annotated[
        int | None, typer.Option("--repeats", min=1, max=1000, help="How often; the plan's by default.")
    ] = None,
    exposure_s: Annotated[
        float | None, typer.Option("--exposure", help="Exposure in s; the plan's by default.")
    ] = None,
    item: Annotated[str, typer.Option("--item", help="What to look at: an evenly white card.")] = "grey_card",
    force: Force = False,
    json: Json = False,
) -> None:
    """Fit the response `I_out = a I_in^g + b` of projector and camera together.

    Shows uniform greys, says whether the response is good enough for the plan, and leaves OUT and a picture
    beside it. The line `response: OUT` in a plan has its patterns corrected with it.

    Example: `fpplab gamma --rig rig_demo --plan plan_paper --levels 24 --repeats 4 --out response.yaml`
    """
    from fpplab.core.files import refuse_existing, write_atomic
    from fpplab.devices.rig import Rig
    from fpplab.patterns.phase_error import judge_response
    from fpplab.patterns.plan import GreyLevels, Plan
    from fpplab.pipeline import measure_response

    picture = out.with_suffix(".png")
    if picture == out:
        raise ConfigError(
            f"{out}: is the name of the picture; name the response something else, such as .yaml"
        )
    refuse_existing(out, force)
    refuse_existing(picture, force)
    wanted = Plan.load(plan)
    greys = GreyLevels(levels=levels or wanted.greys.levels, repeats=repeats or wanted.greys.repeats)
    with Rig.load(rig) as bench, console.progress("Response") as report:
        if bench.fixture:
            bench.fixture.mount(item)
        exposure = wanted.exposure_s if exposure_s is None else exposure_s
        response, _ = measure_response(bench, exposure, greys, report)
        judgement = judge_response(response, wanted, bench.projector.caps.size)

    from fpplab.report.figures import response_fit

    for reason in response.left_out:
        console.say(f"left out: {reason}")
    response.save(out)
    drawn = response_fit(response)
    write_atomic(picture, lambda stream: stream.write(drawn))
    result = {
        **response.summary(),
        "judgement": judgement.model_dump(mode="json"),
        "response": str(out),
        "picture": str(picture),
    }
    console.answer(result, json, lambda: _show_response(result))


def _show_response(result: dict[str, Any]) -> None:
    for name, sigma in zip("abg", result["sigma"], strict=True):
        console.stdout.print(f"{name} = {result[name]:.5f} ± {sigma:.2g}", markup=False)
    fitted, regions, spread = len(result["levels"]), len(result["regions"]), result["region_spread"]
    agree = f"; {regions} regions agree on g to {spread:.2g}" if spread is not None else ""
    console.stdout.print(f"RMS misfit {result['residual']:.2g} of full scale, {fitted} levels{agree}")
    console.stdout.print(result["judgement"]["sentence"], markup=False, soft_wrap=True)
    console.stdout.print(f"picture: {result['picture']}", markup=False)


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
    model: Annotated[
        ModelName,
        typer.Option(
            "--model",
            help="Distortion: k1; k2 (k1 k2); tangential (k1 k2 p1 p2); k3 (and k3); rational (and k4 k5 k6, "
            "for wide lenses); auto: the simplest that is as good as any in poses left out.",
        ),
    ] = ModelName.AUTO,
    refine_board: Annotated[
        bool | None,
        typer.Option(
            "--refine-board/--flat-board",
            help="Fit the board's shape too, held by the target's tolerance_mm or 0.1 mm; or take it as "
            "flat and exact. By default as the target file says.",
        ),
    ] = None,
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
    from fpplab.characterisation import DistortionModel
    from fpplab.core.files import refuse_existing
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.phase import check_unwrapping
    from fpplab.pipeline import characterise_sessions, take_poses
    from fpplab.report import write_report
    from fpplab.sessions.session import recorded_sessions
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
        level: DistortionModel | Literal["auto"] = (
            "auto" if model is ModelName.AUTO else DistortionModel(model)
        )
        result = characterise_sessions(recorded, board, report, level=level, refine_board=refine_board)
    for reason in result.left_out.values():
        console.say(f"left out: {reason}")
    for warning in result.warnings:
        console.say(f"warning: {warning}")
    result.calibration.save(out)
    write_report(page, f"Characterisation {out.stem}", facts=result.facts(), characterisation=result)
    console.answer({**result.summary(), "left_out": result.left_out, "report": str(page)}, json)
