"""Find the models of camera and projector from poses of a board: recorded, taken now, or lists of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Literal

from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.files import refuse_existing, removed_on_failure
from fpplab.results.observer import Observer
from fpplab.workflows.pose_causes import diagnosed_poses, with_causes

if TYPE_CHECKING:
    from fpplab.characterisation import Characterisation, DistortionModel
    from fpplab.characterisation.limits import CharacterisationLimits
    from fpplab.characterisation.point_lists import PointListSource
    from fpplab.core.depth import DepthInterval
    from fpplab.devices.rig import Rig
    from fpplab.diagnosis import Finding
    from fpplab.patterns.plan import Plan
    from fpplab.results.characterisation import CharacterisationResult
    from fpplab.sessions.session import Session
    from fpplab.setup.guide import GuidedRun
    from fpplab.targets import Target


@dataclass(frozen=True, eq=False)
class CharacterisationRequest:
    """Which board to fit, and where its poses come from: sessions, a rig, or another program's points."""

    target: Target
    out: Path  # the calibration; a report goes next to it, poses of a rig into a folder next to it
    sessions: tuple[Path, ...] = ()  # one per pose, or the folder that holds them
    points: PointListSource | None = None  # of poses whose points another program located
    rig: Rig | None = None  # not open
    plan: Plan | None = None  # of the poses that are taken
    plan_name: str = "plan"  # as messages call it
    poses: int = 12  # how many are taken
    item: str = "board"  # what the rig's fixture calls the board
    level: DistortionModel | Literal["auto"] = "auto"  # of the distortion that is fitted
    refine_board: bool | None = None  # whether the board's shape is fitted too; by default it is
    guided: bool = False  # whether poses are asked for one at a time, by what is still uncertain
    until_mm: float | None = None  # uncertainty of form at which guided poses end
    depth_mm: DepthInterval | None = None  # working range of guided poses; by default of plan or rig
    force: bool = False  # whether existing files are replaced
    limits: CharacterisationLimits | None = None  # of an expert, by which poses and fit are judged
    marks: Path | None = None  # session that shows the rig's reference marks, after the poses
    marks_target: Target | None = None  # what is printed on them

    @property
    def page(self) -> Path:
        return self.out.with_suffix(".html")

    @property
    def folder(self) -> Path:
        """Where the sessions of poses go that are taken now."""
        return self.out.with_name(self.out.stem + "_poses")


def run_characterisation(
    request: CharacterisationRequest, observer: Observer | None = None
) -> CharacterisationResult:
    """Take or read poses, fit both devices, judge the fit by the frames, and write calibration and report."""
    check_characterisation_input(request)
    observer = observer or Observer()
    guided = None
    if request.points is not None:
        return _save_and_report(request, _fit_points(request, request.points, observer), (), None, observer)
    if request.rig is None:
        from fpplab.sessions.session import recorded_sessions

        sessions: Sequence[Session] = recorded_sessions(list(request.sessions))
        fitted = _fit(request, sessions, observer)
    elif request.guided:
        guided = _run_guide(request, request.rig, observer)
        sessions, fitted = guided.sessions, guided.result
    else:
        sessions = _take_poses(request, request.rig, observer)
        fitted = _fit(request, sessions, observer)
    return _save_and_report(request, fitted, sessions, guided, observer)


def check_characterisation_input(request: CharacterisationRequest) -> None:
    """Refuse outputs that exist already, and a plan that does not suit a board."""
    from fpplab.report.page import is_report

    if sum(map(bool, (request.sessions, request.rig, request.points))) != 1:
        raise ConfigError("give either sessions, --points or --rig, to say where the poses come from")
    continued = request.guided and request.folder.is_dir()  # its poses are kept, its result renewed
    refuse_existing(request.out, request.force or continued)
    # A report alone is of a run that ended before its result.
    refuse_existing(request.page, request.force or continued or is_report(request.page))
    if request.marks is not None:
        from fpplab.sessions.session import recorded_sessions

        recorded_sessions([request.marks])  # which is read after the poses
    if request.rig is not None:
        _check_plan(_plan_of(request), request.plan_name)


