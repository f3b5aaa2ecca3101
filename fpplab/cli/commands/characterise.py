"""`fpplab characterise`: models of camera and projector, and the pose between them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import (
    PREPARE,
    CameraSize,
    DepthOption,
    Force,
    Json,
    LimitsOption,
    PlanName,
    ProjectorLattice,
    ProjectorSize,
    app,
)
from fpplab.cli.completion import config_option, option
from fpplab.cli.viewing import ConsoleObserver, KeepOpen, ViewOption, observe_characterisation
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.lattice import Lattice
from fpplab.core.units import length_mm

if TYPE_CHECKING:
    from fpplab.characterisation import Combination, Correction, Judgement
    from fpplab.characterisation.point_lists import PointListSource
    from fpplab.core.depth import DepthInterval


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
    target: Annotated[str | None, config_option("target", "Target file: the board that was shown.")] = None,
    out: Annotated[
        Path | None, option("--out", "Where the result goes; with --judge, the report, if wanted.")
    ] = None,
    points: Annotated[
        Path | None,
        option("--points", "Table of the board's points in camera and projector, located elsewhere."),
    ] = None,
    camera_size: CameraSize = None,
    projector_size: ProjectorSize = None,
    lattice: ProjectorLattice = None,
    rig: Annotated[str | None, config_option("rig", "Take the poses now, on this rig.")] = None,
    plan: PlanName = "plan_board.yaml",
    poses: Annotated[int, option("--poses", "How many poses to take with --rig.", min=3)] = 12,
    item: Annotated[str, option("--item", "What the rig's fixture calls the board.")] = "board",
    model: Annotated[
        ModelName,
        option(
            "--model",
            "Distortion: k1; k2 (k1 k2); tangential (k1 k2 p1 p2); k3 (and k3); rational (and k4 k5 k6, "
            "for wide lenses); auto: k3, with the errors of all in poses left out.",
        ),
    ] = ModelName.AUTO,
    refine_board: Annotated[
        bool | None,
        option(
            "--refine-board/--flat-board",
            "Fit the board's shape too, which is the default; or take it as flat and exact.",
        ),
    ] = None,
    judged: Annotated[
        Path | None,
        option("--judge", "Calibration to judge by the sessions, poses that it was not fitted to."),
    ] = None,
    corrected: Annotated[
        Path | None,
        option("--correct", "Calibration to correct by the sessions, one to three poses of its board."),
    ] = None,
    combined: Annotated[
        bool, option("--combine", "Combine the calibrations given instead of sessions, all of one rig.")
    ] = False,
    confirm: Annotated[
        bool, option("--confirm", "With --judge: record in the calibration that the poses confirm it.")
    ] = False,
    guide: Annotated[
        bool, option("--guide", "With --rig: ask for the poses one at a time, by what is still uncertain.")
    ] = False,
    marks: Annotated[
        Path | None, option("--marks", "Session that shows the rig's reference marks, taken after the poses.")
    ] = None,
    marks_target: Annotated[
        str, config_option("target", "With --marks: target file of what is printed.", "--marks-target")
    ] = "target_marks",
    until: Annotated[
        str | None,
        option(
            "--until",
            "With --guide: end at this standard uncertainty of form, such as 20um: root mean square "
            "over the volume that both devices see within --depth, by the calibration alone, after the best "
            "rigid motion of all its points, without the board's scale, which no pose can determine.",
            metavar="LENGTH",
        ),
    ] = None,
    depth: DepthOption = None,
    limits: LimitsOption = None,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Find the models of camera and projector, and the pose between them; or judge those found before.

    Either from recorded sessions, or with `--rig` by taking the poses now (their sessions stay in
    a folder next to the result). Ten poses or more, tilted up to 30 degrees, over the whole
    field and depth, make a good characterisation. Writes OUT and a report next to it.

    `verdict` says whether to believe the result; `findings` name what is wrong with the poses' frames, each
    with what to do about it.

    With `--guide` each pose is chosen to reduce the uncertainty most, and judged at once: a bad one is
    rejected, with its cause, while the board is still there. It ends at `--until`, or after `--poses`. A
    person is asked in words and by a picture (`next_pose.png` next to the poses); give the same command
    again to go on. `--depth` is the range of the board's distance, by default some percent about the first.

    With `--points` the poses come from a text table, whose first row names its columns: `pose`, `id` (row of
    the target's points) or `x_mm` and `y_mm`, `camera_u`, `camera_v`, `projector_u`, `projector_v`. The
    centre of a device's first pixel is 0 0; programs that count from 1 need 1 taken off.

    With `--judge` only the position of the board is fitted: the errors in these poses are compared with
    those that the calibration predicts. The exit code is 5 where they contradict it. Otherwise `--confirm`
    records when, from which the rig file's `geometry: {max_age_h: ...}` counts.

    With `--marks` the calibration keeps how camera and projector see reference marks (`fpplab target marks`)
    that are fixed in view. Every scan that shows them is then verified by itself. With `--correct` as well
    the corrected calibration keeps them, as this session shows them.

    With `--correct` the calibration is brought up to date by one to three new poses, or by a scan that shows
    its reference marks, after a device was moved, refocused or its picture shifted: `probabilities` says what
    has changed, `untold` what more poses would tell. Where no such change explains what they show, the exit
    code is 5: characterise again.

    With `--combine` several calibrations of one rig become their mean, whose uncertainty contains by how much
    the rig varies between them; `varying` lists the parameters and lengths that vary more than stated.

    Examples: `fpplab characterise poses/ --target target_paper --out calibration.yaml`;
    `fpplab characterise --rig rig_demo --target target_paper --out calibration.yaml`;
    `fpplab characterise --rig my_rig --target target_paper --guide --until 20um --out calibration.yaml`;
    `fpplab characterise --points corners.csv --target target_paper --camera-size 1920 1200
    --projector-size 912 1140 --lattice diamond --out calibration.yaml`;
    `fpplab characterise --judge calibration.yaml later_poses/`;
    `fpplab characterise --correct calibration.yaml new_pose/ --out corrected.yaml`;
    `fpplab characterise --combine monday.yaml tuesday.yaml friday.yaml --out week.yaml`
    """
    recorded = tuple(sessions or ())
    unused = {"--rig": rig, "--target": target, "--points": points, "--marks": marks}
    if corrected and judged:
        raise ConfigError("--correct and --judge exclude each other; judge first")
    if combined:
        _combine(recorded, out, force, json, {**unused, "--judge": judged, "--correct": corrected})
        return
    if corrected:
        _correct(corrected, recorded, (marks, marks_target), out, force, json, {**unused, "--marks": None})
        return
    if judged:
        _judge(judged, recorded, out, force, confirm, json, unused)
        return
    if confirm:
        raise ConfigError("--confirm goes with --judge CALIBRATION, and the poses that confirm it")
    from fpplab.characterisation import DistortionModel
    from fpplab.characterisation.limits import CharacterisationLimits
    from fpplab.cli.usage import missing_or_misplaced
    from fpplab.core.config import load_document
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.targets import Target
    from fpplab.workflows.characterise import CharacterisationRequest, run_characterisation

    until_mm = wanted_mm(guide, until, depth, rig, limits)
    if target is None or out is None:
        option = "--out" if target else "--target"
        raise ConfigError(missing_or_misplaced("fpplab characterise", option, list(map(str, recorded))))
    request = CharacterisationRequest(
        target=Target.load(target),
        out=out,
        sessions=recorded,
        points=point_list_source(points, camera_size, projector_size, lattice),
        rig=Rig.load(rig) if rig else None,
        plan=Plan.load(plan) if rig else None,
        plan_name=plan,
        poses=poses,
        item=item,
        level="auto" if model is ModelName.AUTO else DistortionModel(model),
        refine_board=refine_board,
        guided=guide,
        until_mm=until_mm,
        depth_mm=depth,
        force=force,
        limits=load_document(limits, CharacterisationLimits, "limits") if limits else None,
        marks=marks,
        marks_target=Target.load(marks_target) if marks else None,
    )
    observer = observe_characterisation(context, view, keep_open, out.with_suffix(".rrd"))
    console.print_result(run_characterisation(request, observer).summary(), json)


