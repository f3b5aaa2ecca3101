"""The report: one HTML file that says what was measured and how well, and shows it.

Everything is inside the file, figures included; it has no scripts and fetches nothing, so that it can be
mailed, printed and archived. Every section is optional: the same function reports a demonstration, a single
scan, or a characterisation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from fpplab.characterisation import Characterisation, Judgement
from fpplab.clouds import Cloud, local_quadric_distance
from fpplab.comparison import Comparison
from fpplab.core.conventions import Axis, Floats, Image, Map
from fpplab.core.files import write_text
from fpplab.core.version import __version__
from fpplab.diagnosis import Diagnosis
from fpplab.guidance import GuidedRun
from fpplab.patterns.response import Response
from fpplab.phase import Decoded, Wrapped
from fpplab.reconstruction.depth_range import DepthRange
from fpplab.reconstruction.filtering import removal
from fpplab.report import devices, figures, response_figures, uncertainty
from fpplab.report.guidance import guided_section
from fpplab.report.parts import NOT_KNOWN, ReportFigure, ReportSection, ReportTable


@dataclass(frozen=True, eq=False)
class ScanSection:
    """What the report shows of one scan.

    Attributes
    ----------
    name : str
        Of the object.
    images : int
        Number of images of the plan.
    frame : Image
        One raw frame [v, u] of the finest fringe set.
    wrapped : Wrapped
        Wrapped phase of that set.
    decoded : Decoded
        Projector coordinates.
    cloud : Cloud
        Points.
    comparison : Comparison or None
        With the true shape, where it is known.
    bits : int
        Bit depth of the frame.
    uncertain_orders : dict of str to int or None
        Pixels left out for an uncertain fringe order, by the fringe set that is the cause.
    depth : DepthRange or None
        The range of depths that the scan was reconstructed with.
    diagnosis : Diagnosis or None
        Whether to believe it.
    """

    name: str
    images: int
    frame: Image
    wrapped: Wrapped
    decoded: Decoded
    cloud: Cloud
    comparison: Comparison | None = None
    bits: int = 8
    uncertain_orders: dict[str, int] | None = None
    depth: DepthRange | None = None
    diagnosis: Diagnosis | None = None


def write_report(
    path: Path,
    title: str,
    *,
    facts: Mapping[str, str] | None = None,
    response: tuple[Response, Floats] | None = None,
    characterisation: Characterisation | None = None,
    judgement: Judgement | None = None,
    guided: GuidedRun | None = None,
    scans: Sequence[ScanSection] = (),
    when: datetime | None = None,
) -> None:
    """Write the report as one HTML file. If it fails, an earlier file is unchanged.

    Parameters
    ----------
    path : Path
        Of the file; an earlier one is replaced.
    title : str
        Heading of the page.
    facts : mapping of str to str, optional
        What the head of the page says besides (rig, plan, operator).
    response : tuple of Response and Floats, optional
        The fit, and its levels (K, 2), shown and seen, in [0, 1].
    characterisation : Characterisation, optional
        Shown with its residuals.
    judgement : Judgement, optional
        Errors in poses that were not fitted, beside those predicted.
    guided : GuidedRun, optional
        How a guided characterisation came about.
    scans : sequence of ScanSection
        One section each.
    when : datetime, optional
        Time of the measurement; now by default.

    Raises
    ------
    DataError
        The file cannot be written, or there is nothing to draw.
    """
    sections = []
    if response:
        sections.append(_response_section(*response))
    if guided:
        sections.append(guided_section(guided))
    if characterisation:
        sections.append(devices.characterisation_section(characterisation))
    if judgement:
        sections.append(devices.judgement_section(judgement))
    sections += [_scan_section(scan) for scan in scans]
    write_page(path, title, [*_verdicts(scans), *_summary(characterisation, scans)], sections, facts, when)


def write_page(
    path: Path,
    title: str,
    summary: Sequence[ReportTable],
    sections: Sequence[ReportSection],
    facts: Mapping[str, str] | None = None,
    when: datetime | None = None,
) -> None:
    """Write tables and sections as one HTML file. If it fails, an earlier file is unchanged.

    Parameters
    ----------
    path : Path
        Of the file; an earlier one is replaced.
    title : str
        Heading of the page.
    summary : sequence of ReportTable
        At the top of the page.
    sections : sequence of ReportSection
        In their order.
    facts : mapping of str to str, optional
        What the head of the page says besides.
    when : datetime, optional
        Time of the measurement; now by default.

    Raises
    ------
    DataError
        The file cannot be written.
    """
    page = _template().render(
        title=title,
        when=(when or datetime.now().astimezone()).strftime("%Y-%m-%d %H:%M %Z").strip(),
        facts=facts or {},
        summary=summary,
        sections=sections,
        version=__version__,
    )
    write_text(path, page)


def _template() -> Any:
    loader = PackageLoader("fpplab.report", "templates")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("report.html.j2")


# Summary

COMPARED = (
    "Artefact",
    "Images",
    "Points",
    "Surface RMS in µm",
    "Surface P95 in µm",
    "Surface SMCD in µm",
    "SMCD in µm",
    "SMCD floor in µm",
    "Completeness",
    "Outliers",
    "Scale in ppm",
)
FLOOR = (
    "SMCD floor: the SMCD of a perfect measurement with the same sampling; the surface figures need none. "
    "Scale: of the best-fit similarity minus one, with its standard uncertainty; distances after a rigid "
    "alignment hardly show it."
)
SCANNED = ("Scan", "Images", "Points", "Roughness in µm", "Noise in µm")
ROUGHNESS = (
    "Roughness: median distance of a point from the quadric fitted to its neighbours. "
    "Noise: median standard deviation along the ray, as predicted from the fringes."
)


def _verdicts(scans: Sequence[ScanSection]) -> list[ReportTable]:
    """Whether to believe each scan, and why not."""
    tables = []
    for scan in scans:
        if (diagnosis := scan.diagnosis) is None:
            continue
        rows = [(f"Verdict: {diagnosis.verdict.value}", diagnosis.reason, "")]
        rows += [(one.cause.value, one.evidence, one.remedy) for one in diagnosis.findings]
        unchecked = f"Not checked: {'; '.join(diagnosis.unknown)}." if diagnosis.unknown else ""
        tables.append(ReportTable((scan.name, "Evidence", "Remedy"), tuple(rows), unchecked, words=True))
    return tables


def _summary(characterisation: Characterisation | None, scans: Sequence[ScanSection]) -> list[ReportTable]:
    tables = []
    if characterisation:
        tables.append(devices.summary_table(characterisation))
    compared = tuple(_compared_row(s, s.comparison) for s in scans if s.comparison is not None)
    if compared:
        tables.append(ReportTable(COMPARED, compared, FLOOR))
    scanned = tuple(
        (s.name, str(s.images), _count(len(s.cloud)), _roughness(s.cloud), _noise(s.cloud))
        for s in scans
        if s.comparison is None
    )
    if scanned:
        tables.append(ReportTable(SCANNED, scanned, ROUGHNESS))
    return tables


def _compared_row(scan: ScanSection, found: Comparison) -> tuple[str, ...]:
    lengths = (
        found.surface_rms_um,
        found.surface_p95_um,
        found.surface_smcd_um,
        found.smcd_um,
        found.smcd_floor_um,
    )
    outliers = f"{_count(found.outliers)} ({_percent(found.outliers / found.points)})"
    head = (scan.name, str(scan.images), _count(len(scan.cloud)))
    scale = NOT_KNOWN if found.scale is None else f"{found.scale.ppm:+.0f} ± {found.scale.sigma_ppm:.0f}"
    return (*head, *map(_number, lengths), _percent(found.completeness), outliers, scale)


def _roughness(cloud: Cloud) -> str:
    if cloud.pixels is None:
        return NOT_KNOWN
    distances = np.abs(local_quadric_distance(cloud))
    known = distances[np.isfinite(distances)]
    return _number(1e3 * float(np.median(known)) if len(known) else None)


def _noise(cloud: Cloud) -> str:
    return _number(None if cloud.sigma_noise_mm is None else 1e3 * float(np.median(cloud.sigma_noise_mm)))


# Sections


def _response_section(response: Response, levels: Floats) -> ReportSection:
    values = zip((response.a, response.b, response.g), response.sigma, strict=True)
    row = (str(response.levels), *(f"{v:.4f} ± {s:.4f}" for v, s in values), f"{255 * response.residual:.2f}")
    columns = ("Levels fitted", "a", "b", "g", "Residual RMS in grey levels of 255")
    text = "Level seen = a · (level shown)ᵍ + b, levels as shares of full scale."
    return ReportSection(
        "Response",
        text,
        (ReportTable(columns, (row,), "; ".join(response.left_out)),),
        (_response_figure(response, levels),),
    )


def _response_figure(response: Response, levels: Floats) -> ReportFigure:
    alt = f"Response of projector and camera, with a fitted exponent of {response.g:.3f}"
    if response.regions:
        caption = (
            "Left: the levels seen and the fitted response; below, seen minus fitted. "
            "Right: the exponent of each region, and that of the common fit (band)."
        )
        return ReportFigure.of(response_figures.response_fit(response), alt, caption, wide=True)
    caption = "Left: the levels measured and the fitted response. Right: measured minus fitted."
    return ReportFigure.of(response_figures.response_curve(response, levels), alt, caption, wide=True)


def _scan_section(scan: ScanSection) -> ReportSection:
    name, decoded, cloud = scan.name, scan.decoded, scan.cloud
    phase = np.where(decoded.valid, scan.wrapped.phase, np.float32(np.nan))
    pictures = [
        ReportFigure.of(
            figures.camera_image(scan.frame, scan.bits),
            f"Camera image of the {name} under the finest fringes",
            "One frame of the finest fringe set.",
        ),
        ReportFigure.of(
            figures.modulation_map(decoded.modulation),
            f"Map of the fringes' modulation on the {name}",
            "Modulation: the amplitude of the fringes.",
        ),
        ReportFigure.of(
            figures.wrapped_phase_figure(phase),
            f"Map of the wrapped phase of the {name}",
            "Wrapped phase of the finest set.",
        ),
        *_coordinates(scan),
        ReportFigure.of(
            figures.shaded_relief(cloud),
            f"Shaded relief of the measured {name}",
            f"The measured surface, illuminated from the upper left: {_count(len(cloud))} points.",
        ),
        ReportFigure.of(
            figures.depth_map(cloud),
            f"Map of the distance of the {name} from the camera",
            "Distance from the camera along its axis.",
        ),
        *_sigmas(scan),
    ]
    text = (
        f"{scan.images} images; {_percent(float(decoded.valid.mean()))} of the camera's pixels are measured."
    )
    if scan.uncertain_orders is not None:
        text += _uncertain_text(scan.uncertain_orders, decoded.u.size)
    if scan.depth is not None:
        near, far = scan.depth.mm
        text += f" Only distances from {near:g} to {far:g} mm count, by {scan.depth.source}."
        text += "".join(
            f" Warning: {one}." for one in (decoded.outside.warnings() if decoded.outside else ())
        )
    if (removed := removal(decoded)) is not None:
        share = removed.pop("share")
        rules = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in removed.items())
        text += f" Of these the filter removed {_percent(share)} as outliers: {rules}."
    if scan.comparison is not None:
        pictures.append(_error_figure(scan, scan.comparison))
        text += f" {_percent(scan.comparison.visible_share)} of the true surface is visible to both devices."
    tables = () if scan.comparison is None else lengths_tables(scan.comparison)
    return ReportSection(name[:1].upper() + name[1:], text + " Grey: not measured.", tables, tuple(pictures))


def lengths_tables(found: Comparison) -> tuple[ReportTable, ...]:
    """Tabulate measured and true lengths, with what contradicts the distances below.

    Parameters
    ----------
    found : Comparison
        After an alignment.

    Returns
    -------
    tuple of ReportTable
        Empty if there are neither lengths nor contradictions.
    """
    rows = tuple((m.name, *m.texts()) for m in found.lengths)
    said = found.warnings()
    columns = ("Length", "True in mm", "Measured in mm", "Error in µm", "Standard uncertainty in µm")
    caption = " ".join(f"{warning[:1].upper()}{warning[1:]}." for warning in said)
    return (ReportTable(columns, rows, caption),) if rows or said else ()


def _uncertain_text(causes: dict[str, int], pixels: int) -> str:
    """How many pixels noise has cost, and in which fringe set."""
    if not causes:
        return " No pixel was left out for an uncertain fringe order."
    listed = ", ".join(f"{name} {_count(count)}" for name, count in causes.items())
    share = _percent(sum(causes.values()) / pixels)
    return (
        f" {share} were left out because noise leaves their fringe order uncertain, by fringe set: {listed}."
    )


def _coordinates(scan: ScanSection) -> list[ReportFigure]:
    maps: tuple[tuple[Axis, Map, str], ...] = (
        ("x", scan.decoded.u, "columns"),
        ("y", scan.decoded.v, "rows"),
    )
    return [
        ReportFigure.of(
            figures.coordinate_map(values, axis),
            f"Map of the projector's {name} as seen on the {scan.name}",
            f"Unwrapped: the projector's {name}, with contour lines.",
        )
        for axis, values, name in maps
        if np.isfinite(values).any()
    ]


def _sigmas(scan: ScanSection) -> list[ReportFigure]:
    cloud = scan.cloud
    if cloud.sigma_noise_mm is None:
        return []
    alt = f"Maps of the standard uncertainty of the points of the {scan.name}"
    drawn, wide = uncertainty.sigma_maps(cloud), cloud.sigma_mm is not None
    return [ReportFigure.of(drawn, alt, uncertainty.sigma_caption(cloud), wide)]


def _error_figure(scan: ScanSection, found: Comparison) -> ReportFigure:
    alt = f"Signed error of the {scan.name}, with its distribution; RMS {_number(found.surface_rms_um)} µm"
    caption = (
        f"Signed distance of every compared point from the true surface; red is outside the "
        f"true shape. {_count(found.off_part)} points beside the object are left out."
    )
    drawn = figures.error_map(scan.cloud, found.distances_mm, found.counted)
    return ReportFigure.of(drawn, alt, caption, wide=True)


# Formatting of numbers


def _number(value: float | None) -> str:
    if value is None:
        return NOT_KNOWN
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"


def _count(value: int) -> str:
    return f"{value:,}".replace(",", "\u202f")


def _percent(share: float) -> str:
    return f"{100 * share:.3g}\u202f%"
