"""A page of several measurements: response, characterisation, scans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.conventions import Floats
from fpplab.report.cloud_view import MAX_POINTS
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict
from fpplab.report.scan_section import ScanSection, scan_tables, section_of

if TYPE_CHECKING:
    from fpplab.characterisation import Characterisation, Judgement
    from fpplab.patterns.response import Response
    from fpplab.setup.guide import GuidedRun


def write_report(
    path: Path,
    title: str,
    *,
    head_facts: Mapping[str, str] | None = None,
    response: tuple[Response, Floats] | None = None,
    characterisation: Characterisation | None = None,
    judgement: Judgement | None = None,
    guided: GuidedRun | None = None,
    scans: Sequence[ScanSection] = (),
    verdicts_and_sources: PageBasis | None = None,
    written_at: datetime | None = None,
) -> None:
    """Write the report of measurements as one HTML file. If it fails, an earlier file is unchanged."""
    # head_facts (rig, plan, operator); response (K, 2)
    page_basis = verdicts_and_sources or PageBasis()
    is_single = len(scans) == 1
    verdicts = [PageVerdict.of(s.diagnosis, "" if is_single else s.name) for s in scans if s.diagnosis]
    sources = {s.name: s.provenance for s in scans if s.provenance}
    summary, sections = [], [section_of(scan, MAX_POINTS // max(len(scans), 1)) for scan in scans]
    if guided:
        from fpplab.report.guidance import guided_section

        sections.append(guided_section(guided))
    if characterisation or judgement:
        from fpplab.report import devices

        if characterisation:
            summary.append(devices.summary_table(characterisation))
            sections.append(devices.characterisation_section(characterisation))
        if judgement:
            sections.append(devices.judgement_section(judgement))
    if response:
        from fpplab.report.response import response_section

        sections.append(response_section(*response))
    complete_basis = PageBasis(
        (*page_basis.verdicts, *verdicts), {**page_basis.provenance, **sources}, page_basis.answer
    )
    write_page(path, title, [*scan_tables(scans), *summary], sections, head_facts, written_at, complete_basis)