def wanted_mm(
    guide: bool, until: str | None, depth_mm: DepthInterval | None, rig: str | None, limits: Path | None
) -> float | None:
    for name, value in (("--until", until), ("--depth", depth_mm)):
        if value is not None and not guide:
            raise ConfigError(f"{name} goes with --guide, which asks for poses; add --guide")
    if guide and rig is None:
        raise ConfigError("--guide takes poses one at a time, and needs --rig to take them on")
    if limits and guide:
        raise ConfigError("--limits is for recorded poses: with --guide each pose is judged as it is taken")
    if depth_mm is not None and not 0 < depth_mm[0] < depth_mm[1]:
        raise ConfigError(
            f"--depth is {depth_mm[0]:g} {depth_mm[1]:g}: must be two rising positive distances in mm"
        )
    return None if until is None else length_mm(until, "--until")


def point_list_source(
    points: Path | None,
    camera_size: tuple[int, int] | None,
    projector_size: tuple[int, int] | None,
    lattice: Lattice | None,
) -> PointListSource | None:
    from fpplab.characterisation.point_lists import PointListSource

    sizes = {"--camera-size": camera_size, "--projector-size": projector_size}
    if points is None:
        given = [name for name, value in (*sizes.items(), ("--lattice", lattice)) if value is not None]
        if given:
            raise ConfigError(f"{given[0]} goes with --points; sessions and rigs know it themselves")
        return None
    if camera_size is None or projector_size is None:
        missing = next(name for name, value in sizes.items() if value is None)
        raise ConfigError(f"{missing} is missing; a table of points does not say it")
    return PointListSource(points, camera_size, projector_size, lattice or Lattice.SQUARE)


