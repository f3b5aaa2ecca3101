"""The steps of a measurement, each from open devices or recorded sessions to a result.

One code for the command line, the demonstration, programs and tests; nothing here knows what kind of rig it
runs on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from fpplab.acquisition.acquire import FrameObserver, acquire, expose
from fpplab.acquisition.synchronisation import IMPORTED_REMEDY, check_synchronisation, remedy
from fpplab.calibration.model import Calibration
from fpplab.characterisation import (
    Characterisation,
    DistortionModel,
    Judgement,
    Observation,
    characterise,
    finest_periods,
    judge,
    judged_board,
    observe,
)
from fpplab.clouds import Cloud, save_cloud
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import CalibrationError, DataError
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.devices import Frame
from fpplab.devices.rig import DepthSection, Mounted, Rig
from fpplab.diagnosis import Diagnosis, UselessScanError, Verdict, diagnose_scan
from fpplab.diagnosis.record import save_diagnosis
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import FilterRules, GreyLevels, Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.response import Response
from fpplab.patterns.response_fit import GreyLevelImages, fit_greys, pixels_of_regions, statistics
from fpplab.phase import Decoded, check_unwrapping, decode
from fpplab.phase.bounds import widest
from fpplab.plan_check import check_plan_fit
from fpplab.reconstruction.depth_range import DepthRange, depth_bounds, first_stated
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.uncertainty import coordinate_noise, with_uncertainty
from fpplab.sessions.lock import only_writer
from fpplab.sessions.origin import calibration_origin, record_origin
from fpplab.sessions.session import PLAN, RIG, Session, need_space_for_frames
from fpplab.targets import Target

DECODED, CLOUD, CALIBRATION, REPORT = "decoded.npz", "cloud.ply", "calibration.yaml", "report.html"
"""Names of the results inside a session."""


def take(
    rig: Rig,
    plan: Plan,
    out: Path,
    mount: Mounted | None = None,
    *,
    force: bool = False,
    complete_too: bool = False,
    bring: Callable[[], object] | None = None,
    progress: Progress = no_progress,
    observe_frame: FrameObserver = ignore,
) -> Session:
    """Acquire a plan on an open rig, or complete an interrupted session.

    Where the stage cannot go nothing is replaced.

    Parameters
    ----------
    rig : Rig
        Open.
    plan : Plan
        What to project and capture.
    out : path
        Folder of the session.
    mount : tuple of str and int, optional
        Item and pose that the rig's fixture puts up first.
    force : bool
        Whether a session that is there already is replaced.
    complete_too : bool
        Whether a session that is complete is left as it is, instead of refused.
    bring : callable, optional
        Puts up the item, in place of the fixture's own poses by number.
    progress : callable
        Told the share of the frames that are on disk, 0 … 1.
    observe_frame : callable
        Given every frame once it is on disk.

    Returns
    -------
    Session
        Complete.

    Raises
    ------
    ConfigError
        The output exists, or the rig lacks what the plan or the item needs.
    DeviceError
        A device failed; the frames until then are kept.
    DataError
        The session there is of another plan, rig or item, another process writes into it, or the disk is
        full.
    """
    if plan.stage_mm is not None:
        rig.need_stage(plan.stage_mm)
    with only_writer(out):
        check_space(rig, plan, [out], force)
        session = Session.resume(out, plan, rig.described(mount), force, complete_too)
        record_origin(out, rig)
        if plan.stage_mm is not None and session.missing():
            rig.place_stage(plan.stage_mm)
        if mount is not None and session.missing():
            fixture = rig.need_fixture(f"mounting the {mount[0]}")
            bring() if bring else fixture.mount(*mount)

        def seen(frame: Frame) -> None:
            progress(1.0 - len(session.missing()) / plan.images)
            observe_frame(frame)

        acquire(rig, plan, session, seen)
    return session


def check_space(rig: Rig, plan: Plan, paths: Sequence[Path], force: bool) -> None:
    """Refuse sessions that do not fit on the disk, before anything is projected or written.

    Parameters
    ----------
    rig : Rig
        Open.
    plan : Plan
        What each session records.
    paths : sequence of path
        Folders of the sessions.
    force : bool
        Whether sessions that are there already are replaced.

    Raises
    ------
    DataError
        Names what the frames need, what is free, and the folder.
    """
    bits = rig.camera_settings(plan.exposure_s, plan.bits).bits
    need_space_for_frames(paths, plan, rig.camera.caps.size, bits, force)


def decode_session(
    session: Session, progress: Progress = no_progress, *, as_recorded: bool = False
) -> Decoded:
    """Find the projector coordinates of every camera pixel of a session.

    Parameters
    ----------
    session : Session
        A complete one.
    progress : callable
        Told the share done, 0 … 1.
    as_recorded : bool
        Whether the frames are decoded even where they are out of step with the plan or another plan fits
        them better.

    Returns
    -------
    Decoded
        Maps (height, width) of float32.

    Raises
    ------
    DataError
        Frames are missing or damaged, or do not fit the plan.
    ConfigError
        The plan cannot be unwrapped.
    """
    recording = session.recording(progress=lambda share: progress(0.5 * share))
    if not as_recorded:
        _require_in_step(session, recording)
        if fault := _plan_fault(recording):
            raise DataError(f"{session.path}: {fault}; --as-recorded decodes it nevertheless")
    return decode(recording, lambda share: progress(0.5 + 0.5 * share))


def _fault_in_step(session: Session, recording: Recording) -> str | None:
    """How the frames of a session are out of step with their plan, and what to check."""
    verdict = check_synchronisation(recording)
    if verdict.in_step:
        return None
    return f"{verdict.describe()}; {IMPORTED_REMEDY if session.is_imported else remedy(recording.plan)}"


def _require_in_step(session: Session, recording: Recording) -> None:
    """Refuse frames that do not show their patterns."""
    if fault := _fault_in_step(session, recording):
        again = "" if session.is_imported else "take it again, with --force, or "
        raise DataError(f"{recording.name}: {fault}; {again}--as-recorded takes the frames as they are")


def _plan_fault(recording: Recording) -> str | None:
    """What is wrong with the plan of a recording, by its images."""
    found = check_plan_fit(recording)
    return found.fault if found else None


def doubts(session: Session) -> list[str]:
    """Look for signs that the frames of a session are not what its plan says.

    Parameters
    ----------
    session : Session
        A complete one.

    Returns
    -------
    list of str
        A sentence for each.
    """
    recording = session.recording(verify=False)
    found = check_plan_fit(recording)
    said = [_fault_in_step(session, recording), *((found.fault, found.note) if found else ())]
    return [f"{session.path}: {sentence}" for sentence in said if sentence]


def reconstruct(
    session: Session,
    calibration: Calibration,
    progress: Progress = no_progress,
    *,
    filtering: bool | None = None,
    depth_mm: tuple[float, float] | None = None,
    as_recorded: bool = False,
    maps_ready: Callable[[Decoded], object] = ignore,
) -> tuple[Decoded, Cloud]:
    """Decode, triangulate, filter, and say how well each point is known.

    Parameters
    ----------
    session : Session
        A complete one.
    calibration : Calibration
        Of the rig that took it.
    progress : callable
        Told the share done, 0 … 1.
    filtering : bool, optional
        Whether points that lie on no surface are removed; by default as the session's plan says. A plan
        without rules means the usual ones.
    depth_mm : tuple of float, optional
        Least and greatest distance from the camera in mm, in which the object lies; by default that of the
        session, see `depth_range_of`.
    as_recorded : bool
        Whether frames that are out of step with the plan are taken as they are.
    maps_ready : callable
        Given the decoded maps as soon as they are, before the points' uncertainty is computed.

    Returns
    -------
    decoded : Decoded
        Maps (height, width), which know what was removed.
    cloud : Cloud
        Points in mm in the camera's frame, with their sigmas.

    Raises
    ------
    CalibrationError
        The calibration is of another rig.
    ConfigError
        The plan cannot be unwrapped in this range of depths, or needs one and has none.
    DataError
        Frames are missing, damaged or out of step with the plan.
    UselessScanError
        No pixel has a projector coordinate, or the plan does not fit the images; it says why.
    """
    recording = _checked_recording(
        session, calibration, lambda share: progress(0.3 * share), as_recorded=as_recorded
    )
    depth = depth_range_of(session, depth_mm)
    return _reconstruct(
        *(recording, calibration, depth, lambda share: progress(0.3 + 0.7 * share)),
        filtering=filtering,
        maps_ready=maps_ready,
    )


def _checked_recording(
    session: Session, calibration: Calibration, progress: Progress, *, as_recorded: bool = False
) -> Recording:
    """Read the frames of a session of the calibration's rig, in step with their plan."""
    calibration.check_camera(session.format[:2], session.path)
    calibration.check_projector(*session.projector(), session.path)
    recording = session.recording(progress=progress)
    if not as_recorded:
        _require_in_step(session, recording)
    return recording


