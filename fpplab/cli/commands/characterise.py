"""`fpplab characterise`: models of camera and projector, and the pose between them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fpplab.cli import console
from fpplab.cli.app import PREPARE, DepthOption, Force, Json, PlanName, app
from fpplab.cli.completion import names_of
from fpplab.cli.guided import run_guided, wanted_mm
from fpplab.cli.pose_causes import diagnosed_poses, with_causes
from fpplab.cli.viewing import KeepOpen, ViewOption, open_viewer
from fpplab.core.errors import CalibrationError, ConfigError

if TYPE_CHECKING:
    from fpplab.characterisation import Characterisation, Judgement
    from fpplab.diagnosis import Finding


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
    context: typer.Context,
    sessions: Annotated[
        list[Path] | None, typer.Argument(help="Sessions, one per pose, or the folder that holds them.")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            "--target", help="Target file: the board that was shown.", autocompletion=names_of("target")
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Where the result goes; with --judge, the report, if wanted.")
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option("--rig", help="Take the poses now, on this rig.", autocompletion=names_of("rig")),
    ] = None,
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
    judged: Annotated[
        Path | None,
        typer.Option(
            "--judge", help="Calibration to judge by the sessions, poses that it was not fitted to."
        ),
    ] = None,
    guide: Annotated[
        bool,
        typer.Option(
            "--guide", help="With --rig: ask for the poses one at a time, by what is still uncertain."
        ),
    ] = False,
    until: Annotated[
        str | None,
        typer.Option(
            "--until",
            metavar="LENGTH",
            help="With --guide: end at this standard uncertainty of form, such as 20um: root mean square "
            "over the volume that both devices see within --depth, by the calibration alone, after the best "
            "rigid motion of all its points, without the board's scale, which no pose tells.",
        ),
    ] = None,
    depth: DepthOption = None,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Find the models of camera and projector, and the pose between them; or judge those found before.

    Either from recorded sessions, or with `--rig` by taking the poses now (their sessions stay in
    a folder beside the result). Ten poses or more, tilted up to 30 degrees, over the whole
    field and depth, make a good characterisation. Writes OUT and a report beside it.

    `verdict` says whether to believe the result; `findings` name what is wrong with the poses' frames, each
    with what to do about it.

    With `--guide` each pose is chosen to lessen the uncertainty most, and judged at once: a bad one is
    rejected, with its cause, while the board is still there. It ends at `--until`, or after `--poses`. A
    person is asked in words and by a picture (`next_pose.png` beside the poses); give the same command
    again to go on. `--depth` is the range of the board's distance, by default some percent about the first.

    With `--judge` nothing is fitted but where the board stands: the errors in these poses are shown beside
    those that the calibration predicts. The exit code is 5 where they contradict it.

    Examples: `fpplab characterise poses/ --target target_paper --out calibration.yaml`;
    `fpplab characterise --rig rig_demo --target target_paper --out calibration.yaml`;
    `fpplab characterise --rig my_rig --target target_paper --guide --until 20um --out calibration.yaml`;
    `fpplab characterise --judge calibration.yaml later_poses/`
    """
    if judged:
        _judge(judged, sessions or [], out, force, json, unused={"--rig": rig, "--target": target})
        return
    from fpplab.characterisation import DistortionModel
    from fpplab.core.files import refuse_existing
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.phase import check_unwrapping
    from fpplab.pipeline import characterise_sessions, take_poses
    from fpplab.report import PageBasis, is_report, write_report
    from fpplab.report.parts import PageVerdict
    from fpplab.results.provenance import poses_provenance
    from fpplab.sessions.session import recorded_sessions
    from fpplab.targets import Target
    from fpplab.viewer.characterisation import CharacterisationView
    from fpplab.viewer.measurement import frame_observer

    until_mm = wanted_mm(guide, until, depth, rig)
    if target is None or out is None:
        raise ConfigError(f"{'--target' if target is None else '--out'} is missing")
    if bool(sessions) == bool(rig):
        raise ConfigError("give either sessions or --rig, to say where the poses come from")
    page = out.with_suffix(".html")
    folder = out.with_name(out.stem + "_poses")
    goes_on = guide and folder.is_dir()  # its poses are kept, its result renewed
    refuse_existing(out, force or goes_on)
    refuse_existing(page, force or goes_on or is_report(page))  # of a run that ended before its result
    board, guided = Target.load(target), None
    level: DistortionModel | Literal["auto"] = "auto" if model is ModelName.AUTO else DistortionModel(model)
    viewer = open_viewer(context, CharacterisationView, view, keep_open, out.with_suffix(".rrd"))
    if rig:
        chosen = Plan.load(plan)
        check_unwrapping(chosen, plan)
        if chosen.axes != ("x", "y"):
            raise ConfigError(
                f"{plan}: has fringes along {chosen.axes[0]} alone; characterisation needs x and y"
            )
        if folder.exists() and not force:
            console.log_status(f"{folder}: complete poses there are kept; --force takes all anew")
        with Rig.load(rig) as bench:
            caps, observe = bench.projector.caps, frame_observer(viewer)
            viewer.show(CharacterisationView.plan, chosen, caps.size, caps.lattice)
            if guide:
                guided = run_guided(
                    *(bench, chosen, board, folder, level, refine_board, force),
                    item=item, poses=poses, until_mm=until_mm, depth_mm=depth, observe_frame=observe,
                )  # fmt: skip
            else:
                with console.progress("Taking poses") as report:
                    recorded = take_poses(bench, chosen, item, poses, folder, force, report, observe)
    else:
        recorded = recorded_sessions(sessions or [])
    if guided:
        result, recorded = guided.result, list(guided.sessions)
    else:
        try:
            with console.progress("Characterising") as report:
                result = characterise_sessions(
                    recorded, board, report, level=level, refine_board=refine_board
                )
        except CalibrationError as error:
            raise with_causes(error, recorded) from error
    diagnosis = diagnosed_poses(recorded, result.warnings, result.left_out, _of_lens(result))
    for reason in result.left_out.values():
        console.log_status(f"left out: {reason}")
    for warning in result.warnings:
        console.log_status(f"warning: {warning}")
    console.log_status(diagnosis.sentence)
    viewer.show(CharacterisationView.result, result)
    source = poses_provenance(recorded, result.calibration, out)
    answer = {**diagnosis.summary(), **result.summary(), "left_out": result.left_out}
    answer |= {"guided": guided.summary()} if guided else {}
    basis = PageBasis((PageVerdict.of(diagnosis),), {"poses": source}, answer)
    title = f"Characterisation {out.stem}"
    write_report(page, title, facts=result.facts(), characterisation=result, guided=guided, basis=basis)
    result.calibration.save(out)  # last: where it is, all is done
    console.print_result({**answer, "provenance": source.summary(), "report": str(page)}, json)


