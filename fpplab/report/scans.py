"""A recorded scan as a section of the report, or as a page of its own."""

from __future__ import annotations

from pathlib import Path

from fpplab.clouds import Cloud
from fpplab.comparison import Comparison
from fpplab.diagnosis import Diagnosis
from fpplab.phase import Decoded, wrapped_phase
from fpplab.phase.precision import uncertain_orders
from fpplab.reconstruction.depth_range import DepthRange
from fpplab.report.page import ScanSection, write_report
from fpplab.sessions.session import Session


def write_scan_report(
    path: Path,
    session: Session,
    decoded: Decoded,
    cloud: Cloud,
    depth: DepthRange | None = None,
    diagnosis: Diagnosis | None = None,
) -> None:
    """Write the figures of one scan as an HTML page.

    Parameters
    ----------
    path : Path
        Of the file; an earlier one is replaced.
    session : Session
        The recorded scan.
    decoded : Decoded
        Its projector coordinates.
    cloud : Cloud
        Its points.
    depth : DepthRange, optional
        The range of depths that it was reconstructed with.
    diagnosis : Diagnosis, optional
        Whether to believe it.

    Raises
    ------
    DataError
        The file cannot be written, or there is nothing to draw.
    """
    name = session.path.name
    section = scan_section(name, session, decoded, cloud, depth=depth, diagnosis=diagnosis)
    write_report(path, f"Scan {name}", scans=[section])


def scan_section(
    name: str,
    session: Session,
    decoded: Decoded,
    cloud: Cloud,
    comparison: Comparison | None = None,
    depth: DepthRange | None = None,
    diagnosis: Diagnosis | None = None,
) -> ScanSection:
    """Make the section of one scan: the finest fringes along the first axis, and the results.

    Parameters
    ----------
    name : str
        Of the object.
    session : Session
        The recorded scan.
    decoded : Decoded
        Its projector coordinates.
    cloud : Cloud
        Its points.
    comparison : Comparison, optional
        With the true shape, where it is known.
    depth : DepthRange, optional
        The range of depths that it was reconstructed with.
    diagnosis : Diagnosis, optional
        Whether to believe it.

    Returns
    -------
    ScanSection
        For `write_report`.
    """
    recording = session.recording(verify=False)
    fringe, frames = recording.finest()
    wrapped = wrapped_phase(frames, fringe)
    return ScanSection(
        name,
        session.plan.images,
        frames[0],
        wrapped,
        decoded,
        cloud,
        comparison,
        bits=recording.bits,
        uncertain_orders=uncertain_orders(decoded, session.plan),
        depth=depth,
        diagnosis=diagnosis,
    )
