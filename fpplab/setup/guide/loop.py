"""Loop of a guided characterisation: ask, take, observe, judge, accept or reject; until enough is known."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from fpplab.acquisition.acquire import FrameObserver
from fpplab.characterisation import (
    Characterisation,
    DistortionModel,
    Observation,
    characterise,
    finest_periods,
)
from fpplab.characterisation.estimate import JointEstimate
from fpplab.characterisation.fitting import DEFAULT_LEVEL
from fpplab.characterisation.guide import Guide, PoseFit, WantedPose
from fpplab.characterisation.working_volume import WorkingVolume
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import CalibrationError
from fpplab.core.progress import Progress, ignore
from fpplab.core.session_names import JOURNAL
from fpplab.devices.rig import Rig
from fpplab.diagnosis import Finding
from fpplab.patterns.plan import Plan
from fpplab.pipeline.characterising import observe_session, require_plan_fits
from fpplab.pipeline.taking import check_disk_space, take_or_resume_session
from fpplab.sessions.origin import calibration_origin
from fpplab.sessions.session import Session
from fpplab.setup.guide.asking import PICTURE, bring_by, held_first_pose, write_sketch
from fpplab.setup.guide.attempts import GuidedRun, PoseAttempt, accepted_sentence, rejected_sentence
from fpplab.setup.guide.rejection import frame_findings, inconsistent_pose, residual_finding, unseen_board
from fpplab.targets import Target


@dataclass(frozen=True)
class GuideLimits:
    """When the loop ends, and what comes first; all chosen."""

    min_poses: int = 5  # fewer do not show how large the errors of a pose are
    fill_last: int = 3  # poses left from which on parts of the images without points come first
    max_tries: int = 2  # of one pose in succession
    max_rejected: int = 8  # poses in succession; the loop ends with the reason
    max_rejected_first: int = 3  # the same before any was accepted


LIMITS = GuideLimits()

REJECTED = "rejected"  # folder of poses that were rejected, next to those that count

Bar = Callable[[str], AbstractContextManager[Progress]]
"""Shows the progress of a named task while its context lasts."""


@dataclass(frozen=True)
class GuidedSettings:
    """What a guided characterisation is to reach, and how."""

    item: str = "board"  # what the rig's fixture calls the board
    poses: int = 12  # most poses that count
    until_mm: float | None = None  # standard uncertainty of form in mm at which the loop ends
    depth_mm: DepthInterval | None = None  # working range of depths in mm
    level: DistortionModel | Literal["auto"] = "auto"  # which distortion is fitted at the end
    refine_board: bool = True  # whether the board's shape is fitted too
    force: bool = False  # whether poses that were taken before are taken again


def guided_characterisation(
    rig: Rig, plan: Plan, target: Target, folder: Path, settings: GuidedSettings,
    tell: Callable[[str], object], bar: Bar, observe_frame: FrameObserver = ignore,
) -> GuidedRun:  # fmt: skip
    """Characterise a rig by poses that are asked for one at a time."""
    return _PoseGuideLoop(rig, plan, target, folder, settings, tell, bar, observe_frame).run()


class _PoseGuideLoop:
    def __init__(
        self, rig: Rig, plan: Plan, target: Target, folder: Path, settings: GuidedSettings,
        tell: Callable[[str], object], bar: Bar, observe_frame: FrameObserver,
    ) -> None:  # fmt: skip
        self._rig, self._plan, self._folder, self._settings = rig, plan, folder, settings
        self._tell, self._bar, self._target, self._observe_frame = tell, bar, target, observe_frame
        fixture = rig.need_fixture("a guided characterisation")
        fixture.check(settings.item)
        self._bring = bring_by(fixture, settings.item)
        caps = rig.projector.caps
        self._sizes, self._lattice = (rig.camera.caps.size, caps.size), caps.lattice
        level = DEFAULT_LEVEL if settings.level == "auto" else settings.level
        depth = settings.depth_mm
        self._guide = Guide(target, self._sizes, self._lattice, depth, level, settings.refine_board)
        self._guide.first_known = held_first_pose(fixture, settings.item)
        self._periods = finest_periods(plan, caps.size)
        self._sessions: dict[str, Session] = {}
        self._attempts: list[PoseAttempt] = []
        self._tried = self._in_succession = 0
        self._pose: WantedPose | None = None

    def run(self) -> GuidedRun:
        paths = [self._pose_folder(k) for k in range(self._settings.poses)]
        check_disk_space(self._rig, self._plan, paths, self._settings.force)
        if not self._settings.force:
            self._count_poses_of_earlier_run()
        while True:
            while not self._has_enough_poses():
                self._take_next_pose()
            run = self._characterise_accepted()
            if run.reached or len(self._sessions) >= self._settings.poses:
                self._tell(run.sentence)
                return run
            self._tell(f"{run.sentence.split(';')[0]}, without outlying points: one more pose")
            self._take_next_pose()

    def _has_enough_poses(self) -> bool:
        form, until, count = self._guide.form_mm, self._settings.until_mm, len(self._sessions)
        if count >= self._settings.poses:
            return True
        reached = form is not None and until is not None and form <= until
        return reached and count >= LIMITS.min_poses and not self._guide.has_uncovered_region

    def _empty_image_parts_come_first(self) -> bool:
        """Whether parts of the images without points come first: little else is left to do."""
        form, until = self._guide.form_mm, self._settings.until_mm
        last = self._settings.poses - len(self._sessions) <= LIMITS.fill_last
        return last or (form is not None and until is not None and form <= until)

    def _count_poses_of_earlier_run(self) -> None:
        for path in sorted(self._folder.glob(f"pose_*/{JOURNAL}")):
            if len(self._sessions) == self._settings.poses or Session.open(path.parent).missing():
                continue
            number = int(path.parent.name.removeprefix("pose_"))
            mounted = (self._settings.item, number)
            session = take_or_resume_session(
                self._rig, self._plan, path.parent, mounted, accept_complete=True
            )
            self._accept_or_reject_pose(session, "kept from before")

    def _take_next_pose(self) -> None:
        guide, taken = self._guide, self._sessions
        number = next(k for k in range(len(taken) + 1) if self._pose_folder(k).name not in taken)
        if self._pose is None:
            self._pose = guide.next_pose(fill=self._empty_image_parts_come_first())
        pose, path = self._pose, self._pose_folder(number)
        self._tell(f"pose {len(self._sessions) + 1}: {pose.description}")
        picture = self._folder / PICTURE
        if pose.outline_px is not None:
            write_sketch(picture, pose, self._sizes[0], self._last_pose_image())
        with self._bar(f"Taking pose {len(self._sessions) + 1}") as report:
            session = take_or_resume_session(
                self._rig,
                self._plan,
                path,
                (self._settings.item, number),
                replace_existing=True,
                place_item=lambda: self._bring(pose, picture),
                progress=report,
                observe_frame=self._observe_frame,
            )
        if not self._attempts:
            require_plan_fits(session)
        if self._accept_or_reject_pose(session, pose.description):
            self._pose, self._tried = None, 0
            return
        self._tried += 1
        if self._tried == LIMITS.max_tries:
            guide.exclude(pose)
            self._pose, self._tried = None, 0

    def _accept_or_reject_pose(self, session: Session, description: str) -> bool:
        with self._bar("Evaluating the pose") as report:
            observation, reason = self._observe_board(session)
            report(0.5)
            findings = frame_findings(session.recording(verify=False))
        if observation is None:
            self._reject_pose(session, description, unseen_board(reason, findings))
            return False
        fit = self._guide.judged(observation)
        misfit = residual_finding(fit)
        if fit is not None and fit.outlying_pose is not None:
            self._reject_accepted_pose(
                fit.outlying_pose, f"the poses agree without it, and not with {fit.outlying_pose}"
            )
            misfit = None
        if misfit is not None or (findings and not self._were_in_pose_before(findings)):
            # The frames may show the cause of the residuals.
            all_findings = (*findings, misfit) if misfit is not None else findings
            self._reject_pose(session, description, all_findings, observation, fit)
            return False
        self._accept_pose(session, description, observation, fit, findings)
        return True

    def _were_in_pose_before(self, findings: tuple[Finding, ...]) -> bool:
        """Whether the pose before shows the same: then it is the rig's, and no pose will be without it."""
        before = {finding.cause for finding in self._attempts[-1].findings} if self._attempts else set()
        return {finding.cause for finding in findings} <= before

    def _observe_board(self, session: Session) -> tuple[Observation | None, str]:
        try:
            return observe_session(session, self._target, self._periods), ""
        except CalibrationError as error:
            return None, str(error).removeprefix(f"{session.path.name}: ")

    def _accept_pose(
        self, session: Session, description: str, observation: Observation, fit: PoseFit | None,
        findings: tuple[Finding, ...],
    ) -> None:  # fmt: skip
        name = session.path.name
        self._sessions[name] = session
        odd = self._guide.add(observation)
        guide, self._in_succession = self._guide, 0
        rms = guide.rms_px(name) if name not in odd else {}
        attempt = PoseAttempt(
            name, description, len(observation.ids), rms, fit, guide.form_mm, findings, True
        )
        self._attempts.append(attempt)
        self._tell(accepted_sentence(len(self._sessions), attempt, self._settings.until_mm))
        for other, why in odd.items():
            self._reject_accepted_pose(other, why.removeprefix(f"{other}: "))

    def _reject_pose(
        self, session: Session, description: str, findings: tuple[Finding, ...],
        observation: Observation | None = None, fit: PoseFit | None = None,
    ) -> None:  # fmt: skip
        points = len(observation.ids) if observation else 0
        rms = {"camera": fit.camera.rms_px, "projector": fit.projector.rms_px} if fit else {}
        attempt = PoseAttempt(session.path.name, description, points, rms, fit, None, findings, False)
        self._attempts.append(attempt)
        self._tell(rejected_sentence(len(self._sessions) + 1, attempt))
        self._set_aside(session)
        self._in_succession += 1
        if self._in_succession == (LIMITS.max_rejected if self._sessions else LIMITS.max_rejected_first):
            first = findings[0]
            raise CalibrationError(
                f"{self._in_succession} poses in succession were rejected, the last for {first.sentence}; "
                f"{first.remedy}; the same command goes on"
            )

    def _reject_accepted_pose(self, name: str, why: str) -> None:
        finding = inconsistent_pose(why)
        at = max(k for k, attempt in enumerate(self._attempts) if attempt.name == name and attempt.accepted)
        attempt = self._attempts[at]
        self._attempts[at] = replace(attempt, accepted=False, findings=(finding, *attempt.findings))
        if any(o.name == name for o in self._guide.observations):
            self._guide.drop(name)
        self._tell(f"{name} does not count any more: {finding.sentence}")
        self._set_aside(self._sessions.pop(name))

    def _set_aside(self, session: Session) -> None:
        aside = self._folder / REJECTED
        aside.mkdir(exist_ok=True)
        number = sum(1 for _ in aside.glob(f"{session.path.name}_*"))
        session.path.rename(aside / f"{session.path.name}_{number + 1}")

    def _characterise_accepted(self) -> GuidedRun:
        guide, settings = self._guide, self._settings
        with self._bar("Characterising"):
            result = characterise(
                guide.observations, self._target, *self._sizes, self._lattice,
                level=settings.level, refine_board=settings.refine_board,
            )  # fmt: skip
        depth, sessions = guide.depth_mm, tuple(self._sessions.values())
        assert depth is not None
        dated = replace(result.calibration, origin=calibration_origin(sessions))
        result = replace(result, calibration=dated)
        return _run_of(result, self._target, sessions, tuple(self._attempts), settings, depth)

    def _last_pose_image(self) -> NDArray[Any] | None:
        if not self._sessions:
            return None
        return list(self._sessions.values())[-1].recording(verify=False).mean_image()

    def _pose_folder(self, number: int) -> Path:
        return self._folder / f"pose_{number:02d}"


def _run_of(
    result: Characterisation, target: Target, sessions: tuple[Session, ...],
    attempts: tuple[PoseAttempt, ...], settings: GuidedSettings, depth_mm: DepthInterval,
) -> GuidedRun:  # fmt: skip
    assert result.model is not None
    assert result.solution is not None
    assert result.sizes is not None
    calibration, model = result.calibration, result.model
    lattice = calibration.projector.lattice
    estimate = JointEstimate(target, lattice, model, result.observations, result.solution, result.sizes)
    volume, rms = WorkingVolume.of(calibration, depth_mm), result.pose_rms_px
    # The first poses were taken before anything was known of their residuals.
    with_residuals = [
        replace(a, rms_px=rms.get(a.name, {})) if a.accepted and not a.rms_px else a for a in attempts
    ]
    form = volume.form_mm(result.solution, model.level, estimate.covariance)
    scale = model.scale_tolerance * volume.radius_mm
    return GuidedRun(result, sessions, tuple(with_residuals), form, scale, settings.until_mm, depth_mm)
