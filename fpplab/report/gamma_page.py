"""The page of `fpplab gamma`: a response, and whether it is good enough for a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fpplab.core.conventions import Floats
from fpplab.patterns.phase_error import ResponseJudgement
from fpplab.patterns.response import Response
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportTable
from fpplab.report.response_section import response_section
from fpplab.results.provenance import Provenance


def write_gamma_report(
    path: Path,
    response: Response,
    levels: Floats,
    judgement: ResponseJudgement,
    provenance: Provenance,
    answer: Mapping[str, Any],
) -> None:
    """Write a response as one HTML file."""
    # levels (K, 2)
    verdict = PageVerdict(
        "",
        "good" if judgement.good_enough else "doubtful",
        "Good enough for the plan" if judgement.good_enough else "Not good enough for the plan",
        judgement.sentence,
    )
    tables = (judgement.by_steps, judgement.corrected_by_steps, judgement.rounding_by_steps)
    rows = tuple((steps, *(f"{1e3 * one[steps]:.3g}" for one in tables)) for steps in judgement.by_steps)
    section = response_section(response, levels)
    caption = (
        "RMS error of the phase in mrad by the harmonics of this response and the rounding of patterns to "
        "256 grey levels, which is the floor of what a correction reaches."
    )
    table = ReportTable(("Steps", "As they are", "Corrected", "Rounding alone"), rows, caption)
    sections = [replace(section, tables=(*section.tables, table))]
    basis = PageBasis((verdict,), {"response": provenance}, answer)
    write_page(path, f"Response {path.stem}", [], sections, basis=basis)
