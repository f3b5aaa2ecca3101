"""The acceptance test as a page: its result, every value, and maps of the errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Sheet

from fpplab.comparison.acceptance import (
    CONVENTIONS,
    QUANTITIES,
    VERDICTS,
    Acceptance,
    BallBarTest,
    MeasuredFeature,
    PlaneTest,
    SphereTest,
)
from fpplab.core.drawing import FULL, as_png, colour_bar, draw_map, side_by_side
from fpplab.core.robust import error_limit
from fpplab.report.figures import error_map
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportFigure, ReportSection, ReportTable
from fpplab.report.raster import raster_of, rasterise
from fpplab.results.acceptance import AcceptanceResult

JUDGED = (
    "Quantity",
    "Values",
    "Positions required",
    "Largest error in µm",
    "Of all points in µm",
    "Uncertainty of the standard in µm",
    "Permissible in µm",
    "Judgement",
)
RULE = (
    "Passed: in every position the error, together with the uncertainty of the standard, is within the "
    "maximum permissible error. PF and F, which are judged: "
    f"{CONVENTIONS['PF']}. Of all points (PF_all, F_all): the fit to all points and their range."
)


def _kept_points(feature: MeasuredFeature) -> MeasuredFeature:
    kept = feature.kept
    pixels = None if feature.pixels is None else feature.pixels[kept]
    return replace(feature, points=feature.points[kept], pixels=pixels, distances=feature.distances[kept])


def write_acceptance_report(path: Path, result: AcceptanceResult) -> None:
    acceptance = result.acceptance
    rule = acceptance.standard.evaluation
    facts = {
        "Standard": acceptance.standard.name,
        "Result": VERDICTS[acceptance.passed],
        "Method": "following VDI/VDE 2634 part 2, from single views",
        "Cap of the spheres": f"angle of incidence up to {rule.cap_deg:g}°; less gives better figures",
        "Edges": f"{rule.edge_mm:g} mm inside silhouettes and edges are left out",
        "Form error PF, F": f"{CONVENTIONS['PF']} (judged)",
        "Form error PF_all, F_all": CONVENTIONS["PF_all"],
    }
    sections = [_bar_section(bar, k + 1) for k, bar in enumerate(acceptance.bars)]
    sections += [_plane_section(plane, k + 1) for k, plane in enumerate(acceptance.planes)]
    basis = PageBasis((PageVerdict.of(result.diagnosis),), result.provenance, result.summary())
    write_page(path, "Acceptance test", _summary(acceptance), sections, facts, verdicts_and_sources=basis)


def _summary(acceptance: Acceptance) -> list[ReportTable]:
    judged = tuple(
        (
            f"{QUANTITIES[name]} {name}",
            str(j.positions),
            str(j.min_positions),
            _signed(name, j.worst_um),
            "–" if j.worst_all_um is None else f"{j.worst_all_um:.1f}",
            f"{j.reference_uncertainty_um:g}",
            "–" if j.mpe_um is None else f"{j.mpe_um:g}",
            VERDICTS[j.passed],
        )
        for name, j in acceptance.judgements().items()
    )
    tables = [
        ReportTable(
            JUDGED, judged, " ".join([RULE, *(f"{n[:1].upper()}{n[1:]}." for n in acceptance.notices())])
        )
    ]
    if acceptance.bars:
        columns = (
            "Ball bar",
            "PF 1 / 2 in µm",
            "PF_all 1 / 2 in µm",
            "PS 1 / 2 in µm",
            "SD in µm",
            "RMS 1 / 2 in µm",
            "Cap in sr",
        )
        tables.append(ReportTable(columns, tuple(_bar_row(bar) for bar in acceptance.bars)))
    if acceptance.planes:
        rows = tuple(
            (
                p.source,
                f"{p.flatness_um:.1f}",
                f"{p.measured.span_all_um:.1f}",
                f"{p.measured.rms_um:.1f}",
                f"{p.area_mm2:.0f}",
                f"{len(p.measured.points)}",
            )
            for p in acceptance.planes
        )
        tables.append(
            ReportTable(("Plane", "F in µm", "F_all in µm", "RMS in µm", "Area in mm²", "Points"), rows)
        )
    return tables


def _bar_row(bar: BallBarTest) -> tuple[str, ...]:
    first, second = bar.spheres
    return (
        bar.source,
        f"{first.form_um:.1f} / {second.form_um:.1f}",
        f"{first.measured.span_all_um:.1f} / {second.measured.span_all_um:.1f}",
        f"{first.size_um:+.1f} / {second.size_um:+.1f}",
        f"{bar.spacing_error_um:+.1f}",
        f"{first.measured.rms_um:.1f} / {second.measured.rms_um:.1f}",
        f"{first.solid_angle_sr:.2f} / {second.solid_angle_sr:.2f}",
    )


def _bar_section(bar: BallBarTest, number: int) -> ReportSection:
    text = (
        f"{bar.source}: the spheres' centres are {bar.spacing_mm:.4f} mm apart, "
        f"calibrated {bar.calibrated_mm:.4f} mm. Grey: not measured, or not evaluated."
    )
    caption = "Signed radial distance of every evaluated point from its fitted sphere; red is outside."
    drawn = ReportFigure.of(
        sphere_errors(bar.spheres), "Maps of both spheres' signed errors", caption, wide=True
    )
    return ReportSection(f"Ball bar, position {number}", text, figures=(drawn,))


def _plane_section(plane: PlaneTest, number: int) -> ReportSection:
    text = (
        f"{plane.source}: {plane.area_mm2:.0f} mm² of the plane are evaluated, "
        f"{plane.plane.point[2]:.0f} mm from the camera. Grey: not measured, or not evaluated."
    )
    caption = "Signed distance of every evaluated point from the fitted plane; red is towards the camera."
    kept = _kept_points(plane.measured)
    drawn = ReportFigure.of(
        error_map(kept, kept.distances), "Map of the plane's signed errors", caption, True
    )
    return ReportSection(f"Plane, position {number}", text, figures=(drawn,))


@as_png
def sphere_errors(spheres: tuple[SphereTest, SphereTest]) -> Sheet:
    # The colours span ± the 98th percentile of the absolute error, which the colour bar states.
    drawn = [_kept_points(test.measured) for test in spheres]
    limit = error_limit(1e3 * np.concatenate([feature.distances for feature in drawn]))
    figure, panels = side_by_side(0.44 * FULL, (1.0, 1.0))
    for axes, test, feature in zip(panels, spheres, drawn, strict=True):
        grid = raster_of(feature)
        mapped, extent = rasterise(grid, 1e3 * feature.distances[:, None].astype(np.float32))
        mappable = draw_map(axes, mapped[..., 0], "RdBu_r", (-limit, limit), extent)
        axes.set(xlabel=grid.names[0], ylabel=grid.names[1])
        title = f"Sphere {test.number}: PF {test.form_um:.1f} µm, RMS {test.measured.rms_um:.1f} µm"
        axes.set_title(title, fontsize=8.5)
    label = f"signed error in µm (range ±{limit:.3g}, 98 % of points)"
    colour_bar(figure, panels[-1], mappable, label)
    return figure


def _signed(name: str, value: float) -> str:
    return f"{value:+.1f}" if name in ("PS", "SD") else f"{value:.1f}"
