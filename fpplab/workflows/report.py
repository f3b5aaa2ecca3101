"""Compare several scans on one page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fpplab.calibration.model import Calibration, CalibrationFile
from fpplab.clouds import Cloud, load_cloud
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import check_new_file
from fpplab.core.session_names import CALIBRATION, CLOUD, DECODED, JOURNAL
from fpplab.diagnosis import Diagnosis, diagnose_scan
from fpplab.diagnosis.record import load_diagnosis
from fpplab.phase import Decoded
from fpplab.pipeline.geometry import geometry_check
from fpplab.pipeline.marks import compare_marks_in, marks_verdict
from fpplab.reconstruction.triangulation import coordinate_noise
from fpplab.report.several_scans import write_scans_report
from fpplab.results.observer import Observer
from fpplab.results.provenance import cloud_provenance, local_time, session_provenance
from fpplab.results.several_scans import CloudDifference, ScanRecord, ScansResult
from fpplab.sessions.session import Session

MAX_SCANS = 8  # most scans of a page (chosen): more would not fit into one that can be mailed


@dataclass(frozen=True)
class ScansRequest:
    """Which scans to compare, and where the page goes."""

    scans: tuple[Path, ...]  # sessions or clouds, two or more
    out: Path
    force: bool = False  # whether an existing file is replaced


def run_scans_report(request: ScansRequest, observer: Observer | None = None) -> ScansResult:
    """Read several scans, subtract the first from each other one, and write the page."""
    observer = observer or Observer()
    check_new_file(request.out, request.force, ".html")
    count = len(request.scans)
    if not 2 <= count <= MAX_SCANS:
        raise ConfigError(f"{count} scans are given; a page compares 2 to {MAX_SCANS}")
    records = []
    with observer.stage("Reading the scans") as progress:
        for path, name in zip(request.scans, short_names(request.scans), strict=True):
            records.append(read_scan(path, name))
            progress(len(records) / count)
    with observer.stage("Drawing"):
        differences = tuple(subtract_clouds(record, records[0]) for record in records[1:])
        result = ScansResult(tuple(records), differences, request.out)
        write_scans_report(request.out, result)
    return result


def read_scan(path: Path, name: str) -> ScanRecord:
    """Read what a session or a cloud says about a scan."""
    # Where a session records no verdict, it is given now.
    folder = path if path.is_dir() else path.parent
    if not path.exists():
        raise ConfigError(f"{path}: there is no such session or cloud")
    stored = folder / CALIBRATION
    calibration = Calibration.load(stored) if stored.is_file() else None
    if not path.is_dir():
        is_session = path.name == CLOUD and (folder / JOURNAL).is_file()
        recorded = load_diagnosis(folder) if is_session else None
        verdict = recorded.diagnosis() if recorded else None
        provenance = cloud_provenance(path, calibration)
        return ScanRecord(name, provenance, load_cloud(path), calibration, verdict, None)
    session = Session.open(path)
    if session.missing():
        raise DataError(f"{path}: {len(session.missing())} frames are missing; complete the scan first")
    cloud = load_cloud(path / CLOUD) if (path / CLOUD).is_file() else None
    diagnosis, judged_at = _diagnosis(session, cloud, calibration)
    source = session_provenance(session, calibration).with_values(judged=judged_at)
    recording = session.recording(verify=False)
    frame = recording.typical_frame, recording.bits
    return ScanRecord(name, source, cloud, calibration, diagnosis, frame, session.plan)


def _diagnosis(
    session: Session, cloud: Cloud | None, calibration: Calibration | None
) -> tuple[Diagnosis | None, str | None]:
    """The verdict as recorded, or given now; and when."""
    if recorded := load_diagnosis(session.path):
        return recorded.diagnosis(), f"{local_time(recorded.made)}, fpplab {recorded.version}"
    if cloud is None or calibration is None or not (session.path / DECODED).is_file():
        return None, None
    recording, decoded = session.recording(verify=False), Decoded.load(session.path / DECODED)
    marks = None
    if calibration.marks is not None:
        compared = compare_marks_in(recording, decoded, calibration, calibration.marks)
        marks = marks_verdict(compared, cloud, coordinate_noise(decoded), calibration)
    geometry = geometry_check(session, decoded, cloud, calibration, marks)
    diagnosis = diagnose_scan(recording, decoded, cloud, calibration, geometry=geometry)
    return diagnosis, "for this report"


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name scans by the last part of their paths, or by as many parts as distinguish them."""
    # The cloud of a session is called as the session.
    resolved = [(path.parent if path.name == CLOUD else path).resolve() for path in paths]
    for path in resolved:
        if resolved.count(path) > 1:
            raise ConfigError(f"{path}: is given twice; name each scan once")
    for parts in range(1, max(len(path.parts) for path in resolved) + 1):
        names = ["/".join(path.parts[-parts:]) for path in resolved]
        if len(set(names)) == len(names):
            break
    return names


def subtract_clouds(scan: ScanRecord, reference: ScanRecord) -> CloudDifference:
    """Subtract two clouds, where both were reconstructed with the same calibration."""
    names = scan.name, reference.name
    cloud, reference_cloud = scan.cloud, reference.cloud
    if cloud is None or reference_cloud is None:
        return CloudDifference(*names, None, "one of them has no points")
    if scan.calibration is None or reference.calibration is None:
        return CloudDifference(*names, None, "the calibration is not recorded")
    if not _same_geometry(scan.calibration, reference.calibration):
        return CloudDifference(*names, None, "they were reconstructed with different calibrations")
    if cloud.pixels is None or reference_cloud.pixels is None or cloud.size != reference_cloud.size:
        return CloudDifference(*names, None, "the points are not known by pixels of one camera")
    keys, reference_keys = (
        v.astype(np.int64) << 32 | u for u, v in (cloud.pixels.T, reference_cloud.pixels.T)
    )
    _, rows, others = np.intersect1d(keys, reference_keys, assume_unique=True, return_indices=True)
    if not len(rows):
        return CloudDifference(*names, None, "no pixel has a point in both")
    distances = np.full(len(cloud), np.nan, np.float32)
    far, near = (
        np.linalg.norm(c.points[k].astype(np.float64), axis=1)
        for c, k in ((cloud, rows), (reference_cloud, others))
    )
    distances[rows] = far - near
    return CloudDifference(*names, distances)


def _same_geometry(a: Calibration, b: Calibration) -> bool:
    files = [CalibrationFile.of(calibration) for calibration in (a, b)]
    first, second = ((f.camera, f.projector, f.T_projector_camera) for f in files)
    return first == second