def _reconstruct(
    recording: Recording,
    calibration: Calibration,
    depth: DepthRange | None,
    progress: Progress,
    *,
    filtering: bool | None = None,
    maps_ready: Callable[[Decoded], object] = ignore,
) -> tuple[Decoded, Cloud]:
    """Reconstruct frames; see `reconstruct`."""
    plan = recording.plan
    bounds = depth_bounds(plan, calibration, depth)
    decoded = decode(recording, lambda share: progress(0.4 * share), bounds)
    if filtering is not None:
        plan = plan.model_copy(update={"filter": (plan.filter or FilterRules()) if filtering else None})
    if not decoded.valid.any():
        maps_ready(decoded)
        raise UselessScanError(recording.name, diagnose_scan(recording, decoded, None, calibration))
    try:
        decoded, cloud = points_of(decoded, calibration, plan, recording.mean_image())
    except DataError as error:
        diagnosis = diagnose_scan(recording, decoded, None, calibration)
        if not diagnosis.findings:
            raise
        maps_ready(decoded)
        raise UselessScanError(recording.name, diagnosis) from error
    maps_ready(decoded)
    noise = coordinate_noise(decoded)
    return decoded, with_uncertainty(cloud, calibration, noise, lambda share: progress(0.6 + 0.4 * share))


