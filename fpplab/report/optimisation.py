"""A search as a page: before and after, convergence, Pareto front, each parameter, and maps of the errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure as Sheet
from matplotlib.ticker import LogFormatter, MaxNLocator

from fpplab.core.drawing import ACCENT, ALARM, FULL, HALF, INK, SECOND, as_png, side_by_side, single_axes
from fpplab.optimisation.candidate import CandidateFigures, MeasuredCandidate
from fpplab.optimisation.confirm import ConfirmedPlan
from fpplab.optimisation.objective import Objective, registered_objectives
from fpplab.optimisation.result import SearchResult
from fpplab.optimisation.scoring import ArtefactFigures
from fpplab.optimisation.space import Parameter
from fpplab.report.figures import error_map
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportFigure, ReportSection, ReportTable
from fpplab.results.search import MeasuredArtefact, OptimisationResult

DISTANCE = "mean distance to the surface, µm"  # label of the axes
GREY = "#9aa1a9"
PLAN_COLUMNS = ("Plan", "Stripes", "Steps", "Stage in mm")
OTHER_COLUMNS = ("Surface SMCD in µm, other seeds", "SMCD (floor) in µm", "Wrong orders", "Filtered")
CONFIRMED = (
    "Plan",
    "Images",
    "Before in µm",
    "After in µm",
    "Gain",
    "Uncertainty",
    "by repeats",
    "by sample",
    "by calibration",
)


def write_optimisation_report(path: Path, result: OptimisationResult) -> None:
    search, compared = result.search, result.compared
    sections = [_confirmed_section(result.confirmed)] if result.confirmed else []
    sections.append(_convergence_section(search))
    if len(search.front) > 1:
        sections.append(_front_section(search))
    sections += [
        _parameter_section(search, compared.angles_deg),
        *(_map_section(name, *both) for name, both in compared.artefacts.items()),
    ]
    basis = PageBasis((PageVerdict.of(result.diagnosis),), compared.provenance, result.summary())
    write_page(
        path,
        f"Search: {search.study.name}",
        _summary(search),
        sections,
        _head_facts(search),
        verdicts_and_sources=basis,
    )


def _how_scored(search: SearchResult) -> str:
    if not search.screened:
        return "measured whole"
    return "predicted from bands of rows; what has figures of other seeds was measured whole with these"


def _head_facts(search: SearchResult) -> dict[str, str]:
    failed = sum(not trial.measured for trial in search.trials)
    facts = {
        "Rig": search.rig,
        "Artefacts": ", ".join(search.study.artefacts),
        "Method": search.study.method.kind,
        "Ended": search.ended,
        "Scores": _how_scored(search),
        "Candidates": f"{len(search.trials)}, with {len(search.study.seeds)} seeds each; {failed} failed",
    }
    if search.refused:
        facts["Refused"] = "; ".join(f"{reason} ({count})" for reason, count in search.refused.items())
    if gain := search.gain:
        spread = "" if gain.uncertainty_um is None else f" ± {gain.uncertainty_um:.2g}"
        facts["Gain"] = (
            f"{gain.down_um:.2f}{spread} µm, {gain.down_percent:.1f} %, "
            "with seeds that the search did not use"
        )
    return facts


def _summary(search: SearchResult) -> list[ReportTable]:
    rows = [_candidate_row("start", search.start, search), _candidate_row("found", search.optimum, search)]
    if len(search.front) > 1:
        rows += [_candidate_row(f"front {i}", trial, search) for i, trial in enumerate(search.front, 1)]
    objectives = _objectives_in_order(search)
    columns = (*PLAN_COLUMNS, *(objective.label for objective in objectives), *OTHER_COLUMNS)
    caption = (
        "Means over artefacts and seeds, ± standard deviation over the seeds. "
        + " ".join(f"{objective.title}: {objective.sentence}." for objective in objectives)
        + " SMCD: the symmetric mean distance between two sets of points; floor: that of a perfect "
        "measurement. Other seeds: seeds that the search did not use."
    )
    return [ReportTable(columns, tuple(rows), caption)]


def _objectives_in_order(search: SearchResult) -> list[Objective]:
    chosen = {objective.key: objective for objective in search.ranking.objectives}
    return list((chosen | registered_objectives()).values())


def _candidate_row(name: str, trial: MeasuredCandidate, search: SearchResult) -> tuple[str, ...]:
    figures, candidate = trial.figures, trial.candidate
    rescored = search.rescored.get(candidate)
    stage = candidate.stage_mm
    return (
        name,
        ", ".join(each.short_name for each in candidate.fringes),
        ", ".join(str(each.images) for each in candidate.fringes),
        "" if stage is None else f"{stage:g}",
        *(objective.text(trial) for objective in _objectives_in_order(search)),
        _with_spread(CandidateFigures.of(rescored)) if rescored else "",
        f"{figures.smcd_um:.1f} ({figures.smcd_floor_um:.1f})",
        f"{100 * figures.wrong_orders:.3f} %",
        f"{100 * figures.outliers:.2f} %",
    )


def _with_spread(figures: CandidateFigures) -> str:
    spread = "" if figures.smcd_spread_um is None else f" ± {figures.smcd_spread_um:.2g}"
    return f"{figures.surface_smcd_um:.2f}{spread}"


def _confirmed_section(confirmed: Sequence[ConfirmedPlan]) -> ReportSection:
    rows = []
    for confirmed_plan in confirmed:
        confirmation = confirmed_plan.confirmation
        parts = (
            confirmation.gain,
            confirmation.uncertainty,
            confirmation.by_repeat,
            confirmation.by_sample,
            confirmation.by_calibration,
        )
        means = (f"{_mean_um(figures):.2f}" for figures in (confirmation.before, confirmation.after))
        rows.append(
            (
                confirmed_plan.plan.name,
                str(confirmed_plan.images),
                *means,
                *(f"{100 * part:.2f} %" for part in parts),
            )
        )
    text = f"The artefacts, measured on '{confirmed[0].rig}' with the start's plan and with each plan found."
    return ReportSection("Confirmation", text, tables=(ReportTable(CONFIRMED, tuple(rows)),))


def _mean_um(measured: Mapping[str, Sequence[ArtefactFigures]]) -> float:
    return float(np.mean([artefact.surface_smcd_um for figures in measured.values() for artefact in figures]))


def _wide_section(title: str, png: bytes, shows: str, caption: str) -> ReportSection:
    return ReportSection(title, figures=(ReportFigure.of(png, shows, caption, wide=True),))


def _convergence_section(search: SearchResult) -> ReportSection:
    return _wide_section(
        "Convergence",
        convergence_figure(search),
        "Distance and images by candidate",
        "Every candidate in the order measured, and the best so far; crosses exceed a limit.",
    )


@as_png
def convergence_figure(search: SearchResult) -> Sheet:
    measured = [(i, trial) for i, trial in enumerate(search.trials) if trial.measured]
    best = [(epoch.measured - 1, epoch.best) for epoch in search.epochs]
    distance, images = (registered_objectives()[key] for key in ("surface_smcd_um", "images"))
    others = [*(other for other in search.ranking.objectives if other.key != distance.key), images]
    differing = [other for other in others if len({other.value(trial) for _, trial in measured}) > 1]
    shown = [distance, *differing[:1]]
    panels: tuple[Axes, ...]
    if differing:
        figure, panels = side_by_side(3.0, (1.0, 1.0))
    else:
        figure, axes = single_axes(FULL, 3.0)
        panels = (axes,)
    for axes, objective in zip(panels, shown, strict=True):
        for keeps, mark, colour in ((True, ".", GREY), (False, "x", SECOND)):
            chosen = [
                (i, objective.value(trial))
                for i, trial in measured
                if search.ranking.is_acceptable(trial) is keeps
            ]
            axes.plot(*_columns(chosen), mark, color=colour, markersize=3)
        bests = [(i, objective.value(trial)) for i, trial in best]
        axes.step(*_columns(bests), where="post", color=ACCENT, linewidth=1.4)
        axes.set(xlabel="candidate", ylabel=_axis_label(objective))
        if objective.is_integer:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    _logarithmic_if_wide(panels[0], [trial.figures.surface_smcd_um for _, trial in measured])
    return figure


def _axis_label(objective: Objective) -> str:
    return DISTANCE if objective.key == "surface_smcd_um" else objective.label.lower()


def _columns(pairs: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [a for a, _ in pairs], [b for _, b in pairs]


def _logarithmic_if_wide(axes: Axes, values: Sequence[float]) -> None:
    """Set a logarithmic scale where the distances of failed plans would hide the others."""
    if min(values) > 0 and max(values) > 5 * min(values):
        _set_ratio_scale(axes.yaxis, axes.set_yscale)


def _set_ratio_scale(axis: Axis, scale: Callable[[str], None]) -> None:
    scale("log")
    for formatter in (axis.set_major_formatter, axis.set_minor_formatter):
        formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(2, 0.7)))


def _front_section(search: SearchResult) -> ReportSection:
    down, across = search.ranking.objectives[:2]
    return _wide_section(
        "Pareto front",
        pareto_front(search),
        f"Front of {across.title.lower()} and {down.title.lower()}",
        "Plans that no other plan surpasses in every objective, with the spread over seeds that the search "
        "did not use.",
    )


@as_png
def pareto_front(search: SearchResult) -> Sheet:
    down, across = search.ranking.objectives[:2]
    figure, axes = single_axes(FULL, 3.6)
    measured = [trial for trial in search.trials if trial.measured]
    for keeps, mark, colour, label in (
        (True, ".", GREY, "measured"),
        (False, "x", SECOND, "exceeds a limit"),
    ):
        chosen = [
            (across.value(trial), down.value(trial))
            for trial in measured
            if search.ranking.is_acceptable(trial) is keeps
        ]
        axes.plot(*_columns(chosen), mark, color=colour, markersize=3, label=label)
    front = [(across.value(trial), down.value(trial)) for trial in search.front]
    axes.plot(*_columns(front), "o-", color=ACCENT, markersize=4, label="front")
    rescored = [
        (across.value(trial), replace(trial, scores=scores))
        for trial in search.front
        if (scores := search.rescored[trial.candidate])
    ]
    axes.errorbar(
        [place for place, _ in rescored],
        [down.value(trial) for _, trial in rescored],
        yerr=[down.spread(trial) or 0.0 for _, trial in rescored],
        fmt="_",
        color=INK,
        capsize=2,
        label="front, other seeds",
    )
    start = search.start
    axes.plot(across.value(start), down.value(start), "s", color=ALARM, markersize=5, label="start")
    axes.set(xlabel=_axis_label(across), ylabel=_axis_label(down))
    _logarithmic_if_wide(axes, [down.value(trial) for trial in measured])
    axes.legend()
    return figure


def _parameter_section(search: SearchResult, angles: Mapping[float, float]) -> ReportSection:
    figures = []
    for i, parameter in enumerate(search.space.parameters):
        caption = (
            f"Every candidate against {parameter.name}, with the spread over its seeds; "
            "crosses exceed a limit."
        )
        figures.append(
            ReportFigure.of(
                distance_by_parameter(search, i, parameter), f"Distance against {parameter.name}", caption
            )
        )
        if parameter.group == "geometry":
            caption = (
                "Trade-off of the baseline: share of the surface that is measured, which shadows reduce, and "
                "RMS distance of the points. Dotted: start (red) and found (blue)."
            )
            along_angle = angles if parameter.name == "stage_mm" else {}
            figures.append(
                ReportFigure.of(
                    completeness_by_parameter(search, i, parameter, along_angle),
                    f"Shadow against {parameter.name}",
                    caption,
                )
            )
    return ReportSection("Parameters", figures=tuple(figures))


@as_png
def completeness_by_parameter(
    search: SearchResult, i: int, parameter: Parameter, angles: Mapping[float, float]
) -> Sheet:
    figure, axes = single_axes(HALF, 3.0)
    rms = axes.twinx()
    measured = sorted((t for t in search.trials if t.measured), key=lambda t: t.point[i])

    def place(trial: MeasuredCandidate) -> float:
        return angles.get(trial.point[i], trial.point[i])

    values = [place(trial) for trial in measured]
    mark = ".-" if len(search.space.parameters) == 1 else "."
    axes.plot(values, [100 * t.figures.completeness for t in measured], mark, color=ACCENT, linewidth=0.8)
    rms.plot(values, [t.figures.surface_rms_um for t in measured], mark, color=SECOND, linewidth=0.8)
    for trial, colour in ((search.start, ALARM), (search.optimum, ACCENT)):
        axes.axvline(place(trial), color=colour, linewidth=0.8, linestyle=":")
    axes.set_xlabel("angle of triangulation, degrees" if angles else parameter.name)
    axes.set_ylabel("completeness, %", color=ACCENT)
    rms.set_ylabel("RMS distance, µm", color=SECOND)
    return figure


@as_png
def distance_by_parameter(search: SearchResult, i: int, parameter: Parameter) -> Sheet:
    figure, axes = single_axes(HALF, 3.0)
    measured = [trial for trial in search.trials if trial.measured]
    for keeps, mark, colour in ((True, ".", GREY), (False, "x", SECOND)):
        chosen = [trial for trial in measured if search.ranking.is_acceptable(trial) is keeps]
        axes.errorbar(
            [trial.point[i] for trial in chosen],
            [trial.figures.surface_smcd_um for trial in chosen],
            yerr=[trial.figures.smcd_spread_um or 0.0 for trial in chosen],
            fmt=mark,
            color=colour,
            elinewidth=0.6,
            markersize=4,
        )
    for trial, colour, label in ((search.start, ALARM, "start"), (search.optimum, ACCENT, "found")):
        axes.plot(trial.point[i], trial.figures.surface_smcd_um, "o", color=colour, markersize=5, label=label)
    axes.set(xlabel=parameter.name, ylabel=DISTANCE)
    if parameter.is_logarithmic:
        _set_ratio_scale(axes.xaxis, axes.set_xscale)
    _logarithmic_if_wide(axes, [trial.figures.surface_smcd_um for trial in measured])
    axes.legend()
    return figure


def _map_section(name: str, before: MeasuredArtefact, after: MeasuredArtefact) -> ReportSection:
    figures = tuple(
        ReportFigure.of(
            error_map(artefact.cloud, artefact.comparison.distances_mm, artefact.comparison.counted),
            f"Errors of the {name}, {plan}",
            f"{plan.capitalize()}: signed distance from the surface.",
        )
        for artefact, plan in ((before, "with the start's plan"), (after, "with the plan found"))
    )
    return ReportSection(f"Artefact {name}", figures=figures)
