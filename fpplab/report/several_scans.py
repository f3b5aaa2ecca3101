"""One page for several scans: verdicts, figures side by side, and what differs in their provenance."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.clouds import Cloud
from fpplab.core.errors import DataError
from fpplab.core.robust import value_range
from fpplab.report import figures, maps
from fpplab.report.cloud_view import MAX_POINTS, cloud_view
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportFigure, ReportSection, ReportTable
from fpplab.report.scan_section import ROUGHNESS
from fpplab.report.wording import NOT_KNOWN, count_text, number_text
from fpplab.results.several_scans import (
    CloudDifference,
    ScanRecord,
    ScansResult,
    noise_um,
    plan_differences,
    roughness_um,
)


def write_scans_report(path: Path, result: ScansResult) -> None:
    scans = result.scans
    if not any(scan.cloud for scan in scans):
        raise DataError(f"none of {len(scans)} sessions holds a cloud; reconstruct them first")
    basis = PageBasis(
        tuple(scan_verdict(scan) for scan in scans),
        {scan.name: scan.provenance for scan in scans},
        result.figures(),
    )
    by_name = {scan.name: scan for scan in scans}
    sections = [
        *_plan_sections(result),
        _surfaces_section(scans),
        *_map_sections(scans),
        *_difference_sections(result.differences, by_name),
        *_image_sections(scans),
    ]
    write_page(path, f"{len(scans)} scans", [_figures(scans)], sections, verdicts_and_sources=basis)


def scan_verdict(scan: ScanRecord) -> PageVerdict:
    picture = base64.b64encode(maps.thumbnail(scan.cloud)).decode("ascii") if scan.cloud else ""
    if scan.diagnosis is not None:
        return replace(PageVerdict.of(scan.diagnosis, scan.name), thumbnail=picture)
    if scan.cloud is None:
        return PageVerdict(scan.name, "none", "Not reconstructed", "The session holds no cloud.")
    reason = "A cloud alone does not show it; give its session."
    return PageVerdict(scan.name, "none", "Not judged", reason, thumbnail=picture)


def _figures(scans: Sequence[ScanRecord]) -> ReportTable:
    rows = tuple(
        (
            scan.name,
            scan.diagnosis.verdict.value if scan.diagnosis else NOT_KNOWN,
            count_text(len(scan.cloud)) if scan.cloud else "0",
            number_text(roughness_um(scan.cloud) if scan.cloud else None),
            number_text(noise_um(scan.cloud) if scan.cloud else None),
        )
        for scan in scans
    )
    return ReportTable(("Scan", "Verdict", "Points", "Roughness in µm", "Noise in µm"), rows, ROUGHNESS)


def _plan_sections(result: ScansResult) -> list[ReportSection]:
    differences = plan_differences(result.scans)
    if not differences:
        return []
    rows = tuple((name, *values.values()) for name, values in differences.items())
    table = ReportTable(("", *next(iter(differences.values()))), rows, "As plan files call them.")
    return [ReportSection("Plans", "What the plans differ by; all else is the same.", (table,))]


def _surfaces_section(scans: Sequence[ScanRecord]) -> ReportSection:
    share = MAX_POINTS // len(scans)
    views = tuple(cloud_view(scan.name, scan.cloud, max_points=share) for scan in scans if scan.cloud)
    return ReportSection("Surfaces", "", views=views)


def _map_sections(scans: Sequence[ScanRecord]) -> list[ReportSection]:
    depths = {scan.name: (scan.cloud, scan.cloud.points[:, 2]) for scan in scans if scan.cloud}
    sigmas = {
        scan.name: (scan.cloud, 1e3 * sigma)
        for scan in scans
        if scan.cloud and (sigma := _sigma(scan.cloud)) is not None
    }
    quantities: tuple[tuple[str, Mapping[str, tuple[Cloud, NDArray[Any]]], str, str], ...] = (
        ("Distance from the camera", depths, "viridis_r", "distance z from the camera in mm"),
        ("Uncertainty", sigmas, "cividis", "standard uncertainty in µm"),
    )
    return [_map_section(*quantity) for quantity in quantities if quantity[1]]


def _sigma(cloud: Cloud) -> NDArray[np.float32] | None:
    return cloud.sigma_along_ray_mm if cloud.sigma_mm is None else cloud.sigma_mm


def _map_section(
    title: str, values: Mapping[str, tuple[Cloud, NDArray[Any]]], colours: str, label: str
) -> ReportSection:
    limits = value_range(np.concatenate([scalars for _, scalars in values.values()]), 1, 99)
    drawn = tuple(
        ReportFigure.of(
            maps.point_map(cloud, scalars, colours, label, limits),
            f"Map of the {label.rpartition(' in ')[0]} of {name}",
            f"{name}: median {number_text(float(np.median(scalars)))} {label.rpartition(' in ')[2]}",
        )
        for name, (cloud, scalars) in values.items()
    )
    return ReportSection(title, "All on one scale of colours. Grey: not measured.", figures=drawn)


def _difference_sections(
    differences: Sequence[CloudDifference], scans: Mapping[str, ScanRecord]
) -> list[ReportSection]:
    if not differences:
        return []
    drawn = tuple(
        ReportFigure.of(
            figures.error_map(cloud, difference.distances_mm, quantity="difference"),
            f"Map of the difference of {difference.scan} from {difference.reference}, with its distribution",
            f"{difference.scan} minus {difference.reference} along the camera's rays; red is farther from "
            "the camera.",
            wide=True,
        )
        for difference in differences
        if difference.distances_mm is not None and (cloud := scans[difference.scan].cloud)
    )
    rows = tuple(_difference_row(difference.summary()) for difference in differences)
    columns = ("Difference", "Pixels in both", "Median in µm", "RMS in µm", "95 % within µm", "")
    text = "They describe the surface only where neither the object nor the rig was moved between the scans."
    return [ReportSection("Differences", text, (ReportTable(columns, rows),), drawn)]


def _difference_row(figures: Mapping[str, Any]) -> tuple[str, ...]:
    name = f"{figures['scan']} minus {figures['reference']}"
    if "not_compared" in figures:
        return (name, *4 * (NOT_KNOWN,), figures["not_compared"])
    values = (number_text(figures[key]) for key in ("median_um", "rms_um", "p95_um"))
    return (name, count_text(figures["pixels"]), *values, "")


def _image_sections(scans: Sequence[ScanRecord]) -> list[ReportSection]:
    drawn = tuple(
        ReportFigure.of(
            maps.camera_image(*scan.frame),
            f"Camera image of {scan.name} under the finest fringes",
            scan.name,
        )
        for scan in scans
        if scan.frame is not None
    )
    text = "One frame of the finest fringe set each."
    return [ReportSection("Camera images", text, figures=drawn)] if drawn else []