def plan_with_depth(plan: Plan, depth_mm: tuple[float, float] | None) -> Plan:
    """Give a plan another range of depths.

    Parameters
    ----------
    plan : Plan
        The plan.
    depth_mm : tuple of float, or None
        The range in mm; None leaves the plan as it is.

    Returns
    -------
    Plan
        The plan with the range.

    Raises
    ------
    ConfigError
        The range is not one of two rising positive numbers.
    """
    if depth_mm is None:
        return plan
    return config.validate({**config.plain(plan), "depth_mm": list(depth_mm)}, Plan, "--depth")


def depth_range_of(session: Session, given_mm: DepthInterval | None = None) -> DepthRange | None:
    """Give the range of depths that a session is reconstructed with.

    Parameters
    ----------
    session : Session
        Its plan, and then its rig as recorded, may state one.
    given_mm : tuple of float, optional
        One that has precedence over both, in mm.

    Returns
    -------
    DepthRange or None
        With its source; None where there is none.

    Raises
    ------
    ConfigError
        It is none of two rising positive numbers.
    """
    plan, rig = session.plan, session.path / RIG
    recorded = {key: value for key, value in (session.rig() or {}).items() if key == "depth_mm"}
    return first_stated(
        (plan_with_depth(plan, given_mm).depth_mm if given_mm else None, "--depth"),
        (plan.depth_mm, f"{session.path / PLAN}: 'depth_mm'"),
        (config.validate(recorded, DepthSection, rig).depth_mm, f"{rig}: 'depth_mm'"),
    )


def check_plan(
    plan: Plan,
    source: str,
    calibration: Calibration,
    rig: Rig | None = None,
    given_mm: DepthInterval | None = None,
) -> None:
    """Refuse a plan that cannot be unwrapped with a calibration, before anything is projected.

    Parameters
    ----------
    plan : Plan
        The plan.
    source : str
        What it is called in the message.
    calibration : Calibration
        That it will be reconstructed with.
    rig : Rig, optional
        That it will be measured on; its file may state the range of depths.
    given_mm : tuple of float, optional
        A range of depths in mm that has precedence over the plan's, and that over the rig's.

    Raises
    ------
    ConfigError
        It cannot be unwrapped, needs a range of depths and has none, or part of it lies behind the projector.
    """
    depth = first_stated(
        (given_mm, "--depth"),
        (plan.depth_mm, f"{source}: 'depth_mm'"),
        (rig.file.depth_mm, f"{rig.source}: 'depth_mm'") if rig else (None, ""),
    )
    bounds, size = depth_bounds(plan, calibration, depth), calibration.projector.size
    check_unwrapping(plan, source, {axis: widest(bounds, axis, size) for axis in plan.axes})


