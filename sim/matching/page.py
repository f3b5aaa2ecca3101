"""A matching as a page: the paper's table, the loss by epoch, what each effect explains, and images."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure as Sheet
from numpy.typing import NDArray

from fpplab.core.drawing import (
    ACCENT,
    FULL,
    SECOND,
    as_png,
    colour_bar,
    draw_map,
    map_height,
    new_figure,
    side_by_side,
)
from fpplab.report.figures import error_map
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportFigure, ReportSection, ReportTable
from fpplab.results.provenance import Provenance, poses_provenance, session_provenance
from fpplab.sessions.session import Session
from sim.appearance import Appearance
from sim.matching.light.gamma import GammaMatch
from sim.matching.record import MatchingEpoch
from sim.matching.reference import Reference
from sim.matching.run import MatchingResult
from sim.matching.scene.appearance import AppearanceTrial
from sim.matching.scene.artefacts import ArtefactComparison
from sim.matching.scene.surface import SurfaceMatch
from sim.matching.steps import EXPLAINS
from sim.parameters import TABLE, TwinParameters, named_numbers
from sim.twin import Twin

GreyPicture = NDArray[np.float32]  # image [v, u] in raw levels

COLUMNS = ("Refined", "Response", "SSIM", "SSIM over the board", "ε_d in px", "Loss", "Loss over the board")


def write_matching_report(
    path: Path,
    matching: MatchingResult,
    twin: Twin,
    answer: Mapping[str, Any] | None = None,
    provenance: Mapping[str, Provenance] | None = None,
) -> None:
    sections = [_epochs_section(matching)]
    if matching.gamma:
        sections.append(_gamma_section(matching.gamma))
    if matching.appearance:
        sections.append(_appearance_section(matching.appearance))
    sections += [_poses_section(matching), _images_section(matching, twin), _parameters_section(matching)]
    if matching.surfaces:
        sections.append(_surfaces_section(matching.surfaces))
    sections += [_artefact_section(artefact) for artefact in matching.artefacts]
    facts = {
        "Ended": matching.matched.ended,
        "Poses": str(len(matching.matched.parameters.poses)),
        "Unexplained difference": f"{matching.matched.unexplained:.2f} levels RMS over the board",
    }
    basis = PageBasis((PageVerdict.of(matching.diagnosis),), provenance or {}, answer or {})
    write_page(path, "Matching of a twin", _summary(matching), sections, facts, verdicts_and_sources=basis)


def matching_provenance(matching: MatchingResult, scans: Mapping[str, Session]) -> dict[str, Provenance]:
    """State which recordings a twin was matched to and judged by."""
    calibration = matching.reference.characterisation.calibration
    poses = poses_provenance(matching.reference.sessions, calibration)
    return {"poses": poses, **{item: session_provenance(scan, calibration) for item, scan in scans.items()}}


def _summary(matching: MatchingResult) -> list[ReportTable]:
    rows = tuple(
        (
            "yes" if row.refined else "no",
            "matched" if row.gamma else "nominal",
            *(f"{row.loss[k]:.4f}" for k in ("ssim", "ssim_board", "epsilon_d_px", "loss", "loss_board")),
        )
        for row in matching.rows
    )
    tables = [
        ReportTable(
            COLUMNS, rows, "L = α log(1 + |ε_d|) + β (1 − SSIM); the twin's images contain its noise."
        )
    ]
    if matching.artefacts:
        judged = tuple(
            (
                artefact.item,
                f"{artefact.reference_um:.1f}",
                f"{artefact.twin_um:.1f}",
                f"{artefact.delta_um:+.1f}",
                f"{artefact.summary()['delta_percent']:.1f}",
            )
            for artefact in matching.artefacts
        )
        columns = ("Artefact", "Bench in µm", "Twin in µm", "Difference in µm", "Difference in %")
        tables.append(
            ReportTable(columns, judged, "Symmetric mean distance between points and true surface.")
        )
    return tables


def _epochs_section(matching: MatchingResult) -> ReportSection:
    columns = ("Epoch", "Step", "SSIM", "over the board", "ε_d in px", "Loss", "over the board", "Accepted")
    rows = tuple(
        (
            str(epoch.epoch),
            epoch.step,
            f"{epoch.loss['ssim']:.4f} ± {epoch.loss['ssim_spread']:.4f}",
            f"{epoch.loss['ssim_board']:.4f} ± {epoch.loss['ssim_board_spread']:.4f}",
            f"{epoch.loss['epsilon_d_px']:.4f}",
            f"{epoch.loss['loss']:.4f}",
            f"{epoch.loss['loss_board']:.4f}",
            "yes" if epoch.accepted else "no",
        )
        for epoch in matching.matched.epochs
    )
    explained = tuple(
        (step, f"{100 * share:.1f} %", EXPLAINS.get(step, "a flat board casts no shadow"))
        for step, share in matching.matched.explained.items()
    )
    effects = ReportTable(
        ("Effect", "Share", "What it is"),
        explained,
        "Share of the images' mean square difference before the step of each effect that it removed.",
    )
    drawn = ReportFigure.of(
        loss_curve(matching.matched.epochs),
        "Loss by epoch",
        "Loss with its spread over the images, and RMS difference, by epoch. Hollow: rejected epochs.",
        wide=True,
    )
    return ReportSection("Epochs", tables=(ReportTable(columns, rows), effects), figures=(drawn,))


def _appearance_section(trial: AppearanceTrial) -> ReportSection:
    rows = tuple(
        (name, f"{part.ssim_without:.4f}", f"{part.ssim_with:.4f}", "yes" if part.accepted else "no")
        for name, part in (("Board's sheet", trial.sheet), ("Surroundings", trial.surroundings))
    )
    note = (
        f"SSIM in {trial.pose}, from which they were not found: of the sheet over the board, of the "
        "surroundings over whole images. What is accepted is part of the twin."
    )
    table = ReportTable(("Part", "SSIM without", "SSIM with", "Accepted"), rows, note)
    return ReportSection("Sheet and surroundings", tables=(table,))


@as_png
def loss_curve(epochs: Sequence[MatchingEpoch]) -> Sheet:
    """Draw loss and difference by epoch; rejected ones are hollow, the band is the images' spread."""
    figure, (left, right) = side_by_side(3.0, (1.4, 1.0))
    numbers = [epoch.epoch for epoch in epochs]
    for key, colour, label in (("loss", ACCENT, "whole image"), ("loss_board", SECOND, "over the board")):
        values = np.array([epoch.loss[key] for epoch in epochs])
        left.plot(numbers, values, "-", color=colour, linewidth=1.2, label=label)
        for epoch, value in zip(epochs, values, strict=True):
            fill = colour if epoch.accepted else "white"
            left.plot(epoch.epoch, value, "o", color=colour, markerfacecolor=fill, markersize=4)
    spread = np.array([epoch.loss["loss_spread"] for epoch in epochs])
    whole = np.array([epoch.loss["loss"] for epoch in epochs])
    left.fill_between(numbers, np.maximum(whole - spread, 1e-5), whole + spread, color=ACCENT, alpha=0.15)
    left.set(xlabel="epoch", ylabel="loss", yscale="log")
    left.legend(loc="upper right")
    right.plot(numbers, [epoch.difference for epoch in epochs], "o-", color=ACCENT, markersize=3)
    right.set(xlabel="epoch", ylabel="difference over the board, levels RMS", yscale="log")
    return figure


