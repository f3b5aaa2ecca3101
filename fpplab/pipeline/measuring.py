"""Points from a session, with the verdict on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace

import numpy as np

from fpplab.calibration.model import PARAMETERS, Calibration
from fpplab.clouds import Cloud, save_cloud
from fpplab.core.blas import one_blas_thread
from fpplab.core.checksums import write_recorded
from fpplab.core.conventions import Axis
from fpplab.core.depth import DepthInterval, DepthRange
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.core.session_names import CALIBRATION, CLOUD, DECODED
from fpplab.diagnosis import Diagnosis, UselessScanError, diagnose_scan
from fpplab.diagnosis.geometry import MarksVerdict
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.diagnosis.record import save_diagnosis
from fpplab.patterns.plan import FilterRules
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, PointingDrift, decode
from fpplab.pipeline.decoding import checked_recording, plan_fault
from fpplab.pipeline.geometry import geometry_check
from fpplab.reconstruction.depth_range import KnownPixels, decoding_bounds
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.triangulation import coordinate_noise
from fpplab.reconstruction.uncertainty import with_uncertainty
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.log import begin_session_log
from fpplab.sessions.session import Session


def triangulate_recording(
    recording: Recording,
    calibration: Calibration,
    filtering: bool | None,
    progress: Progress,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> tuple[Decoded, Cloud | Diagnosis]:
    """Decode and triangulate; `filtering` replaces what the plan says of its filter."""
    plan = recording.plan
    bounds = decoding_bounds(plan, calibration, recording.depth)
    try:
        decoded = decode(recording, lambda share: progress(0.3 + 0.28 * share), bounds)
    except ConfigError as error:
        if fault := plan_fault(recording):
            raise DataError(f"{recording.name}: {fault}") from error
        raise
    if filtering is not None:
        plan = plan.model_copy(update={"filter": (plan.filter or FilterRules()) if filtering else None})
    placed = decoded.of_known_order()
    if not placed.valid.any():
        return decoded, diagnose_scan(recording, decoded, None, calibration, limits=limits)
    try:
        decoded, cloud = points_of(placed, calibration, plan, recording.mean_image())
        return decoded, _coloured(cloud, recording, calibration)
    except DataError:
        diagnosis = diagnose_scan(recording, decoded, None, calibration, limits=limits)
        if not diagnosis.findings:
            raise
        return decoded, diagnosis


def _coloured(cloud: Cloud, recording: Recording, calibration: Calibration) -> Cloud:
    """Add the part's colours where the camera sees any, beside those of the board where it is known."""
    assert cloud.pixels is not None
    colours = recording.colours(cloud.pixels)
    if colours is None:
        return cloud
    levels = colours / (calibration.white or (1.0, 1.0, 1.0))
    return replace(cloud, rgb=np.rint(np.clip(levels, 0.0, 255.0)).astype(np.uint8))


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Points of a session, and whether to believe them."""

    session: Session
    calibration: Calibration
    depth: DepthRange | None  # range of depths that counted; None where none is stated
    decoded: Decoded | None  # maps (height, width), which know what was removed; None without points
    cloud: Cloud | None  # points with their sigmas; None where no pixel gives one
    diagnosis: Diagnosis


@one_blas_thread()
def reconstruct_points(
    session: Session, calibration: Calibration, *, as_recorded: bool = False
) -> tuple[Decoded, Cloud]:
    """Decode, triangulate, filter, and compute uncertainties, without judging the result."""
    # A session without a single point is a `UselessScanError`, which says why.
    recording = checked_recording(session, calibration, None, no_progress, as_recorded=as_recorded)
    decoded, points = triangulate_recording(recording, calibration, None, no_progress)
    if isinstance(points, Diagnosis):
        raise UselessScanError(recording.name, points)
    return decoded, _with_sigmas(recording, decoded, points, calibration, no_progress)[0]


@one_blas_thread()
def reconstruct_session(
    session: Session,
    calibration: Calibration,
    progress: Progress = no_progress,
    *,
    filtering: bool | None = None,
    depth_mm: DepthInterval | None = None,
    as_recorded: bool = False,
    known_mm: KnownPixels = (),
    observe_maps: Callable[[Decoded], object] = ignore,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> Reconstruction:
    """Reconstruct a session and judge the result; nothing is written."""
    recording = checked_recording(
        session, calibration, depth_mm, progress, as_recorded=as_recorded, known_mm=known_mm
    )
    decoded, points = triangulate_recording(recording, calibration, filtering, progress, limits)
    observe_maps(decoded)
    if isinstance(points, Diagnosis):
        return Reconstruction(session, calibration, recording.depth, None, None, points)
    cloud, marks = _with_sigmas(recording, decoded, points, calibration, progress)
    diagnosis = _judge(session, recording, decoded, cloud, calibration, marks, limits)
    return Reconstruction(session, calibration, recording.depth, decoded, cloud, diagnosis)


@one_blas_thread()
def finish_scan(
    session: Session,
    calibration: Calibration,
    progress: Progress = no_progress,
    *,
    depth_mm: DepthInterval | None = None,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> Reconstruction:
    """Reconstruct a complete session and leave every result in it; a useless cloud is not written."""
    recording = checked_recording(session, calibration, depth_mm, progress)
    with (
        exclusive_write(session.path),
        ThreadPoolExecutor(1) as writer,
    ):  # the disk has time until the cloud is known
        begin_session_log(session.path)
        decoded, points = triangulate_recording(recording, calibration, None, progress, limits)
        saved_maps = writer.submit(decoded.save, session.path / DECODED)
        if isinstance(points, Diagnosis):
            saved_maps.result()
            save_diagnosis(points, session.path)
            return Reconstruction(session, calibration, recording.depth, None, None, points)
        cloud, marks = _with_sigmas(recording, decoded, points, calibration, progress)
        saved_maps.result()  # a cloud is not written where its maps could not be
        verdict: Future[Diagnosis] = Future()
        saved_cloud = writer.submit(
            save_cloud,
            cloud,
            session.path / CLOUD,
            lambda: verdict.result().require_usable(str(session.path)),
        )
        try:
            diagnosis = _judge(session, recording, decoded, cloud, calibration, marks, limits)
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
    return Reconstruction(session, calibration, recording.depth, decoded, cloud, diagnosis)


def _judge(
    session: Session,
    recording: Recording,
    decoded: Decoded,
    cloud: Cloud,
    calibration: Calibration,
    marks: MarksVerdict | None,
    limits: DiagnosisLimits,
) -> Diagnosis:
    geometry = geometry_check(session, decoded, cloud, calibration, marks, limits)
    return diagnose_scan(recording, decoded, cloud, calibration, geometry=geometry, limits=limits)


def widened_by_drift(calibration: Calibration, drifts: Mapping[Axis, PointingDrift]) -> Calibration:
    """Add to the uncertainty by how much the projector's picture walked since the first frame."""
    uncertainty = calibration.uncertainty
    if uncertainty is None or not drifts:
        return calibration
    variances = np.zeros(len(PARAMETERS))
    for axis, drift in drifts.items():
        variances[PARAMETERS.index(f"projector.c{axis}")] = drift.shift_px**2
    return replace(calibration, uncertainty=uncertainty.widened(np.diag(variances)))


def _with_sigmas(
    recording: Recording, decoded: Decoded, cloud: Cloud, calibration: Calibration, progress: Progress
) -> tuple[Cloud, MarksVerdict | None]:
    at_scan, noise, marks = calibration, coordinate_noise(decoded), None
    if calibration.marks is not None:
        from fpplab.pipeline.marks import compare_marks_in, marks_verdict, widened_by_marks

        compared = compare_marks_in(recording, decoded, calibration, calibration.marks)
        at_scan = widened_by_marks(calibration, compared)
        marks = marks_verdict(compared, cloud, noise, calibration)
    at_scan = widened_by_drift(at_scan, decoded.drifts)
    return with_uncertainty(cloud, at_scan, noise, lambda share: progress(0.72 + 0.28 * share)), marks
