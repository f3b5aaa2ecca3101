"""A recorded scan as a section of the report, or as a page of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison import Comparison
from fpplab.diagnosis import Diagnosis
from fpplab.phase import Decoded, wrapped_phase
from fpplab.phase.precision import uncertain_orders
from fpplab.reconstruction.depth_range import DepthRange
from fpplab.report.evidence import Evidence, evidence_report
from fpplab.report.page import PageBasis, write_report
from fpplab.report.provenance import Provenance
from fpplab.report.scan_section import ScanSection
from fpplab.sessions.session import Session


def write_scan_report(
    path: Path,
    session: Session,
    decoded: Decoded | None,
    cloud: Cloud | None,
    depth: DepthRange | None = None,
    diagnosis: Diagnosis | None = None,
    *,
    provenance: Provenance | None = None,
    calibration: Calibration | None = None,
    answer: Mapping[str, Any] | None = None,
) -> None:
    """Write the figures of one scan as an HTML page."""
    name = session.path.name
    section = scan_section(
        *(name, session, decoded, cloud),
        depth=depth,
        diagnosis=diagnosis,
        provenance=provenance,
        calibration=calibration,
    )
    write_report(path, f"Scan {name}", scans=[section], basis=PageBasis(answer=answer or {}))


def scan_section(
    name: str,
    session: Session,
    decoded: Decoded | None,
    cloud: Cloud | None,
    comparison: Comparison | None = None,
    depth: DepthRange | None = None,
    diagnosis: Diagnosis | None = None,
    provenance: Provenance | None = None,
    calibration: Calibration | None = None,
) -> ScanSection:
    """Make the section of one scan: the finest fringes along the first axis, and the results."""
    recording = session.recording(verify=False)
    fringe, frames = recording.finest()
    wrapped = wrapped_phase(frames, fringe)
    findings = diagnosis.findings if diagnosis else ()
    return ScanSection(
        name,
        session.plan.images,
        frames[0],
        wrapped,
        decoded,
        cloud,
        comparison,
        bits=recording.bits,
        uncertain_orders=None if decoded is None else uncertain_orders(decoded, session.plan),
        depth=depth,
        diagnosis=diagnosis,
        provenance=provenance,
        evidence=evidence_report(findings, Evidence(recording, decoded, cloud, calibration)),
        plan=session.plan,
    )
