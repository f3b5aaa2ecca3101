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
from fpplab.cli.viewing import (
    CharacterisationObserver,
    ConsoleObserver,
    KeepOpen,
    ViewOption,
    make_observer,
)
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
        list[Path] | None, typer.Argument(help="Sessions, one per pose, or the folder that contains them.")
    ] = None,
    target: Annotated[str | None, config_option("target", "Target file of the board.")] = None,
    out: Annotated[
        Path | None, option("--out", "Calibration file to write; with --judge, an optional report.")
    ] = None,
    points: Annotated[
        Path | None,
        option(
            "--points", "Table of board points in camera and projector pixels, located by another program."
        ),
    ] = None,
    camera_size: CameraSize = None,
    projector_size: ProjectorSize = None,
    lattice: ProjectorLattice = None,
    rig: Annotated[str | None, config_option("rig", "Record the poses now with this rig.")] = None,
    plan: PlanName = "plan_board.yaml",
    poses: Annotated[int, option("--poses", "Number of poses to record with --rig.", min=3)] = 12,
    item: Annotated[str, option("--item", "Name of the board in the rig's fixture.")] = "board",
    model: Annotated[
        ModelName,
        option(
            "--model",
            "Distortion model: k1; k2 (k1 k2); tangential (k1 k2 p1 p2); k3 (adds k3); rational (adds "
            "k4 k5 k6, for wide lenses); auto uses k3 and reports how each model predicts poses left "
            "out of the fit.",
        ),
    ] = ModelName.AUTO,
    refine_board: Annotated[
        bool | None,
        option(
            "--refine-board/--flat-board",
            "Also estimate the shape of the board (default), or assume that it is flat and exact.",
        ),
    ] = None,
    judged: Annotated[
        Path | None,
        option(
            "--judge",
            "Calibration to test with the sessions, whose poses must not have been used in its fit.",
        ),
    ] = None,
    corrected: Annotated[
        Path | None,
        option("--correct", "Calibration to correct with the sessions: one to three poses of its board."),
    ] = None,
    combined: Annotated[
        bool, option("--combine", "Combine several calibrations of the same rig, given in place of sessions.")
    ] = False,
    confirm: Annotated[
        bool,
        option("--confirm", "With --judge: record the date of the test in the calibration if it passes."),
    ] = False,
    guide: Annotated[
        bool, option("--guide", "With --rig: request each pose where it reduces the uncertainty most.")
    ] = False,
    marks: Annotated[
        Path | None, option("--marks", "Session of the rig's reference marks, recorded after the poses.")
    ] = None,
    marks_target: Annotated[
        str, config_option("target", "With --marks: target file of the printed marks.", "--marks-target")
    ] = "target_marks",
    until: Annotated[
        str | None,
        option(
            "--until",
            "With --guide: stop at this standard uncertainty of form, such as 20um. It is the root "
            "mean square that the calibration contributes over the volume seen by both devices within "
            "--depth, after removing the best rigid motion and the scale of the board, which no pose "
            "can determine.",
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
    """Calibrate camera and projector, or correct a calibration.

    The poses of the board come from recorded sessions, or with `--rig` are recorded now (their sessions are
    kept in a folder next to the result). Use at least ten poses, tilted by up to 30 degrees and spread over
    the whole field and depth. Writes OUT and a report next to it.

    `verdict` says whether the result can be trusted; `findings` lists what is wrong with the frames of the
    poses, each with a remedy.

    With `--guide` each pose is requested where it reduces the uncertainty most and is judged at once: a bad
    pose is rejected, with the cause, while the board is still in place. It stops at `--until` or after
    `--poses`. The operator is prompted by text and a picture (`next_pose.png` next to the poses); the same
    command continues after an interruption. `--depth` is the range of distances of the board, by default a
    range about the first.

    With `--points` the poses come from a text table whose first row names its columns: `pose`, `id` (row of
    the target's points) or `x_mm` and `y_mm`, `camera_u`, `camera_v`, `projector_u`, `projector_v`. The
    centre of the first pixel of each device is (0, 0); subtract 1 from the coordinates of programs that
    count from 1.

    With `--judge` only the position of the board is estimated: the errors at these poses are compared with
    those predicted by the calibration. The exit code is 5 if they contradict it. If they agree, `--confirm`
    records the date, from which the age limit in the rig file (`geometry: {max_age_h: ...}`) counts.

    With `--marks` the calibration stores how camera and projector see fixed reference marks (`fpplab target
    marks`). Every scan that shows the marks then verifies its geometry. Together with `--correct` the
    corrected calibration stores the marks as seen in this session.

    With `--correct` the calibration is updated from one to three new poses, or from a scan of the reference
    marks, after a device was moved or refocused or its image shifted: `probabilities` says what has changed,
    `untold` which changes need more poses to decide. If no such change explains the poses, the exit code is
    5: characterise again.

    With `--combine` several calibrations of the same rig are averaged, and the uncertainty of the mean
    includes the variation between them; `varying` lists the parameters and lengths that vary more than
    stated.

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
    observer = make_observer(context, CharacterisationObserver, view, keep_open, out.with_suffix(".rrd"))
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
    from fpplab.workflows.calibrations import CorrectionRequest, run_correction

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
    from fpplab.workflows.calibrations import CombinationRequest, run_combination

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
    from fpplab.workflows.calibrations import JudgementRequest, run_judgement

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
