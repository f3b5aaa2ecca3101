"""Points from a session, with the verdict on them, and whole scans."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud, save_cloud
from fpplab.core.checksums import write_recorded
from fpplab.core.errors import DataError
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.core.session_names import CALIBRATION, CLOUD, DECODED
from fpplab.devices.rig import Mounted, Rig
from fpplab.diagnosis import Diagnosis, UselessScanError, Verdict, diagnose_scan
from fpplab.diagnosis.record import save_diagnosis
from fpplab.patterns.plan import FilterRules, Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.pipeline.checking import require_in_step
from fpplab.pipeline.depth import check_plan, depth_range_of
from fpplab.pipeline.taking import take
from fpplab.reconstruction.depth_range import DepthRange, depth_bounds
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.uncertainty import coordinate_noise, with_uncertainty
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.log import begin_session_log
from fpplab.sessions.origin import foreign_calibration
from fpplab.sessions.session import Session


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
        require_in_step(session, recording)
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


def diagnose(session: Session, decoded: Decoded, cloud: Cloud, calibration: Calibration) -> Diagnosis:
    """Judge whether to believe a reconstruction."""
    foreign = foreign_calibration(calibration, session)
    return diagnose_scan(session.recording(verify=False), decoded, cloud, calibration, foreign=foreign)


def finish_scan(
    session: Session,
    calibration: Calibration,
    progress: Progress = no_progress,
    judged: Callable[[Decoded, Cloud, Diagnosis], object] | None = None,
) -> tuple[Decoded, Cloud]:
    """Reconstruct a complete session and leave every result in it; a cloud that is useless is not written."""
    recording = _checked_recording(session, calibration, lambda share: progress(0.3 * share))
    depth = depth_range_of(session)
    with (
        exclusive_write(session.path),
        ThreadPoolExecutor(1) as writer,
    ):  # the disk has time until the cloud is known
        begin_session_log(session.path)
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
            foreign = foreign_calibration(calibration, session)
            diagnosis = diagnose_scan(recording, decoded, cloud, calibration, foreign=foreign)
            save_diagnosis(diagnosis, session.path)
            if judged is not None:
                judged(decoded, cloud, diagnosis)
            if diagnosis.verdict is Verdict.USELESS:
                (session.path / CLOUD).unlink(missing_ok=True)  # of an earlier reconstruction
            diagnosis.require_usable(str(session.path))
        written.result()
        write_recorded(session.path / CALIBRATION, calibration.to_yaml(CALIBRATION))
        session.check_kept()
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
    with exclusive_write(Path(out)):
        session = take(rig, plan, Path(out), mount, force=force, progress=lambda share: progress(0.8 * share))
        return finish_scan(session, calibration, lambda share: progress(0.8 + 0.2 * share))[1]