def diagnose(session: Session, decoded: Decoded, cloud: Cloud, calibration: Calibration) -> Diagnosis:
    """Judge whether to believe a reconstruction.

    Parameters
    ----------
    session : Session
        What was reconstructed.
    decoded : Decoded
        Its projector coordinates.
    cloud : Cloud
        Its points.
    calibration : Calibration
        Of the rig that took it.

    Returns
    -------
    Diagnosis
        Verdict and findings.
    """
    return diagnose_scan(session.recording(verify=False), decoded, cloud, calibration)


def finish_scan(
    session: Session,
    calibration: Calibration,
    progress: Progress = no_progress,
    judged: Callable[[Decoded, Cloud, Diagnosis], object] | None = None,
) -> tuple[Decoded, Cloud]:
    """Reconstruct a complete session and leave every result in it; a cloud that is useless is not written.

    Parameters
    ----------
    session : Session
        A complete one.
    calibration : Calibration
        Of the rig that took it; a copy is left in the session.
    progress : callable
        Told the share done, 0 … 1.
    judged : callable, optional
        Given the maps, the points and the verdict on them, also where they are useless, before they are
        written.

    Returns
    -------
    decoded : Decoded
        As written to `decoded.npz`.
    cloud : Cloud
        As written to `cloud.ply`.

    Raises
    ------
    CalibrationError, DataError
        As `reconstruct`.
    UselessScanError
        Nobody should use the points; it says why.
    """
    recording = _checked_recording(session, calibration, lambda share: progress(0.3 * share))
    depth = depth_range_of(session)
    with (
        only_writer(session.path),
        ThreadPoolExecutor(1) as writer,
    ):  # the disk has time until the cloud is known
        saved: list[Future[None]] = []

        def save(maps: Decoded) -> None:
            saved.append(writer.submit(maps.save, session.path / DECODED))

        try:
            decoded, cloud = _reconstruct(
                recording, calibration, depth, lambda share: progress(0.3 + 0.7 * share), maps_ready=save
            )
        except UselessScanError as error:
            save_diagnosis(error.diagnosis, session.path)
            raise
        saved[0].result()  # a cloud is not written where its maps could not be
        verdict: Future[None] = Future()
        written = writer.submit(save_cloud, cloud, session.path / CLOUD, verdict.result)
        with _answered(verdict):
            diagnosis = diagnose_scan(recording, decoded, cloud, calibration)
            save_diagnosis(diagnosis, session.path)
            if judged is not None:
                judged(decoded, cloud, diagnosis)
            if diagnosis.verdict is Verdict.USELESS:
                (session.path / CLOUD).unlink(missing_ok=True)  # of an earlier reconstruction
            diagnosis.require_usable(str(session.path))
        written.result()
        calibration.save(session.path / CALIBRATION)
    return decoded, cloud


@contextmanager
def _answered(question: Future[None]) -> Iterator[None]:
    """Answer whoever waits: yes where the block ends, and with its error where it fails."""
    try:
        yield
    except BaseException as error:
        question.set_exception(error)
        raise
    question.set_result(None)


def scan(
    rig: Rig,
    plan: Plan,
    calibration: Calibration,
    out: Path | str,
    mount: Mounted | None = None,
    *,
    force: bool = False,
    progress: Progress = no_progress,
) -> Cloud:
    """Measure: acquire a plan on an open rig, reconstruct, and leave every result in the session.

    Parameters
    ----------
    rig : Rig
        Open.
    plan : Plan
        What to project and capture.
    calibration : Calibration
        Of the rig.
    out : path or str
        Folder of the session; an interrupted one is completed.
    mount : tuple of str and int, optional
        Item and pose that the rig's fixture puts up first.
    force : bool
        Whether a session that is there already is replaced.
    progress : callable
        Told the share done, 0 … 1.

    Returns
    -------
    Cloud
        Points in mm in the camera's frame, with their sigmas.

    Raises
    ------
    ConfigError, DeviceError, DataError
        As `take`.
    CalibrationError
        As `reconstruct`.
    """
    calibration.check_camera(rig.camera.caps.size, "calibration")
    calibration.check_projector(rig.projector.caps.size, rig.projector.caps.lattice, "calibration")
    check_plan(plan, "plan", calibration, rig)
    with only_writer(Path(out)):
        session = take(rig, plan, Path(out), mount, force=force, progress=lambda share: progress(0.8 * share))
        return finish_scan(session, calibration, lambda share: progress(0.8 + 0.2 * share))[1]