def _correct(
    path: Path,
    sessions: tuple[Path, ...],
    marks: tuple[Path | None, str],
    out: Path | None,
    force: bool,
    json: bool,
    unused: Mapping[str, object],
) -> None:
    from fpplab.targets import Target
    from fpplab.workflows.correct import CorrectionRequest, run_correction

    _refuse_unused("--correct", unused)
    if not sessions:
        raise ConfigError("--correct needs sessions, one per pose, or the folder that holds them")
    if out is None:
        raise ConfigError("--correct needs --out, where the corrected calibration goes")
    located = (marks[0], Target.load(marks[1])) if marks[0] else None
    request = CorrectionRequest(path, sessions, out, force, located)
    result = run_correction(request, ConsoleObserver())
    console.print_result(result.summary(), json, lambda: _show_correction(result.correction))


def _combine(
    calibrations: tuple[Path, ...],
    out: Path | None,
    force: bool,
    json: bool,
    unused: Mapping[str, object],
) -> None:
    from fpplab.workflows.combine import CombinationRequest, run_combination

    _refuse_unused("--combine", unused, "calibrations")
    if out is None:
        raise ConfigError("--combine needs --out, where the combined calibration goes")
    result = run_combination(CombinationRequest(calibrations, out, force), ConsoleObserver())
    console.print_result(result.summary(), json, lambda: _show_combination(result.combination))


def _show_combination(combination: Combination) -> None:
    rows = [
        [f"{name} {q.unit}", *(f"{x:.3g}" for x in (q.stated, q.scatter, q.between, q.combined))]
        + ["varies" if q.exceeds else ""]
        for name, q in combination.quantities.items()
    ]
    columns = ["quantity", "stated", "scatter", "between", "combined", ""]
    console.table("Standard deviations", columns, rows)


def _refuse_unused(
    option: str, unused: Mapping[str, object], taken: str = "recorded sessions of its board"
) -> None:
    for name, value in unused.items():
        if value is not None:
            raise ConfigError(f"{name} does not go with {option}, which takes {taken}")


def _show_correction(correction: Correction) -> None:
    if not correction.before.contradicted:
        console.stdout.print("The poses did not contradict the calibration as it was.")
    rows = [[name, f"{chance:.3f}"] for name, chance in correction.probabilities.items()]
    console.table("What has changed", ["change", "probability"], rows)
    _show_judgement(correction.after)


def _judge(
    path: Path,
    sessions: tuple[Path, ...],
    out: Path | None,
    force: bool,
    confirm: bool,
    json: bool,
    unused: Mapping[str, object],
) -> None:
    from fpplab.workflows.judge import JudgementRequest, run_judgement

    _refuse_unused("--judge", unused)
    if not sessions:
        raise ConfigError("--judge needs sessions, one per pose, or the folder that holds them")
    page = out.with_suffix(".html") if out else None
    result = run_judgement(JudgementRequest(path, sessions, page, force, confirm), ConsoleObserver())
    console.print_result(result.summary(), json, lambda: _show_judgement(result.judgement))
    if result.judgement.contradicted:
        raise console.CommandExit(CalibrationError.exit_code)


def _show_judgement(judgement: Judgement) -> None:
    rows = [
        [p.name, p.points]
        + [f"{x:.3f}" for e in (p.camera, p.projector) for x in (e.rms_px, e.predicted_px)]
        + ["more than chance" if p.contradicts else ""]
        for p in judgement.poses
    ]
    columns = ["pose", "points", "camera px", "predicted", "projector px", "predicted", ""]
    console.table("Errors in poses that were not fitted", columns, rows)
    console.stdout.print(judgement.verdict)
