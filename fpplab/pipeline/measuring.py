"""Points from a session, with the verdict on them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud, save_cloud
from fpplab.core.checksums import write_recorded
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import DataError
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.core.session_names import CALIBRATION, CLOUD, DECODED
from fpplab.diagnosis import Diagnosis, UselessScanError, diagnose_scan
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.diagnosis.record import save_diagnosis
from fpplab.patterns.plan import FilterRules
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.pipeline.checking import require_in_step
from fpplab.pipeline.depth import depth_range_of
from fpplab.reconstruction.depth_range import DepthRange, depth_bounds
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.uncertainty import coordinate_noise, with_uncertainty
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.log import begin_session_log
from fpplab.sessions.origin import foreign_calibration
from fpplab.sessions.session import Session


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Points of a session, and whether to believe them."""

    session: Session
    calibration: Calibration
    depth: DepthRange | None  # range of depths that counted; None where none is stated
    decoded: Decoded | None  # maps (height, width), which know what was removed; None without points
    cloud: Cloud | None  # points with their sigmas; None where no pixel gives one
    diagnosis: Diagnosis


@dataclass(frozen=True, eq=False)
class _Triangulation:
    """Maps of a recording, and its points without uncertainty, or why there are none."""

    decoded: Decoded
    points: Cloud | Diagnosis


def reconstruct_points(
    session: Session,
    calibration: Calibration,
    progress: Progress = no_progress,
    *,
    filtering: bool | None = None,
    depth_mm: DepthInterval | None = None,
    as_recorded: bool = False,
) -> tuple[Decoded, Cloud]:
    """Decode, triangulate, filter, and compute uncertainties, without judging the result.

    A session without a single point is a `UselessScanError`, which says why.
    """
    depth = depth_range_of(session, depth_mm)
    recording = _checked_recording(session, calibration, progress, as_recorded=as_recorded)
    triangulated = _triangulate(recording, calibration, depth, filtering, progress)
    if isinstance(triangulated.points, Diagnosis):
        raise UselessScanError(recording.name, triangulated.points)
    return triangulated.decoded, _with_sigmas(
        triangulated.decoded, triangulated.points, calibration, progress
    )


def reconstruct_session(
    session: Session,
    calibration: Calibration,
    progress: Progress = no_progress,
    *,
    filtering: bool | None = None,
    depth_mm: DepthInterval | None = None,
    as_recorded: bool = False,
    observe_maps: Callable[[Decoded], object] = ignore,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> Reconstruction:
    """Reconstruct a session and judge the result; nothing is written."""
    depth = depth_range_of(session, depth_mm)
    recording = _checked_recording(session, calibration, progress, as_recorded=as_recorded)
    triangulated = _triangulate(recording, calibration, depth, filtering, progress, limits)
    observe_maps(triangulated.decoded)
    if isinstance(triangulated.points, Diagnosis):
        return Reconstruction(session, calibration, depth, None, None, triangulated.points)
    cloud = _with_sigmas(triangulated.decoded, triangulated.points, calibration, progress)
    diagnosis = diagnose(session, triangulated.decoded, cloud, calibration, limits)
    return Reconstruction(session, calibration, depth, triangulated.decoded, cloud, diagnosis)


def finish_scan(
    session: Session,
    calibration: Calibration,
    progress: Progress = no_progress,
    *,
    depth_mm: DepthInterval | None = None,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> Reconstruction:
    """Reconstruct a complete session and leave every result in it; a useless cloud is not written."""
    depth = depth_range_of(session, depth_mm)
    recording = _checked_recording(session, calibration, progress)
    with (
        exclusive_write(session.path),
        ThreadPoolExecutor(1) as writer,
    ):  # the disk has time until the cloud is known
        begin_session_log(session.path)
        triangulated = _triangulate(recording, calibration, depth, None, progress, limits)
        saved_maps = writer.submit(triangulated.decoded.save, session.path / DECODED)
        if isinstance(triangulated.points, Diagnosis):
            saved_maps.result()
            save_diagnosis(triangulated.points, session.path)
            return Reconstruction(session, calibration, depth, None, None, triangulated.points)
        cloud = _with_sigmas(triangulated.decoded, triangulated.points, calibration, progress)
        saved_maps.result()  # a cloud is not written where its maps could not be
        verdict: Future[Diagnosis] = Future()
        saved_cloud = writer.submit(
            save_cloud,
            cloud,
            session.path / CLOUD,
            lambda: verdict.result().require_usable(str(session.path)),
        )
        try:
            diagnosis = diagnose(session, triangulated.decoded, cloud, calibration, limits)
            save_diagnosis(diagnosis, session.path)
        except BaseException as error:
            verdict.set_exception(error)  # the writer waits for it
            raise
        verdict.set_result(diagnosis)
        if diagnosis.is_useless:
            wait([saved_cloud])
            (session.path / CLOUD).unlink(missing_ok=True)  # of an earlier reconstruction
        else:
            saved_cloud.result()
            write_recorded(session.path / CALIBRATION, calibration.to_yaml(CALIBRATION))
            session.check_kept()
    return Reconstruction(session, calibration, depth, triangulated.decoded, cloud, diagnosis)


def diagnose(
    session: Session,
    decoded: Decoded,
    cloud: Cloud,
    calibration: Calibration,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> Diagnosis:
    """Judge whether to believe a reconstruction."""
    foreign = foreign_calibration(calibration, session)
    recording = session.recording(verify=False)
    return diagnose_scan(recording, decoded, cloud, calibration, foreign=foreign, limits=limits)


def _checked_recording(
    session: Session, calibration: Calibration, progress: Progress, *, as_recorded: bool = False
) -> Recording:
    """Read the frames of a session of the calibration's rig, in step with their plan."""
    calibration.check_camera(session.format[:2], session.path)
    calibration.check_projector(*session.projector(), session.path)
    recording = session.recording(progress=lambda share: progress(0.3 * share))
    if not as_recorded:
        require_in_step(session, recording)
    return recording


def _triangulate(
    recording: Recording,
    calibration: Calibration,
    depth: DepthRange | None,
    filtering: bool | None,
    progress: Progress,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> _Triangulation:
    """Decode and triangulate; `filtering` replaces what the plan says of its filter."""
    plan = recording.plan
    bounds = depth_bounds(plan, calibration, depth)
    decoded = decode(recording, lambda share: progress(0.3 + 0.28 * share), bounds)
    if filtering is not None:
        plan = plan.model_copy(update={"filter": (plan.filter or FilterRules()) if filtering else None})
    if not decoded.valid.any():
        return _Triangulation(decoded, diagnose_scan(recording, decoded, None, calibration, limits=limits))
    try:
        return _Triangulation(*points_of(decoded, calibration, plan, recording.mean_image()))
    except DataError:
        diagnosis = diagnose_scan(recording, decoded, None, calibration, limits=limits)
        if not diagnosis.findings:
            raise
        return _Triangulation(decoded, diagnosis)


def _with_sigmas(decoded: Decoded, cloud: Cloud, calibration: Calibration, progress: Progress) -> Cloud:
    noise = coordinate_noise(decoded)
    return with_uncertainty(cloud, calibration, noise, lambda share: progress(0.72 + 0.28 * share))
