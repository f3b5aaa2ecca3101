"""`fpplab characterise`: models of camera and projector, and the pose between them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Force, Json, Out, PlanName, app
from fpplab.core.errors import ConfigError

if TYPE_CHECKING:
    pass


class ModelName(StrEnum):
    """Levels of distortion that `characterise` can fit; `auto` chooses."""

    K1 = "k1"
    K2 = "k2"
    TANGENTIAL = "tangential"
    K3 = "k3"
    RATIONAL = "rational"
    AUTO = "auto"


@app.command("characterise", rich_help_panel=PREPARE)
def characterise_command(
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
            "for wide lenses); auto: k3, with the errors of all in poses left out.",
        ),
    ] = ModelName.AUTO,
    refine_board: Annotated[
        bool | None,
        typer.Option(
            "--refine-board/--flat-board",
            help="Fit the board's shape too, which is the default; or take it as flat and exact.",
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
