"""The page of `fpplab compare`: how far a cloud is from the true shape."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fpplab.clouds import Cloud
from fpplab.comparison import Comparison
from fpplab.diagnosis import Diagnosis
from fpplab.report.cloud_view import cloud_view
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportSection, ReportTable
from fpplab.report.scan_section import FLOOR, error_figure, lengths_tables, relief_figure, sigma_figures
from fpplab.report.wording import NOT_KNOWN, count_words, number_words, percent_words
from fpplab.results.provenance import Provenance


def write_comparison_report(
    path: Path,
    name: str,
    cloud: Cloud,
    found: Comparison,
    headline: str,
    *,
    misplaced: str | None,
    diagnosis: Diagnosis | None,
    provenance: Provenance,
    answer: Mapping[str, Any],
) -> None:
    """Write a comparison as one HTML file."""
    verdicts = [comparison_verdict(found, headline, misplaced)]
    if diagnosis is not None:
        verdicts.append(PageVerdict.of(diagnosis, "The scan itself"))
    visible = (
        "of the true surface is visible to both devices" if found.restricted else "of the surface counts"
    )
    text = f"{percent_words(found.visible_share)} {visible}. Grey: not measured."
    figures = (error_figure(name, cloud, found), relief_figure(name, cloud), *sigma_figures(name, cloud))
    tables = (_figures(found), *lengths_tables(found))
    section = ReportSection("Errors", text, tables, figures, (cloud_view(name, cloud, found),))
    basis = PageBasis(tuple(verdicts), {name: provenance}, answer)
    write_page(path, f"Comparison of {name}", [], [section], basis=basis)


def comparison_verdict(found: Comparison, headline: str, misplaced: str | None) -> PageVerdict:
    """Say how far the cloud is, and what contradicts that."""
    if misplaced:
        advice = "Compare again with --align."
        finding = ("the mesh stands elsewhere", misplaced, advice)
        return PageVerdict("Comparison", "doubtful", "Not where the cloud lies", headline, (finding,))
    if said := found.warnings():
        findings = tuple(("contradicts the distances", one, "") for one in said)
        return PageVerdict("Comparison", "doubtful", "Contradicted", headline, findings)
    mean = found.smcd_um if found.surface_smcd_um is None else found.surface_smcd_um
    return PageVerdict("Comparison", "none", f"{number_words(mean)} µm from the true shape", headline)


def _figures(found: Comparison) -> ReportTable:
    scale = NOT_KNOWN if found.scale is None else f"{found.scale.ppm:+.0f} ± {found.scale.sigma_ppm:.0f} ppm"
    rows = (
        ("Surface SMCD", f"{number_words(found.surface_smcd_um)} µm"),
        ("Surface RMS", f"{number_words(found.surface_rms_um)} µm"),
        ("Surface P95", f"{number_words(found.surface_p95_um)} µm"),
        ("Completeness", percent_words(found.completeness)),
        ("Points compared", count_words(found.points)),
        ("Points beside the object", count_words(found.off_part)),
        (f"Outliers, beyond {found.outlier_mm:g} mm", count_words(found.outliers)),
        ("Scale", scale),
        ("SMCD", f"{number_words(found.smcd_um)} µm"),
        ("SMCD floor", f"{number_words(found.smcd_floor_um)} µm"),
        ("Mesh moved onto the cloud", "no" if found.alignment is None else "yes, rigidly"),
    )
    return ReportTable(("Figure", "Value"), rows, FLOOR)