def _plan_of(request: CharacterisationRequest) -> Plan:
    if request.plan is None:
        raise ConfigError("a rig needs a plan, to say what is projected onto the board")
    return request.plan


def _check_plan(plan: Plan, name: str) -> None:
    from fpplab.phase import check_unwrapping

    check_unwrapping(plan, name)
    if plan.unwrapped_axes != ("x", "y"):
        raise ConfigError(
            f"{name}: has fringes along {plan.unwrapped_axes[0]} alone; characterisation needs x and y"
        )


def _take_poses(request: CharacterisationRequest, rig: Rig, observer: Observer) -> list[Session]:
    from fpplab.pipeline.taking import take_poses

    plan = _plan_of(request)
    _announce_kept_poses(request, observer)
    with rig:
        caps = rig.projector.caps
        observer.plan(plan, caps.size, caps.lattice)
        with observer.stage("Taking poses") as progress:
            return take_poses(
                rig,
                plan,
                request.item,
                request.poses,
                request.folder,
                request.force,
                progress,
                observer.frame,
            )


def _run_guide(request: CharacterisationRequest, rig: Rig, observer: Observer) -> GuidedRun:
    """Ask for poses one at a time, each judged while the board is still there."""
    from fpplab.setup.guide import GuidedSettings, guided_characterisation

    plan = _plan_of(request)
    _announce_kept_poses(request, observer)
    with rig:
        caps = rig.projector.caps
        observer.plan(plan, caps.size, caps.lattice)
        settings = GuidedSettings(
            request.item,
            request.poses,
            request.until_mm,
            request.depth_mm or plan.depth_mm or rig.file.depth_mm,
            request.level,
            request.refine_board is not False,
            request.force,
        )
        return guided_characterisation(
            rig,
            plan,
            request.target,
            request.folder,
            settings,
            observer.message,
            observer.stage,
            observer.frame,
        )


def _announce_kept_poses(request: CharacterisationRequest, observer: Observer) -> None:
    if request.folder.exists() and not request.force:
        observer.message(f"{request.folder}: complete poses there are kept; --force takes all again")


def _fit(
    request: CharacterisationRequest, sessions: Sequence[Session], observer: Observer
) -> Characterisation:
    from fpplab.characterisation.limits import USUAL_LIMITS
    from fpplab.pipeline.characterising import characterise_sessions

    try:
        with observer.stage("Characterising") as progress:
            return characterise_sessions(
                sessions,
                request.target,
                progress,
                level=request.level,
                refine_board=request.refine_board,
                limits=request.limits or USUAL_LIMITS,
            )
    except CalibrationError as error:
        raise with_causes(error, sessions, observer) from error


def _fit_points(
    request: CharacterisationRequest, source: PointListSource, observer: Observer
) -> Characterisation:
    from fpplab.calibration.model import CalibrationOrigin
    from fpplab.characterisation import characterise
    from fpplab.characterisation.limits import USUAL_LIMITS
    from fpplab.characterisation.point_lists import load_point_list

    with observer.stage("Characterising") as progress:
        fitted = characterise(
            load_point_list(source, request.target),
            request.target,
            source.camera_size,
            source.projector_size,
            source.lattice,
            level=request.level,
            refine_board=request.refine_board,
            limits=request.limits or USUAL_LIMITS,
        )
        progress(1.0)
    return replace(fitted, calibration=replace(fitted.calibration, origin=CalibrationOrigin.now()))