def _gamma_section(gamma: GammaMatch) -> ReportSection:
    rows = tuple(
        (
            str(number),
            f"{epoch.parameters.white:.4f}",
            f"{epoch.parameters.response.a:.4f}",
            f"{epoch.parameters.response.b:.4f}",
            f"{epoch.parameters.response.g:.4f}",
            f"{epoch.sum_of_squares:.2g}",
        )
        for number, epoch in enumerate(gamma.epochs)
    )
    table = ReportTable(
        ("Epoch", "W", "a", "b", "g", "Sum of squares"), rows, "a + b = 1; W is the scale of all levels."
    )
    drawn = ReportFigure.of(
        gamma_curves(gamma),
        "Response by epoch",
        "Levels seen by bench and twin by epoch, and their difference.",
        True,
    )
    return ReportSection("Gamma matching", tables=(table,), figures=(drawn,))


@as_png
def gamma_curves(gamma: GammaMatch) -> Sheet:
    """Draw the levels seen against the levels shown, of the bench and of the twin in every epoch."""
    figure, (left, right) = side_by_side(3.0, (1.2, 1.0))
    for number, epoch in enumerate(gamma.epochs):
        shade = 0.25 + 0.75 * (number + 1) / len(gamma.epochs)
        left.plot(gamma.shown, epoch.levels, "-", color=ACCENT, alpha=shade, label=f"twin, epoch {number}")
        right.plot(gamma.shown, 255 * (epoch.levels - gamma.recorded), "-", color=ACCENT, alpha=shade)
    left.plot(gamma.shown, gamma.recorded, "o", color=SECOND, markersize=3.5, label="bench")
    left.set(xlabel="level shown, of full scale", ylabel="level seen, of full scale")
    left.legend(loc="upper left")
    right.axhline(0, color=SECOND, linewidth=1.0)
    right.set(xlabel="level shown, of full scale", ylabel="twin − bench, in grey levels of 255")
    return figure


