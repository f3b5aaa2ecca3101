"""The response of projector and camera: its section of a report, and the page of `fpplab gamma`."""

from dataclasses import replace
from pathlib import Path

from fpplab.core.conventions import Floats
from fpplab.patterns.response import Response
from fpplab.report import response_figures
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportFigure, ReportSection, ReportTable
from fpplab.results.response import ResponseResult

JUDGEMENT_CAPTION = (
    "RMS error of the phase in mrad by the harmonics of this response and the rounding of patterns to "
    "256 grey levels, which is the floor of what a correction reaches."
)


def write_response_report(path: Path, result: ResponseResult) -> None:
    judgement = result.judgement
    verdict = PageVerdict(
        name="",
        level="good" if judgement.good_enough else "doubtful",
        label="Good enough for the plan" if judgement.good_enough else "Not good enough for the plan",
        reason=judgement.sentence,
    )
    errors = (judgement.by_steps, judgement.corrected_by_steps, judgement.rounding_by_steps)
    rows = tuple(
        (steps, *(f"{1e3 * values[steps]:.3g}" for values in errors)) for steps in judgement.by_steps
    )
    table = ReportTable(("Steps", "As they are", "Corrected", "Rounding alone"), rows, JUDGEMENT_CAPTION)
    section = response_section(result.response, result.levels)
    section = replace(section, tables=(*section.tables, table))
    basis = PageBasis((verdict,), {"response": result.provenance}, result.figures())
    write_page(path, f"Response {path.stem}", [], [section], verdicts_and_sources=basis)


def response_section(response: Response, levels: Floats) -> ReportSection:
    # levels (K, 2)
    values = zip((response.a, response.b, response.g), response.sigma, strict=True)
    row = (str(response.levels), *(f"{v:.4f} ± {s:.4f}" for v, s in values), f"{255 * response.residual:.2f}")
    columns = ("Levels fitted", "a", "b", "g", "Residual RMS in grey levels of 255")
    text = "Level seen = a · (level shown)ᵍ + b, levels as shares of full scale."
    if response.spline:
        text = (
            "Level seen = a · S(level shown) + b, levels as shares of full scale. S is a monotone spline "
            f"with {len(response.spline)} coefficients, since no power law predicts the levels as well; "
            "g is the exponent of the best power law."
        )
    if errors := response.prediction_errors:
        text += (
            f" A level is predicted from the others to {255 * errors['power_law']:.2f} grey levels of 255 by "
            f"the power law, and to {255 * errors['spline']:.2f} by a spline."
        )
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
