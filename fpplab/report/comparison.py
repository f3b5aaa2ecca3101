"""The page of `fpplab compare`: how far a cloud is from the true shape."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from fpplab.clouds import Cloud, ply
from fpplab.comparison import Comparison
from fpplab.core.conventions import Map, Mask
from fpplab.core.drawing import ERROR_COLOURS
from fpplab.core.errors import DataError
from fpplab.core.files import write_large, write_parts
from fpplab.core.robust import error_limit
from fpplab.report.cloud_view import cloud_view
from fpplab.report.figures import error_map
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportSection, ReportTable
from fpplab.report.scan_section import FLOOR, error_figure, lengths_tables, relief_figure, sigma_figures
from fpplab.report.wording import NOT_KNOWN, count_text, number_text, percent_text
from fpplab.results.comparison import ComparisonResult


def write_comparison_report(path: Path, result: ComparisonResult) -> None:
    name, cloud, comparison = result.name, result.cloud, result.comparison
    verdicts = [comparison_verdict(result)]
    if result.diagnosis is not None:
        verdicts.append(PageVerdict.of(result.diagnosis, "The scan itself"))
    visible = (
        "of the true surface is visible to both devices" if comparison.restricted else "of the surface counts"
    )
    text = f"{percent_text(comparison.visible_share)} {visible}. Grey: not measured."
    figures = (error_figure(name, cloud, comparison), relief_figure(name, cloud), *sigma_figures(name, cloud))
    tables = (_figures(comparison), *lengths_tables(comparison))
    section = ReportSection("Errors", text, tables, figures, (cloud_view(name, cloud, comparison),))
    basis = PageBasis(tuple(verdicts), {name: result.provenance}, result.figures())
    write_page(path, f"Comparison of {name}", [], [section], verdicts_and_sources=basis)


def write_errors(path: Path, result: ComparisonResult) -> None:
    distances_mm, counted = result.comparison.distances_mm, result.comparison.counted
    if path.suffix.lower() == ".ply":
        write_error_cloud(path, result.cloud, distances_mm, counted)
    else:
        write_parts(path, error_map(result.cloud, distances_mm, counted))


def write_error_cloud(path: Path, cloud: Cloud, distances_mm: Map, counted: Mask) -> None:
    # distances_mm (N,); counted (N,)
    kept = counted & np.isfinite(distances_mm)
    if not kept.any():
        raise DataError(f"{path}: none of the {len(cloud)} points is compared, so there is nothing to write")
    errors = 1e3 * np.asarray(distances_mm, np.float32)[kept]
    limit = error_limit(errors)
    colours = mpl.colormaps[ERROR_COLOURS]((errors / limit + 1) / 2, bytes=True)
    columns = {
        **{name: cloud.coordinates[kept, axis] for axis, name in enumerate("xyz")},
        **{name: colours[:, channel] for channel, name in enumerate(("red", "green", "blue"))},
        "error_um": errors,
    }
    comments = [f"signed distance from the true shape in um, colours from {-limit:.4g} to {limit:.4g} um"]
    write_large(path, lambda stream: ply.write(columns, comments, stream))


def comparison_verdict(result: ComparisonResult) -> PageVerdict:
    headline, comparison = result.headline, result.comparison
    if result.misplaced:
        finding = ("the mesh stands elsewhere", result.misplaced, "Compare again with --align.")
        return PageVerdict("Comparison", "doubtful", "Not where the cloud lies", headline, (finding,))
    if warnings := comparison.warnings():
        findings = tuple(("contradicts the distances", warning, "") for warning in warnings)
        return PageVerdict("Comparison", "doubtful", "Contradicted", headline, findings)
    mean = comparison.smcd_um if comparison.surface_smcd_um is None else comparison.surface_smcd_um
    return PageVerdict("Comparison", "none", f"{number_text(mean)} µm from the true shape", headline)


def _figures(comparison: Comparison) -> ReportTable:
    scale = (
        NOT_KNOWN
        if comparison.scale is None
        else f"{comparison.scale.ppm:+.0f} ± {comparison.scale.sigma_ppm:.0f} ppm"
    )
    rows = (
        ("Surface SMCD", f"{number_text(comparison.surface_smcd_um)} µm"),
        ("Surface RMS", f"{number_text(comparison.surface_rms_um)} µm"),
        ("Surface P95", f"{number_text(comparison.surface_p95_um)} µm"),
        ("Completeness", percent_text(comparison.completeness)),
        ("Points compared", count_text(comparison.points)),
        ("Points outside the object", count_text(comparison.off_part)),
        (f"Outliers, beyond {comparison.outlier_mm:g} mm", count_text(comparison.outliers)),
        ("Scale", scale),
        ("SMCD", f"{number_text(comparison.smcd_um)} µm"),
        ("SMCD floor", f"{number_text(comparison.smcd_floor_um)} µm"),
        ("Mesh moved onto the cloud", "no" if comparison.alignment is None else "yes, rigidly"),
    )
    return ReportTable(("Figure", "Value"), rows, FLOOR)