def _save_and_report(
    request: CharacterisationRequest,
    fitted: Characterisation,
    sessions: Sequence[Session],
    guided: GuidedRun | None,
    observer: Observer,
) -> CharacterisationResult:
    """Judge a fit by the frames of its poses, and write report and calibration."""
    from fpplab.diagnosis import diagnose_points
    from fpplab.report.characterisation import write_characterisation_report
    from fpplab.results.characterisation import CharacterisationResult
    from fpplab.results.provenance import point_list_provenance, poses_provenance

    findings = findings_of_poses(fitted)
    if request.points is None:
        diagnosis = diagnosed_poses(sessions, fitted.warnings, fitted.left_out, findings, observer)
        provenance = poses_provenance(sessions, fitted.calibration, request.out)
    else:
        diagnosis = diagnose_points(len(fitted.poses), fitted.warnings, fitted.left_out, findings)
        provenance = point_list_provenance(request.points.path, fitted.calibration, request.out)
    if request.marks is not None and request.marks_target is not None:
        from fpplab.pipeline.marks import locate_session_marks
        from fpplab.sessions.session import recorded_sessions

        (session,) = recorded_sessions([request.marks])
        located = locate_session_marks(session, request.marks_target, fitted.calibration)
        fitted = replace(fitted, calibration=located)
    if not diagnosis.is_good:
        fitted = replace(fitted, calibration=replace(fitted.calibration, doubt=diagnosis.reason))
    for reason in fitted.left_out.values():
        observer.message(f"left out: {reason}")
    for warning in fitted.warnings:
        observer.message(f"warning: {warning}")
    observer.message(diagnosis.sentence)
    observer.result(fitted)
    result = CharacterisationResult(
        characterisation=fitted,
        guided=guided,
        diagnosis=diagnosis,
        provenance=provenance,
        calibration_file=request.out,
        report_file=request.page,
    )
    write_characterisation_report(request.page, result)
    with removed_on_failure(request.page):
        fitted.calibration.save(request.out)  # last: its existence means that all is done
    return result


def findings_of_poses(fitted: Characterisation) -> list[Finding]:
    """Find what changed from pose to pose: the lens, the projector, or boards that moved."""
    return [*_lens_findings(fitted), *_drift_findings(fitted)]


def _lens_findings(fitted: Characterisation) -> list[Finding]:
    """Whether the camera's lens was locked while the poses were taken."""
    from fpplab.characterisation import lens
    from fpplab.diagnosis import Finding
    from fpplab.diagnosis.causes.of_characterisation import LENS_NOT_LOCKED

    if fitted.solution is None or fitted.sizes is None or fitted.model is None:
        return []
    limits = fitted.model.limits
    scales, sigmas = lens.scales_of_poses(fitted.observations, fitted.solution, fitted.sizes)
    if not lens.has_focus_breathing(scales, sigmas, limits):
        return []
    scatter, _ = lens.scale_scatter(scales, sigmas)
    evidence = (
        f"the scale of the camera's image differs between poses by {100 * scatter:.3f} % RMS "
        f"(at most {100 * limits.max_focus_breathing:g} %, and what noise explains)"
    )
    return [Finding(LENS_NOT_LOCKED, evidence, scatter / limits.max_focus_breathing)]


def _drift_findings(fitted: Characterisation) -> list[Finding]:
    """Whether the projector's picture walked from pose to pose; where frames show it, the boards did."""
    from fpplab.characterisation.drift import drift_cost_mm
    from fpplab.diagnosis import Finding
    from fpplab.diagnosis.causes.of_characterisation import BOARD_MOVED
    from fpplab.diagnosis.causes.projector_drift import PROJECTOR_DRIFT

    if fitted.solution is None or fitted.sizes is None or fitted.model is None or not fitted.sizes.drift_px:
        return []
    sizes, fit = fitted.sizes, (fitted.solution, fitted.sizes)
    cost_um = 1e3 * drift_cost_mm(fitted.observations, fit, fitted.model)
    moved = [o.board_shift_px * o.projector_px_per_px for o in fitted.observations if o.board_shift_px]
    is_of_boards = bool(moved) and median(moved) > 0.5 * sizes.drift_px
    evidence = (
        f"the projector's picture of the board walks by {sizes.drift_px:.2f} px from pose to pose, "
        f"{cost_um:.0f} µm where the boards were, which the uncertainty contains"
    )
    cause = BOARD_MOVED if is_of_boards else PROJECTOR_DRIFT
    return [Finding(cause, evidence, max(sizes.drift_px / sizes.projector_px, 1.0))]