def take_poses(
    rig: Rig,
    plan: Plan,
    item: str,
    poses: int,
    folder: Path,
    force: bool,
    progress: Progress = no_progress,
    observe_frame: FrameObserver = ignore,
) -> list[Session]:
    """Take one session for each pose of a target that the rig's fixture holds.

    Parameters
    ----------
    rig : Rig
        Open, with a fixture.
    plan : Plan
        With fringes along x and y.
    item : str
        What the fixture calls the target.
    poses : int
        How many.
    folder : path
        Their folder: `pose_00`, `pose_01` … in it.
    force : bool
        Whether poses taken before are taken again; they are kept otherwise.
    progress : callable
        Told the share done, 0 … 1.
    observe_frame : callable
        Given every frame once it is on disk.

    Returns
    -------
    list of Session
        In the order of the poses.

    Raises
    ------
    ConfigError, DeviceError, DataError
        As `take`.
    """
    paths = [folder / f"pose_{pose:02d}" for pose in range(poses)]
    check_space(rig, plan, paths, force)

    def one(pose: int) -> Session:
        return take(
            rig,
            plan,
            paths[pose],
            (item, pose),
            force=force,
            complete_too=True,
            progress=lambda share: progress((pose + share) / poses),
            observe_frame=observe_frame,
        )

    return [one(pose) for pose in range(poses)]


def characterise_sessions(
    sessions: Sequence[Session],
    target: Target,
    progress: Progress = no_progress,
    *,
    level: DistortionModel | Literal["auto"] = "auto",
    refine_board: bool | None = None,
) -> Characterisation:
    """Find camera, projector and the pose between them from one session for each pose of a target.

    A pose in which the target is not found, or whose frames are out of step with the plan, is left out and
    named, as long as enough remain.

    Parameters
    ----------
    sessions : sequence of Session
        Complete, of one plan and format.
    target : Target
        The board.
    progress : callable
        Told the share done, 0 … 1.
    level : DistortionModel or str
        Which distortion is fitted; `auto` takes k3 and gives the errors of all.
    refine_board : bool, optional
        Whether the board's shape is fitted too; by default it is.

    Returns
    -------
    Characterisation
        The calibration, and how well it is known.

    Raises
    ------
    CalibrationError
        Too few poses remain, or the models do not fit.
    """
    require_plan_fits(sessions[0])
    size, lattice = sessions[0].projector()
    observations, left_out = _observe_sessions(sessions, target, lambda share: progress(0.8 * share))
    width, height, _ = sessions[0].format
    result = characterise(
        observations,
        target,
        (width, height),
        size,
        lattice,
        left_out=left_out,
        level=level,
        refine_board=refine_board,
    )
    progress(1.0)
    return replace(result, calibration=replace(result.calibration, origin=calibration_origin(sessions)))


def require_plan_fits(session: Session) -> None:
    """Refuse a plan that does not describe the images, before many poses are decoded by it.

    Parameters
    ----------
    session : Session
        A complete one.

    Raises
    ------
    CalibrationError
        Another plan fits the images far better.
    """
    if fault := _plan_fault(session.recording(verify=False)):
        raise CalibrationError(f"{session.path}: {fault}")


def judge_sessions(
    sessions: Sequence[Session],
    calibration: Calibration,
    source: Path | str,
    progress: Progress = no_progress,
) -> Judgement:
    """Judge a calibration by poses of its board that it was not fitted to, one session each.

    Parameters
    ----------
    sessions : sequence of Session
        Complete, of one plan and format.
    calibration : Calibration
        With its board.
    source : Path or str
        Name of the calibration, for errors.
    progress : callable
        Told the share done, 0 … 1.

    Returns
    -------
    Judgement
        Errors in these poses beside those predicted.

    Raises
    ------
    CalibrationError
        The calibration is for another camera or projector, does not say what its board was, or the board is
        found in no pose.
    """
    board = judged_board(calibration, str(source))
    width, height, _ = sessions[0].format
    calibration.check_camera((width, height), sessions[0].path)
    calibration.check_projector(*sessions[0].projector(), sessions[0].path)
    target = config.validate(board.target, Target, f"{source}: board.target")
    observations, left_out = _observe_sessions(sessions, target, progress)
    return judge(calibration, observations, left_out, str(source))


