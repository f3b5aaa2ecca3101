"""One page for several scans: verdicts, figures side by side, and what differs in their provenance."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration, CalibrationFile
from fpplab.clouds import Cloud, load_cloud
from fpplab.core.conventions import Image
from fpplab.core.drawing import value_range
from fpplab.core.errors import ConfigError, DataError
from fpplab.diagnosis import Diagnosis
from fpplab.diagnosis.record import load_diagnosis
from fpplab.phase import Decoded
from fpplab.pipeline import CALIBRATION, CLOUD, DECODED, diagnose
from fpplab.report import figures
from fpplab.report.cloud_view import MOST_POINTS, cloud_view
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportFigure, ReportSection, ReportTable
from fpplab.report.scan_section import ROUGHNESS, noise_um, roughness_um
from fpplab.report.wording import NOT_KNOWN, count_words, number_words
from fpplab.results.provenance import Provenance, cloud_provenance, local_time, session_provenance
from fpplab.sessions.session import JOURNAL, Session

MOST_SCANS = 8
"""More would not fit into a page that can be mailed."""


@dataclass(frozen=True, eq=False)
class ScanRecord:
    """What is recorded of one scan."""

    name: str  # on the page
    provenance: Provenance  # where it comes from
    cloud: Cloud | None  # its points; None where there are none
    calibration: Calibration | None  # that it was reconstructed with, where it is recorded
    diagnosis: Diagnosis | None  # whether to believe it, where that is recorded or can be found out
    frame: tuple[Image, int] | None  # A frame of the finest fringes and its bit depth; None for a cloud alone

    def verdict(self) -> PageVerdict:
        """Say whether to believe the scan, with a small picture of it."""
        picture = base64.b64encode(figures.thumbnail(self.cloud)).decode("ascii") if self.cloud else ""
        if self.diagnosis is not None:
            return replace(PageVerdict.of(self.diagnosis, self.name), thumbnail=picture)
        if self.cloud is None:
            return PageVerdict(self.name, "none", "Not reconstructed", "The session holds no cloud.")
        said = "A cloud alone does not tell; give its session."
        return PageVerdict(self.name, "none", "Not judged", said, thumbnail=picture)

    def summary(self) -> dict[str, Any]:
        """Collect the figures for JSON."""
        judged = self.diagnosis.summary() if self.diagnosis else {"verdict": None}
        cloud = self.cloud
        return {
            "name": self.name,
            **judged,
            "points": len(cloud) if cloud else 0,
            "roughness_um": roughness_um(cloud) if cloud else None,
            "noise_um": noise_um(cloud) if cloud else None,
        }


@dataclass(frozen=True, eq=False)
class CloudDifference:
    """How far two clouds of one calibration are apart, along the camera's rays."""

    scan: str  # names of the two
    reference: str  # names of the two
    distances_mm: NDArray[np.float32] | None  # (N,) for every point of the scan
    reason: str = ""  # why not

    def summary(self) -> dict[str, Any]:
        """Collect the figures for JSON."""
        names = {"scan": self.scan, "reference": self.reference}
        if self.distances_mm is None:
            return {**names, "not_compared": self.reason}
        known = 1e3 * self.distances_mm[np.isfinite(self.distances_mm)].astype(np.float64)
        return {
            **names,
            "pixels": len(known),
            "median_um": float(np.median(known)),
            "rms_um": float(np.sqrt(np.mean(known**2))),
            "p95_um": float(np.percentile(np.abs(known), 95)),
        }


def read_scan(path: Path, name: str) -> ScanRecord:
    """Read what a session or a cloud tells of a scan.

    Where a session records no verdict, it is given now.
    """
    folder = path if path.is_dir() else path.parent
    if not path.exists():
        raise ConfigError(f"{path}: there is no such session or cloud")
    beside = folder / CALIBRATION
    calibration = Calibration.load(beside) if beside.is_file() else None
    if not path.is_dir():
        own = path.name == CLOUD and (folder / JOURNAL).is_file()
        judged = load_diagnosis(folder) if own else None
        source = cloud_provenance(path, calibration)
        return ScanRecord(
            name, source, load_cloud(path), calibration, judged.diagnosis() if judged else None, None
        )
    session = Session.open(path)
    if session.missing():
        raise DataError(f"{path}: {len(session.missing())} frames are missing; complete the scan first")
    cloud = load_cloud(path / CLOUD) if (path / CLOUD).is_file() else None
    diagnosis, judged_at = _diagnosis(session, cloud, calibration)
    source = session_provenance(session, calibration).with_values(judged=judged_at)
    recording = session.recording(verify=False)
    frame = recording.finest()[1][0], recording.bits
    return ScanRecord(name, source, cloud, calibration, diagnosis, frame)