def _poses_section(matching: MatchingResult) -> ReportSection:
    keys = ("ssim", "ssim_board", "epsilon_d_px")
    titles = ("SSIM", "SSIM over the board", "ε_d in px")
    rows = tuple(
        (
            figures["pose"],
            *(_figure(figures.get(f"{key}_{when}")) for key in keys for when in ("before", "after")),
        )
        for figures in matching.by_pose()
    )
    columns = ("Pose", *(f"{title} {when}" for title in titles for when in ("before", "after")))
    return ReportSection("Poses", tables=(ReportTable(columns, rows, _flatness(matching.reference)),))


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"


def _flatness(reference: Reference) -> str:
    """State how far the bench's board is from flat, since the twin's is flat."""
    characterisation = reference.characterisation
    if characterisation.drawn is None:
        return "ε_d: the bench's RMS reprojection error less the twin's."
    heights = 1e3 * (characterisation.board[:, 2] - characterisation.drawn[:, 2])
    return (
        f"The bench's board deviates from its plane by {np.sqrt(np.mean(heights**2)):.0f} µm RMS, "
        f"{np.ptp(heights):.0f} µm from lowest to highest point; the twin's board is flat."
    )


def _images_section(matching: MatchingResult, twin: Twin) -> ReportSection:
    reference, figures = matching.reference, []
    images = reference.finest[:1]
    looks = matching.appearance.appearance if matching.appearance else Appearance()
    for pose in reference.spread_poses(5):  # from the nearest to the farthest
        before, after = (
            _seen(reference, twin, *at, pose, images)
            for at in ((matching.nominal, Appearance()), (matching.matched.parameters, looks))
        )
        real = reference.frames(pose, images)[0]
        name = reference.sessions[pose].path.name
        caption = (
            f"{name}. Top: the bench and the matched twin. Bottom: the bench less the twin before and after."
        )
        figures.append(
            ReportFigure.of(difference_images(real, before, after), f"Images of {name}", caption, wide=True)
        )
    return ReportSection("Images", figures=tuple(figures))


def _seen(
    reference: Reference,
    twin: Twin,
    parameters: TwinParameters,
    appearance: Appearance,
    pose: int,
    images: Sequence[int],
) -> GreyPicture:
    shown = twin.with_parameters(parameters).with_appearance(appearance)
    return np.asarray(shown.expected(pose, reference.shown(images), reference.settings)[0])