def _observe_sessions(
    sessions: Sequence[Session], target: Target, progress: Progress
) -> tuple[list[Observation], dict[str, str]]:
    """What each pose tells, and by name why others tell nothing."""
    periods = finest_periods(sessions[0].plan, sessions[0].projector()[0])
    observations: list[Observation] = []
    left_out: dict[str, str] = {}
    for k, session in enumerate(sessions):
        try:
            observations.append(observe_session(session, target, periods))
        except CalibrationError as error:
            left_out[session.path.name] = str(error)
        progress((k + 1) / len(sessions))
    return observations, left_out


def observe_session(session: Session, target: Target, periods: tuple[float, float]) -> Observation:
    """Find a board in one pose, and its points in camera and projector.

    Parameters
    ----------
    session : Session
        A complete one.
    target : Target
        The board.
    periods : tuple of float
        Of the finest fringes, from `finest_periods`.

    Returns
    -------
    Observation
        What the pose tells.

    Raises
    ------
    CalibrationError
        It tells nothing: the message names the pose, and says why.
    """
    name, recording = session.path.name, session.recording()
    if fault := _fault_in_step(session, recording):
        raise CalibrationError(f"{name}: {fault}; take this pose again")
    return observe(name, recording.mean_image(), decode(recording), target, periods)


def measure_response(
    rig: Rig,
    exposure_s: float,
    greys: GreyLevels | None = None,
    progress: Progress = no_progress,
    observe_frame: Callable[[int, Frame], object] = lambda level, frame: None,
) -> tuple[Response, Floats]:
    """Show uniform grey-level images and fit the response.

    They are shown from black to white and back, `repeats` times in all, so that a lamp that drifts does not
    pass for a response; before them one frame with the projector off.

    Parameters
    ----------
    rig : Rig
        Open, looking at an evenly white surface.
    exposure_s : float
        Exposure in s.
    greys : GreyLevels, optional
        How many levels, how often.
    progress : callable
        Told the share done, 0 … 1.
    observe_frame : callable
        Given every grey level that was shown, 0 … 255, with its frame.

    Returns
    -------
    response : Response
        The fit.
    levels : ndarray of float64, (K, 2)
        The levels fitted, in and out, in [0, 1].

    Raises
    ------
    CalibrationError
        The levels do not rise, or are saturated.
    DeviceError
        A device failed.
    """
    wanted = greys or GreyLevels()
    settings = rig.camera_settings(exposure_s)
    patterns = uniform_patterns(wanted.shown, rig.projector.caps.size)
    dark = _dark_frame(rig, exposure_s)
    seen = np.empty((wanted.repeats, len(patterns), *statistics(dark.image, dark.settings.bits).shape))
    for repeat in range(wanted.repeats):
        order = range(len(patterns))[:: 1 if repeat % 2 == 0 else -1]
        with closing(expose(rig, [patterns[i] for i in order], settings)) as shots:
            for done, (i, frame) in enumerate(zip(order, shots, strict=True), 1):
                seen[repeat, i] = statistics(frame.image, frame.settings.bits)
                observe_frame(wanted.shown[i], frame)
                progress((repeat + done / len(patterns)) / wanted.repeats)
    response = fit_greys(
        GreyLevelImages(
            shown=np.array(wanted.shown) / 255.0,
            seen=seen,
            dark=statistics(dark.image, dark.settings.bits),
            pixels=pixels_of_regions(dark.image),
            bits=dark.settings.bits,
        )
    )
    return response, np.array([(level.shown, level.seen) for level in response.measured])


def _dark_frame(rig: Rig, exposure_s: float) -> Frame:
    """A frame with the projector off: the camera's black level, and the light of the room."""
    rig.camera.configure(rig.camera_settings(exposure_s))
    rig.make_dark()
    return rig.camera.snap()
