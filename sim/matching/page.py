"""A matching as a page: the paper's table, the loss by epoch, what each effect explains, and images."""

from __future__ import annotations

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

GreyPicture = NDArray[np.float32]
"""Image [v, u] in raw levels."""

COLUMNS = ("Refined", "Response", "SSIM", "SSIM over the board", "ε_d in px", "Loss", "Loss over the board")
SHOWN_POSES = 5
"""Poses whose images are shown, from the nearest to the farthest."""


def write_matching_report(
    path: Path,
    found: MatchingResult,
    twin: Twin,
    answer: Mapping[str, Any] | None = None,
    provenance: Mapping[str, Provenance] | None = None,
) -> None:
    """Write a matching as one HTML file."""
    sections = [_epochs_section(found)]
    if found.gamma:
        sections.append(_gamma_section(found.gamma))
    if found.appearance:
        sections.append(_appearance_section(found.appearance))
    sections += [_poses_section(found), _images_section(found, twin), _parameters_section(found)]
    if found.surfaces:
        sections.append(_surfaces_section(found.surfaces))
    sections += [_artefact_section(one) for one in found.artefacts]
    facts = {
        "Ended": found.matched.ended,
        "Poses": str(len(found.matched.parameters.poses)),
        "Unexplained difference": f"{found.matched.unexplained:.2f} levels RMS over the board",
    }
    basis = PageBasis((PageVerdict.of(found.diagnosis),), provenance or {}, answer or {})
    write_page(path, "Matching of a twin", _summary(found), sections, facts, basis=basis)


def matching_provenance(found: MatchingResult, scans: Mapping[str, Session]) -> dict[str, Provenance]:
    """Tell which recordings a twin was matched to and judged by."""
    known = found.reference.characterisation.calibration
    poses = poses_provenance(found.reference.sessions, known)
    return {"poses": poses, **{item: session_provenance(scan, known) for item, scan in scans.items()}}


def _summary(found: MatchingResult) -> list[ReportTable]:
    rows = tuple(
        (
            "yes" if row.refined else "no",
            "matched" if row.gamma else "nominal",
            *(f"{row.loss[k]:.4f}" for k in ("ssim", "ssim_board", "epsilon_d_px", "loss", "loss_board")),
        )
        for row in found.rows
    )
    tables = [
        ReportTable(
            COLUMNS, rows, "L = α log(1 + |ε_d|) + β (1 − SSIM); the twin's images contain its noise."
        )
    ]
    if found.artefacts:
        judged = tuple(
            (
                one.item,
                f"{one.reference_um:.1f}",
                f"{one.twin_um:.1f}",
                f"{one.delta_um:+.1f}",
                f"{one.summary()['delta_percent']:.1f}",
            )
            for one in found.artefacts
        )
        columns = ("Artefact", "Bench in µm", "Twin in µm", "Difference in µm", "Difference in %")
        tables.append(
            ReportTable(columns, judged, "Symmetric mean distance between points and true surface.")
        )
    return tables


def _epochs_section(found: MatchingResult) -> ReportSection:
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
        for epoch in found.matched.epochs
    )
    explained = tuple(
        (step, f"{100 * share:.1f} %", EXPLAINS.get(step, "a flat board casts no shadow"))
        for step, share in found.matched.explained.items()
    )
    words = ReportTable(
        ("Effect", "Share", "What it is"),
        explained,
        "Share of the images' mean square difference before the step of each effect that it removed.",
    )
    drawn = ReportFigure.of(
        loss_curve(found.matched.epochs),
        "Loss by epoch",
        "Loss with its spread over the images, and RMS difference, by epoch. Hollow: rejected epochs.",
        wide=True,
    )
    return ReportSection("Epochs", tables=(ReportTable(columns, rows), words), figures=(drawn,))


def _appearance_section(found: AppearanceTrial) -> ReportSection:
    rows = tuple(
        (name, f"{part.ssim_without:.4f}", f"{part.ssim_with:.4f}", "yes" if part.accepted else "no")
        for name, part in (("Board's sheet", found.sheet), ("Surroundings", found.surroundings))
    )
    words = (
        f"SSIM in {found.pose}, from which they were not found: of the sheet over the board, of the "
        "surroundings over whole images. What is accepted is part of the twin."
    )
    table = ReportTable(("Part", "SSIM without", "SSIM with", "Accepted"), rows, words)
    return ReportSection("Sheet and surroundings", tables=(table,))


@as_png
def loss_curve(epochs: Sequence[MatchingEpoch]) -> Sheet:
    """Draw loss and difference by epoch; rejected ones are hollow, the band is the images' spread."""
    figure, (left, right) = side_by_side(3.0, (1.4, 1.0))
    numbers = [epoch.epoch for epoch in epochs]
    for key, colour, words in (("loss", ACCENT, "whole image"), ("loss_board", SECOND, "over the board")):
        values = np.array([epoch.loss[key] for epoch in epochs])
        left.plot(numbers, values, "-", color=colour, linewidth=1.2, label=words)
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


def _gamma_section(found: GammaMatch) -> ReportSection:
    rows = tuple(
        (
            str(number),
            f"{epoch.parameters.white:.4f}",
            f"{epoch.parameters.response.a:.4f}",
            f"{epoch.parameters.response.b:.4f}",
            f"{epoch.parameters.response.g:.4f}",
            f"{epoch.sum_of_squares:.2g}",
        )
        for number, epoch in enumerate(found.epochs)
    )
    table = ReportTable(
        ("Epoch", "W", "a", "b", "g", "Sum of squares"), rows, "a + b = 1; W is the scale of all levels."
    )
    drawn = ReportFigure.of(
        gamma_curves(found),
        "Response by epoch",
        "Levels seen by bench and twin by epoch, and their difference.",
        True,
    )
    return ReportSection("Gamma matching", tables=(table,), figures=(drawn,))


