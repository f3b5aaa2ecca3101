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
from fpplab.report.provenance import Provenance
from fpplab.report.response_section import response_section


def write_gamma_report(
    path: Path,
    response: Response,
    levels: Floats,
    judgement: ResponseJudgement,
    provenance: Provenance,
    answer: Mapping[str, Any],
) -> None:
    """Write a response as one HTML file.

    Parameters
    ----------
    path : Path
        Of the file; an earlier one is replaced.
    response : Response
        The fit.
    levels : Floats
        (K, 2), levels shown and seen, in [0, 1].
    judgement : ResponseJudgement
        Whether it is good enough for the plan.
    provenance : Provenance
        Of the measurement.
    answer : mapping of str to object
        What the command prints with `--json`.

    Raises
    ------
    DataError
        The file cannot be written.
    """
    verdict = PageVerdict(
        "",
        "good" if judgement.good_enough else "doubtful",
        "Good enough for the plan" if judgement.good_enough else "Not good enough for the plan",
        judgement.sentence,
    )
    rows = tuple((steps, f"{1e3 * error:.3g}") for steps, error in judgement.by_steps.items())
    section = response_section(response, levels)
    caption = "RMS error of the phase by the harmonics of this response, without correction of the patterns."
    table = ReportTable(("Steps", "Phase error in mrad"), rows, caption)
    sections = [replace(section, tables=(*section.tables, table))]
    basis = PageBasis((verdict,), {"response": provenance}, answer)
    write_page(path, f"Response {path.stem}", [], sections, basis=basis)