def _of_lens(result: Characterisation) -> list[Finding]:
    """Whether the camera's lens was locked while the poses were taken."""
    from fpplab.characterisation import lens
    from fpplab.characterisation.limits import USUAL_LIMITS
    from fpplab.diagnosis import Finding
    from fpplab.diagnosis.causes.of_characterisation import LENS_NOT_LOCKED

    if result.solution is None or result.sizes is None:
        return []
    scales, sigmas = lens.scales_of_poses(result.observations, result.solution, result.sizes)
    if not lens.has_focus_breathing(scales, sigmas):
        return []
    scatter, _ = lens.scale_scatter(scales, sigmas)
    words = (
        f"the scale of the camera's image differs between poses by {100 * scatter:.3f} % RMS "
        f"(at most {100 * USUAL_LIMITS.max_focus_breathing:g} %, and what noise explains)"
    )
    return [Finding(LENS_NOT_LOCKED, words, scatter / USUAL_LIMITS.max_focus_breathing)]


def _judge(
    path: Path, paths: list[Path], out: Path | None, force: bool, json: bool, unused: dict[str, str | None]
) -> None:
    """Judge a calibration by sessions of poses that it was not fitted to."""
    from fpplab.calibration.model import Calibration
    from fpplab.core.files import refuse_existing
    from fpplab.pipeline import judge_sessions
    from fpplab.report import PageBasis, write_report
    from fpplab.report.devices import judgement_verdict
    from fpplab.results.provenance import poses_provenance
    from fpplab.sessions.session import recorded_sessions

    for option, value in unused.items():
        if value is not None:
            raise ConfigError(
                f"{option} does not go with --judge, which takes recorded sessions of its board"
            )
    if not paths:
        raise ConfigError("--judge needs sessions, one per pose, or the folder that holds them")
    page = out.with_suffix(".html") if out else None
    if page:
        refuse_existing(page, force)
    calibration = Calibration.load(path)
    with console.progress("Judging") as report:
        sessions = recorded_sessions(paths)
        found = judge_sessions(sessions, calibration, path, report)
    for reason in found.left_out.values():
        console.log_status(f"left out: {reason}")
    source = poses_provenance(sessions, calibration, path)
    answer = {**found.summary(), "left_out": found.left_out}
    if page:
        basis = PageBasis((judgement_verdict(found),), {"poses": source}, answer)
        write_report(page, f"Judgement of {path.stem}", judgement=found, basis=basis)
    answer = {**answer, "provenance": source.summary(), "report": str(page) if page else None}
    console.print_result(answer, json, lambda: _show_judgement(found))
    if found.contradicted:
        raise console.CommandExit(CalibrationError.exit_code)


def _show_judgement(found: Judgement) -> None:
    rows = [
        [p.name, p.points]
        + [f"{x:.3f}" for e in (p.camera, p.projector) for x in (e.rms_px, e.predicted_px)]
        + ["more than chance" if p.contradicts else ""]
        for p in found.poses
    ]
    columns = ["pose", "points", "camera px", "predicted", "projector px", "predicted", ""]
    console.table("Errors in poses that were not fitted", columns, rows)
    console.stdout.print(found.verdict, markup=False)