@as_png
def gamma_curves(found: GammaMatch) -> Sheet:
    """Draw the levels seen against the levels shown, of the bench and of the twin in every epoch."""
    figure, (left, right) = side_by_side(3.0, (1.2, 1.0))
    for number, epoch in enumerate(found.epochs):
        shade = 0.25 + 0.75 * (number + 1) / len(found.epochs)
        left.plot(found.shown, epoch.levels, "-", color=ACCENT, alpha=shade, label=f"twin, epoch {number}")
        right.plot(found.shown, 255 * (epoch.levels - found.seen), "-", color=ACCENT, alpha=shade)
    left.plot(found.shown, found.seen, "o", color=SECOND, markersize=3.5, label="bench")
    left.set(xlabel="level shown, of full scale", ylabel="level seen, of full scale")
    left.legend(loc="upper left")
    right.axhline(0, color=SECOND, linewidth=1.0)
    right.set(xlabel="level shown, of full scale", ylabel="twin − bench, in grey levels of 255")
    return figure


def _poses_section(found: MatchingResult) -> ReportSection:
    keys = ("ssim", "ssim_board", "epsilon_d_px")
    words = ("SSIM", "SSIM over the board", "ε_d in px")
    rows = tuple(
        (
            one["pose"],
            *(_figure(one.get(f"{key}_{when}")) for key in keys for when in ("before", "after")),
        )
        for one in found.by_pose()
    )
    columns = ("Pose", *(f"{word} {when}" for word in words for when in ("before", "after")))
    return ReportSection("Poses", tables=(ReportTable(columns, rows, _flatness(found.reference)),))


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"


def _flatness(reference: Reference) -> str:
    """State how far the bench's board is from flat, since the twin's is flat."""
    found = reference.characterisation
    if found.drawn is None:
        return "ε_d: the bench's RMS reprojection error less the twin's."
    heights = 1e3 * (found.board[:, 2] - found.drawn[:, 2])
    return (
        f"The bench's board deviates from its plane by {np.sqrt(np.mean(heights**2)):.0f} µm RMS, "
        f"{np.ptp(heights):.0f} µm from lowest to highest point; the twin's board is flat."
    )


def _images_section(found: MatchingResult, twin: Twin) -> ReportSection:
    reference, figures = found.reference, []
    images = reference.finest[:1]
    looks = found.appearance.found if found.appearance else Appearance()
    for pose in reference.spread_poses(SHOWN_POSES):
        before, after = (
            _seen(reference, twin, *at, pose, images)
            for at in ((found.nominal, Appearance()), (found.matched.parameters, looks))
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


def _parameters_section(found: MatchingResult) -> ReportSection:
    before, after = found.nominal, found.matched.parameters

    def word(name: str, value: float | None) -> str:
        if value is None:
            return "another in each frame" if name == "band_advance" else "sharp at all depths"
        return f"{value:.4g}"

    def sigma(name: str) -> str:
        return f"{after.sigma[name]:.2g}" if name in after.sigma else ""

    numbers, matched = named_numbers(before), named_numbers(after)
    rows = [
        (name, word(name, value), word(name, matched[name]), sigma(name))
        for name, value in numbers.items()
        if _is_reported(name, before, after)
    ]
    rows += [
        (f"response {k}", word(k, getattr(before.response, k)), word(k, getattr(after.response, k)), sigma(k))
        for k in "abg"
    ]
    baselines = [f"{one.calibration.baseline_mm:.3f}" for one in (before, after)]
    rows.append(("baseline in mm", baselines[0], baselines[1], ""))
    if "poses_um" in after.sigma:
        rows.append(("poses of the board in µm", "", "", sigma("poses_um")))
    columns = ("Parameter", "Before", "Matched", "Standard uncertainty")
    notes = "; ".join(found.notes)
    return ReportSection("Parameters", notes, (ReportTable(columns, tuple(rows)),))


def _is_reported(name: str, *twins: TwinParameters) -> bool:
    """Whether a parameter belongs to an effect that one of the twins has, such as a lamp of the room."""
    known = next(one for key, one in TABLE.items() if name in (key, *one.parts))
    return known.reported_at_zero or any(known.is_present(one) for one in twins)


def _surfaces_section(surfaces: Sequence[SurfaceMatch]) -> ReportSection:
    columns = ("Part", "Kind", "Property", "Value", "Standard uncertainty", "Explained", "Left of the levels")
    rows = tuple(
        (
            one.scan.item,
            one.surface.kind,
            name,
            f"{getattr(one.surface, name):.4g}",
            f"{sigma:.2g}",
            f"{100 * one.explained:.0f} %",
            f"{100 * one.unexplained:.1f} %",
        )
        for one in surfaces
        for name, sigma in one.surface.sigma.items()
    )
    note = "Explained: share of the mean square difference to the surface of the twin's own file."
    return ReportSection("Surfaces of parts", note, (ReportTable(columns, rows),))


def _artefact_section(one: ArtefactComparison) -> ReportSection:
    figures = tuple(
        ReportFigure.of(
            error_map(cloud, comparison.distances_mm, comparison.counted),
            f"Errors of the {who}",
            f"{who.capitalize()}: signed distance from the true shape.",
        )
        for who, cloud, comparison in (
            ("bench", one.reference_cloud, one.reference),
            ("twin", one.twin_cloud, one.twin),
        )
    )
    return ReportSection(f"Artefact {one.item}", figures=figures)
