"""One scan on a page: its figures, its view in three dimensions, and its lines in the tables at the top."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fpplab.clouds import Cloud
from fpplab.core.conventions import Axis, Image, Map
from fpplab.core.depth import DepthRange
from fpplab.diagnosis import Diagnosis
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded, Wrapped
from fpplab.reconstruction.filtering import count_removed
from fpplab.reconstruction.points import cost_at_edges
from fpplab.report import maps, uncertainty
from fpplab.report.cloud_view import MAX_POINTS, cloud_view
from fpplab.report.map_sheet import drawn_pixels
from fpplab.report.parts import ReportFigure, ReportSection, ReportTable
from fpplab.report.wording import NOT_KNOWN, count_text, number_text, percent_text
from fpplab.results.provenance import Provenance
from fpplab.results.several_scans import noise_um, roughness_um

if TYPE_CHECKING:
    from fpplab.comparison import Comparison

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


@dataclass(frozen=True, eq=False)
class ScanSection:
    """What the report shows of one scan."""

    name: str  # of the object
    images: int  # number of images of the plan
    frame: Image  # one raw frame [v, u] of the finest fringe set, or of a code
    wrapped: Wrapped | None  # that set in the pixels that a map shows; None where there are no fringes
    decoded: Decoded | None  # projector coordinates; None where there are none
    cloud: Cloud | None  # points; None where there are none
    comparison: Comparison | None = None  # with the true shape, where it is known
    bits: int = 8  # bit depth of the frame
    uncertain_orders: dict[str, int] | None = None  # pixels left out for an uncertain fringe order
    depth: DepthRange | None = None  # the range of depths that the scan was reconstructed with
    diagnosis: Diagnosis | None = None  # whether to believe it
    provenance: Provenance | None = None  # where it comes from
    evidence: tuple[ReportFigure, ...] = ()  # what shows each finding of the diagnosis
    plan: Plan | None = None  # that was measured


def scan_tables(scans: Sequence[ScanSection]) -> list[ReportTable]:
    tables = []
    compared = tuple(_compared_row(s, s.cloud, s.comparison) for s in scans if s.cloud and s.comparison)
    if compared:
        tables.append(ReportTable(COMPARED, compared, FLOOR))
    scanned = tuple(
        (
            s.name,
            str(s.images),
            count_text(len(s.cloud)),
            number_text(roughness_um(s.cloud)),
            number_text(noise_um(s.cloud)),
        )
        for s in scans
        if s.cloud and s.comparison is None
    )
    if scanned:
        tables.append(ReportTable(SCANNED, scanned, ROUGHNESS))
    return tables


def _compared_row(scan: ScanSection, cloud: Cloud, comparison: Comparison) -> tuple[str, ...]:
    lengths = (
        comparison.surface_rms_um,
        comparison.surface_p95_um,
        comparison.surface_smcd_um,
        comparison.smcd_um,
        comparison.smcd_floor_um,
    )
    outliers = f"{count_text(comparison.outliers)} ({percent_text(comparison.outliers / comparison.points)})"
    head = (scan.name, str(scan.images), count_text(len(cloud)))
    scale = (
        NOT_KNOWN
        if comparison.scale is None
        else f"{comparison.scale.ppm:+.0f} ± {comparison.scale.sigma_ppm:.0f}"
    )
    return (*head, *map(number_text, lengths), percent_text(comparison.completeness), outliers, scale)


def section_of(scan: ScanSection, points: int = MAX_POINTS) -> ReportSection:
    name, comparison = scan.name, scan.comparison
    views = () if scan.cloud is None else (cloud_view(name, scan.cloud, comparison, points),)
    tables = () if comparison is None else lengths_tables(comparison)
    title = name[:1].upper() + name[1:]
    return ReportSection(title, _describe_scan(scan), tables, tuple(_pictures_of_scan(scan)), views)


def _describe_scan(scan: ScanSection) -> str:
    text, decoded = f"{scan.images} images", scan.decoded
    if decoded is None:
        return f"{text}; no pixel has a projector coordinate."
    text += f"; {percent_text(float(decoded.valid.mean()))} of the camera's pixels are measured."
    if scan.uncertain_orders is not None:
        text += _uncertain_text(scan.uncertain_orders, decoded.u.size)
    if scan.cloud is not None and (edges := cost_at_edges(decoded, scan.cloud)) and edges["share"]:
        text += f" At {percent_text(edges['share'])} of these, edges of reflectivity "
        text += (
            "moved the points by {:.3g} µm RMS, which was corrected."
            if edges["corrected"]
            else ("may move the points by {:.3g} µm RMS: too few are sharp enough to correct for the blur.")
        )
        text = text.format(edges["displacement_um"])
    if scan.depth is not None:
        near, far = scan.depth.mm
        text += f" Only distances from {near:g} to {far:g} mm count, by {scan.depth.source}."
        text += "".join(
            f" Warning: {warning}." for warning in (decoded.outside.warnings() if decoded.outside else ())
        )
    if (removed := count_removed(decoded)) is not None:
        share = removed.pop("share")
        rules = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in removed.items())
        text += f" Of these the filter removed {percent_text(share)} as outliers: {rules}."
    if scan.comparison is not None:
        text += (
            f" {percent_text(scan.comparison.visible_share)} of the true surface is visible to both devices."
        )
    return f"{text} Grey: not measured."


def _pictures_of_scan(scan: ScanSection) -> Iterator[ReportFigure]:
    name, cloud, decoded = scan.name, scan.cloud, scan.decoded
    yield from scan.evidence
    if cloud is not None and scan.comparison is not None:
        yield error_figure(name, cloud, scan.comparison)
    if cloud is not None:
        yield relief_figure(name, cloud)
        yield depth_figure(name, cloud)
        yield from sigma_figures(name, cloud, scan.plan)
    yield frame_figure(scan)
    if decoded is not None and np.isfinite(decoded.modulation).any():
        yield ReportFigure.of(
            maps.modulation_map(decoded.modulation),
            f"Map of the fringes' modulation on the {name}",
            "Modulation: the amplitude of the fringes.",
        )
    if decoded is not None and decoded.valid.any():
        if scan.wrapped is not None:
            height, width = decoded.valid.shape
            extent = (-0.5, width - 0.5, height - 0.5, -0.5)
            phase = np.where(drawn_pixels(decoded.valid), scan.wrapped.phase, np.float32(np.nan))
            yield ReportFigure.of(
                maps.wrapped_phase_map(phase, extent),
                f"Map of the wrapped phase of the {name}",
                "Wrapped phase of the finest set.",
            )
        yield from _coordinates(name, decoded)


def frame_figure(scan: ScanSection) -> ReportFigure:
    drawn = maps.camera_image(scan.frame, scan.bits)
    shown = "finest fringes" if scan.wrapped is not None else "codes"
    return ReportFigure.of(
        drawn, f"Camera image of the {scan.name} under the {shown}", f"One frame of the {shown}."
    )


def relief_figure(name: str, cloud: Cloud) -> ReportFigure:
    return ReportFigure.of(
        maps.shaded_relief(cloud),
        f"Shaded relief of the measured {name}",
        f"The measured surface, illuminated from the upper left: {count_text(len(cloud))} points.",
    )


def depth_figure(name: str, cloud: Cloud) -> ReportFigure:
    return ReportFigure.of(
        maps.depth_map(cloud),
        f"Map of the distance of the {name} from the camera",
        "Distance from the camera along its axis.",
    )


def sigma_figures(name: str, cloud: Cloud, plan: Plan | None = None) -> list[ReportFigure]:
    if cloud.sigma_noise_mm is None:
        return []
    alt = f"Maps of the standard uncertainty of the points of the {name}"
    drawn, wide = uncertainty.sigma_maps(cloud), cloud.sigma_mm is not None
    return [ReportFigure.of(drawn, alt, uncertainty.sigma_caption(cloud, plan), wide)]


def error_figure(name: str, cloud: Cloud, comparison: Comparison) -> ReportFigure:
    from fpplab.report.figures import error_map

    alt = (
        f"Signed error of the {name}, with its distribution; RMS {number_text(comparison.surface_rms_um)} µm"
    )
    caption = (
        f"Signed distance of every compared point from the true surface; red is outside the "
        f"true shape. {count_text(comparison.off_part)} points outside the object are left out."
    )
    drawn = error_map(cloud, comparison.distances_mm, comparison.counted)
    return ReportFigure.of(drawn, alt, caption, wide=True)


def lengths_tables(comparison: Comparison) -> tuple[ReportTable, ...]:
    rows = tuple((m.name, *m.texts()) for m in comparison.lengths)
    warnings = comparison.warnings()
    columns = ("Length", "True in mm", "Measured in mm", "Error in µm", "Standard uncertainty in µm")
    caption = " ".join(f"{warning[:1].upper()}{warning[1:]}." for warning in warnings)
    return (ReportTable(columns, rows, caption),) if rows or warnings else ()


def _uncertain_text(causes: dict[str, int], pixels: int) -> str:
    if not causes:
        return " No pixel was left out for an uncertain fringe order."
    listed = ", ".join(f"{name} {count_text(count)}" for name, count in causes.items())
    share = percent_text(sum(causes.values()) / pixels)
    return f" {share} were left out for an uncertain fringe order, by the set at fault: {listed}."


def _coordinates(name: str, decoded: Decoded) -> list[ReportFigure]:
    coordinates: tuple[tuple[Axis, Map, str], ...] = (("x", decoded.u, "columns"), ("y", decoded.v, "rows"))
    return [
        ReportFigure.of(
            maps.coordinate_map(values, axis),
            f"Map of the projector's {what} as seen on the {name}",
            f"Unwrapped: the projector's {what}, with contour lines.",
        )
        for axis, values, what in coordinates
        if np.isfinite(values).any()
    ]