@as_png
def difference_images(real: GreyPicture, before: GreyPicture, after: GreyPicture) -> Sheet:
    """Draw the bench's image, the matched twin's, and the differences before and after the matching."""
    figure = new_figure(FULL, 2 * map_height(real.shape, FULL / 2))
    (a, b), (c, d) = cast(Any, figure.subplots(2, 2))
    bright = max(float(np.percentile(real, 99.8)), 1.0)
    for axes, image, title in ((a, real, "bench"), (b, after, "matched twin")):
        draw_map(axes, image, "gray", (0.0, bright))
        axes.set_title(title, fontsize=8.5)
    for axes, image, title in ((c, real - before, "difference before"), (d, real - after, "after")):
        limit = max(float(np.percentile(np.abs(image), 99.5)), 1.0)
        drawn = draw_map(axes, image, "RdBu_r", (-limit, limit))
        colour_bar(figure, axes, drawn, "levels")
        axes.set_title(title, fontsize=8.5)
    return figure


def parameter_comparison(before: TwinParameters, after: TwinParameters) -> list[tuple[str, str, str, str]]:
    """Name, both values and standard uncertainty of parameters, without effects that neither twin has."""
    numbers, matched = named_numbers(before), named_numbers(after)
    rows = []
    for name, value in numbers.items():
        known = next(entry for key, entry in TABLE.items() if name in (key, *entry.parts))
        if not known.reported_at_zero and not any(twin.has(known) for twin in (before, after)):
            continue
        texts = [
            known.reported_none if figure is None else f"{figure:.4g}" for figure in (value, matched[name])
        ]
        rows.append((name, texts[0], texts[1], _sigma_text(after, name)))
    return rows


def _sigma_text(parameters: TwinParameters, name: str) -> str:
    return f"{parameters.sigma[name]:.2g}" if name in parameters.sigma else ""


def _parameters_section(matching: MatchingResult) -> ReportSection:
    before, after = matching.nominal, matching.matched.parameters
    rows = parameter_comparison(before, after)
    rows += [
        (
            f"response {name}",
            f"{getattr(before.response, name):.4g}",
            f"{getattr(after.response, name):.4g}",
            _sigma_text(after, name),
        )
        for name in "abg"
    ]
    baselines = [f"{parameters.calibration.baseline_mm:.3f}" for parameters in (before, after)]
    rows.append(("baseline in mm", baselines[0], baselines[1], ""))
    if "poses_um" in after.sigma:
        rows.append(("poses of the board in µm", "", "", _sigma_text(after, "poses_um")))
    columns = ("Parameter", "Before", "Matched", "Standard uncertainty")
    notes = "; ".join(matching.notes)
    return ReportSection("Parameters", notes, (ReportTable(columns, tuple(rows)),))


def _surfaces_section(surfaces: Sequence[SurfaceMatch]) -> ReportSection:
    columns = ("Part", "Kind", "Property", "Value", "Standard uncertainty", "Explained", "Left of the levels")
    rows = tuple(
        (
            match.scan.item,
            match.surface.kind,
            name,
            f"{getattr(match.surface, name):.4g}",
            f"{sigma:.2g}",
            f"{100 * match.explained:.0f} %",
            f"{100 * match.unexplained:.1f} %",
        )
        for match in surfaces
        for name, sigma in match.surface.sigma.items()
    )
    note = "Explained: share of the mean square difference to the surface of the twin's own file."
    return ReportSection("Surfaces of parts", note, (ReportTable(columns, rows),))


def _artefact_section(artefact: ArtefactComparison) -> ReportSection:
    figures = tuple(
        ReportFigure.of(
            error_map(cloud, comparison.distances_mm, comparison.counted),
            f"Errors of the {who}",
            f"{who.capitalize()}: signed distance from the true shape.",
        )
        for who, cloud, comparison in (
            ("bench", artefact.reference_cloud, artefact.reference),
            ("twin", artefact.twin_cloud, artefact.twin),
        )
    )
    return ReportSection(f"Artefact {artefact.item}", figures=figures)