def _diagnosis(
    session: Session, cloud: Cloud | None, calibration: Calibration | None
) -> tuple[Diagnosis | None, str | None]:
    """The verdict as recorded, or given now; and when."""
    if recorded := load_diagnosis(session.path):
        return recorded.diagnosis(), f"{local_time(recorded.made)}, fpplab {recorded.version}"
    if cloud is None or calibration is None or not (session.path / DECODED).is_file():
        return None, None
    found = diagnose(session, Decoded.load(session.path / DECODED), cloud, calibration)
    return found, "for this report"


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name scans by the last part of their paths, or by as many as tell them apart."""
    # The cloud of a session is called as the session.
    whole = [(path.parent if path.name == CLOUD else path).resolve() for path in paths]
    for path in whole:
        if whole.count(path) > 1:
            raise ConfigError(f"{path}: is given twice; name each scan once")
    for parts in range(1, max(len(path.parts) for path in whole) + 1):
        names = ["/".join(path.parts[-parts:]) for path in whole]
        if len(set(names)) == len(names):
            break
    return names


def difference(scan: ScanRecord, reference: ScanRecord) -> CloudDifference:
    """Subtract two clouds, where both were reconstructed with the same calibration."""
    names = scan.name, reference.name
    one, other = scan.cloud, reference.cloud
    if one is None or other is None:
        return CloudDifference(*names, None, "one of them has no points")
    if scan.calibration is None or reference.calibration is None:
        return CloudDifference(*names, None, "the calibration is not recorded")
    if not _same_geometry(scan.calibration, reference.calibration):
        return CloudDifference(*names, None, "they were reconstructed with different calibrations")
    if one.pixels is None or other.pixels is None or one.size != other.size:
        return CloudDifference(*names, None, "the points are not known by pixels of one camera")
    here, there = (v.astype(np.int64) << 32 | u for u, v in (one.pixels.T, other.pixels.T))
    _, rows, others = np.intersect1d(here, there, assume_unique=True, return_indices=True)
    if not len(rows):
        return CloudDifference(*names, None, "no pixel has a point in both")
    distances = np.full(len(one), np.nan, np.float32)
    far, near = (
        np.linalg.norm(c.points[k].astype(np.float64), axis=1) for c, k in ((one, rows), (other, others))
    )
    distances[rows] = far - near
    return CloudDifference(*names, distances)


def _same_geometry(one: Calibration, other: Calibration) -> bool:
    files = [CalibrationFile.of(calibration) for calibration in (one, other)]
    first, second = ((f.camera, f.projector, f.T_projector_camera) for f in files)
    return first == second


def write_scans_report(
    path: Path, scans: Sequence[ScanRecord], differences: Sequence[CloudDifference]
) -> None:
    """Write several scans side by side as one HTML file."""
    if not any(scan.cloud for scan in scans):
        raise DataError(f"none of {len(scans)} sessions holds a cloud; reconstruct them first")
    basis = PageBasis(
        tuple(scan.verdict() for scan in scans),
        {scan.name: scan.provenance for scan in scans},
        scans_answer(scans, differences),
    )
    by_name = {scan.name: scan for scan in scans}
    sections = [_surfaces(scans), *_maps(scans), *_differences(differences, by_name), *_images(scans)]
    write_page(path, f"{len(scans)} scans", [_figures(scans)], sections, basis=basis)


def scans_answer(scans: Sequence[ScanRecord], differences: Sequence[CloudDifference]) -> dict[str, Any]:
    """Give what `fpplab report --json` prints."""
    return {
        "scans": [scan.summary() for scan in scans],
        "differences": [one.summary() for one in differences],
    }


def _figures(scans: Sequence[ScanRecord]) -> ReportTable:
    rows = tuple(
        (
            scan.name,
            scan.diagnosis.verdict.value if scan.diagnosis else NOT_KNOWN,
            count_words(len(scan.cloud)) if scan.cloud else "0",
            number_words(roughness_um(scan.cloud) if scan.cloud else None),
            number_words(noise_um(scan.cloud) if scan.cloud else None),
        )
        for scan in scans
    )
    return ReportTable(("Scan", "Verdict", "Points", "Roughness in µm", "Noise in µm"), rows, ROUGHNESS)


def _surfaces(scans: Sequence[ScanRecord]) -> ReportSection:
    share = MOST_POINTS // len(scans)
    views = tuple(cloud_view(scan.name, scan.cloud, most=share) for scan in scans if scan.cloud)
    return ReportSection("Surfaces", "", views=views)


def _maps(scans: Sequence[ScanRecord]) -> list[ReportSection]:
    """Maps of one quantity beside each other, on one scale of colours."""
    depths = {scan.name: (scan.cloud, scan.cloud.points[:, 2]) for scan in scans if scan.cloud}
    sigmas = {
        scan.name: (scan.cloud, 1e3 * sigma)
        for scan in scans
        if scan.cloud and (sigma := _sigma(scan.cloud)) is not None
    }
    wanted: tuple[tuple[str, Mapping[str, tuple[Cloud, NDArray[Any]]], str, str], ...] = (
        ("Distance from the camera", depths, "viridis_r", "distance z from the camera in mm"),
        ("Uncertainty", sigmas, "cividis", "standard uncertainty in µm"),
    )
    return [_map_section(*one) for one in wanted if one[1]]


def _sigma(cloud: Cloud) -> NDArray[np.float32] | None:
    return cloud.sigma_along_ray_mm if cloud.sigma_mm is None else cloud.sigma_mm


def _map_section(
    title: str, values: Mapping[str, tuple[Cloud, NDArray[Any]]], colours: str, label: str
) -> ReportSection:
    limits = value_range(np.concatenate([one for _, one in values.values()]), 1, 99)
    drawn = tuple(
        ReportFigure.of(
            figures.point_map(cloud, one, colours, label, limits),
            f"Map of the {label.rpartition(' in ')[0]} of {name}",
            f"{name}: median {number_words(float(np.median(one)))} {label.rpartition(' in ')[2]}",
        )
        for name, (cloud, one) in values.items()
    )
    return ReportSection(title, "All on one scale of colours. Grey: not measured.", figures=drawn)


def _differences(found: Sequence[CloudDifference], scans: Mapping[str, ScanRecord]) -> list[ReportSection]:
    """Maps of the differences, and the figures of all."""
    if not found:
        return []
    drawn = tuple(
        ReportFigure.of(
            figures.error_map(cloud, one.distances_mm, quantity="difference"),
            f"Map of the difference of {one.scan} from {one.reference}, with its distribution",
            f"{one.scan} minus {one.reference} along the camera's rays; red is farther from the camera.",
            wide=True,
        )
        for one in found
        if one.distances_mm is not None and (cloud := scans[one.scan].cloud)
    )
    rows = tuple(_difference_row(one.summary()) for one in found)
    columns = ("Difference", "Pixels in both", "Median in µm", "RMS in µm", "95 % within µm", "")
    text = "They tell of the surface only where neither the object nor the rig was moved between the scans."
    return [ReportSection("Differences", text, (ReportTable(columns, rows),), drawn)]


def _difference_row(one: Mapping[str, Any]) -> tuple[str, ...]:
    name = f"{one['scan']} minus {one['reference']}"
    if "not_compared" in one:
        return (name, *4 * (NOT_KNOWN,), one["not_compared"])
    values = (number_words(one[key]) for key in ("median_um", "rms_um", "p95_um"))
    return (name, count_words(one["pixels"]), *values, "")


def _images(scans: Sequence[ScanRecord]) -> list[ReportSection]:
    drawn = tuple(
        ReportFigure.of(
            figures.camera_image(*scan.frame),
            f"Camera image of {scan.name} under the finest fringes",
            scan.name,
        )
        for scan in scans
        if scan.frame is not None
    )
    text = "One frame of the finest fringe set each."
    return [ReportSection("Camera images", text, figures=drawn)] if drawn else []
