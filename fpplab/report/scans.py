"""A scan as a section of the report, or as a page of its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.diagnosis.evidence import Evidence
from fpplab.patterns.recording import Recording
from fpplab.phase import Wrapped, wrapped_phase
from fpplab.phase.precision import uncertain_orders
from fpplab.report.evidence import evidence_report
from fpplab.report.map_sheet import drawn_pixels
from fpplab.report.measurements import write_report
from fpplab.report.page import PageBasis
from fpplab.report.scan_section import ScanSection
from fpplab.results.scan import ScanResult

if TYPE_CHECKING:
    from fpplab.comparison import Comparison


def write_scan_report(path: Path, result: ScanResult) -> None:
    """Write one scan as an HTML page."""
    section = scan_section(result)
    write_report(
        path, f"Scan {section.name}", scans=[section], verdicts_and_sources=PageBasis(answer=result.figures())
    )


def scan_section(result: ScanResult, comparison: Comparison | None = None) -> ScanSection:
    """Make the section of one scan: what its frames show, and the results."""
    session = result.session
    recording = session.recording(verify=False)
    fringes = recording.fringe_part
    evidence = Evidence(fringes, result.decoded, result.cloud, result.calibration)
    return ScanSection(
        name=session.path.name,
        images=session.plan.frames,
        frame=recording.typical_frame,
        wrapped=_drawn_phase(fringes) if fringes else None,
        decoded=result.decoded,
        cloud=result.cloud,
        comparison=comparison,
        bits=recording.bits,
        uncertain_orders=None if result.decoded is None else uncertain_orders(result.decoded, session.plan),
        depth=result.depth,
        diagnosis=result.diagnosis,
        provenance=result.provenance,
        evidence=evidence_report(result.diagnosis.findings, evidence),
        plan=session.plan,
    )


def _drawn_phase(fringes: Recording) -> Wrapped:
    fringe, frames = fringes.finest()
    return wrapped_phase([drawn_pixels(frame) for frame in frames], fringe)
