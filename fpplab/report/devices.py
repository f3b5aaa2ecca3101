"""Sections of the report on camera and projector: a characterisation, and the judgement of one."""

from collections.abc import Iterator

import numpy as np

from fpplab.characterisation import Characterisation, Judgement
from fpplab.characterisation.limits import USUAL_LIMITS
from fpplab.characterisation.validation import Repeat
from fpplab.report import characterisation_figures as drawn
from fpplab.report import figures
from fpplab.report.parts import PageVerdict, ReportFigure, ReportSection, ReportTable
from fpplab.report.wording import NOT_KNOWN

CHARACTERISED = (
    "Characterisation",
    "RMS in px",
    "Leave-one-out RMS in px",
    "RMS fitted separately in px",
    "Focal length in px",
    "Principal point in px",
)
REPROJECTION = (
    "RMS: reprojection error of the board's points. Leave-one-out: the same for each pose, with the devices "
    "fitted to all other poses."
)
JACKKNIFE = (
    ("Each pose left out", "Changed", "Predicted", "Stated uncertainty", "Changed over predicted", ""),
    "Changed: standard deviation that the calibrations without each pose in turn have (jackknife). "
    "Predicted: the same by the covariances, with and without the pose. Place and form: of points where the "
    "boards stood, root mean square; form without rigid motion. Without the board's scale, as "
    "every pose has the same.",
)
HALVES = (
    ("Halves of the poses", "Difference", "Predicted", "Stated uncertainty", "Difference over predicted", ""),
    "Calibrations from every other pose and from the rest. Predicted: from both covariances; a single "
    "difference may well be twice as great or a fraction.",
)
JUDGED = ("Pose", "Points", "Camera in px", "Predicted", "Projector in px", "Predicted", "")
JUDGED_CAPTION = (
    "RMS reprojection errors in poses that the calibration was not fitted to, and those that it predicts: "
    "noise, what errors of one pose share, and the uncertainty of the devices."
)


def summary_table(characterisation: Characterisation) -> ReportTable:
    return ReportTable(
        CHARACTERISED, tuple(_device_row(characterisation, d) for d in ("camera", "projector")), REPROJECTION
    )


def _device_row(characterisation: Characterisation, name: str) -> tuple[str, ...]:
    calibration, leave_one_out = characterisation.calibration, characterisation.leave_one_out_px or {}
    matrix = (calibration.camera if name == "camera" else calibration.projector).matrix
    focal = (
        _with_sigma(characterisation, matrix[i, i], f"{name}.{key}") for i, key in enumerate(("fx", "fy"))
    )
    centre = (
        _with_sigma(characterisation, matrix[i, 2], f"{name}.{key}") for i, key in enumerate(("cx", "cy"))
    )
    return (
        name.capitalize(),
        f"{calibration.rms_px[name]:.3f}",
        f"{leave_one_out[name]:.3f}" if leave_one_out else NOT_KNOWN,
        f"{characterisation.separate_px[name]:.3f}",
        " / ".join(focal),
        " / ".join(centre),
    )


def _with_sigma(characterisation: Characterisation, value: float, name: str) -> str:
    return (
        f"{value:.1f} ± {characterisation.sigma[name]:.1f}"
        if name in characterisation.sigma
        else f"{value:.1f}"
    )


def characterisation_section(characterisation: Characterisation) -> ReportSection:
    calibration, observations = characterisation.calibration, characterisation.observations
    rms = characterisation.pose_rms_px
    bars = figures.pose_rms(
        list(rms), [r["camera"] for r in rms.values()], [r["projector"] for r in rms.values()]
    )
    pictures = [
        ReportFigure.of(
            bars, "Bars: RMS error of each pose", "RMS reprojection error of each pose.", wide=True
        )
    ]
    pictures += _device_figures(characterisation)
    pictures.append(
        ReportFigure.of(
            drawn.epipolar_figure(characterisation), "Epipolar distances by pose", drawn.EPIPOLAR, wide=True
        )
    )
    if characterisation.solution is not None and characterisation.sizes is not None:
        scales = drawn.scales_by_pose(characterisation)
        pictures.append(ReportFigure.of(scales, "Scale of the camera's image by pose", drawn.SCALES))
    if characterisation.drawn is not None:
        shape = drawn.board_shape(characterisation)
        pictures.append(ReportFigure.of(shape, "Shape of the board as refined", drawn.BOARD, wide=True))
    joint, baseline = calibration.rms_px["joint"], calibration.baseline_mm
    text = f"{characterisation.points} points in {len(observations)} poses; joint RMS {joint:.3f} px."
    text += f" Baseline {baseline:.2f} mm."
    if calibration.uncertainty:
        pictures.append(
            ReportFigure.of(
                drawn.uncertainty_maps(characterisation), "Projected uncertainty", drawn.MAPS, wide=True
            )
        )
    left_out = tuple(characterisation.left_out.items())
    tables = (ReportTable(("Pose left out", "Why"), left_out, has_sentences=True),) if left_out else ()
    return ReportSection("Characterisation", text, (*_validation(characterisation), *tables), tuple(pictures))


def _device_figures(characterisation: Characterisation) -> Iterator[ReportFigure]:
    devices = characterisation.by_device
    for device, seen in devices.items():
        pixels, residuals = np.concatenate(seen.pixels), np.concatenate(seen.residuals)
        picture = figures.residuals_figure(pixels, residuals, seen.size, device)
        caption = (
            f"Reprojection errors of the {device}, model minus observation: over its pixels, and as a "
            "scatter plot."
        )
        yield ReportFigure.of(picture, f"Reprojection errors of the {device}", caption, wide=True)
    for device, seen in devices.items():
        picture = figures.draw_coverage(seen.pixels, seen.size, device)
        caption = (
            f"Where the board's points were on the {device}, one colour per pose. A warning names "
            "ninths of the image that both devices see and that have no points."
        )
        yield ReportFigure.of(picture, f"Points of the board over the {device}'s pixels", caption)


def _validation(characterisation: Characterisation) -> tuple[ReportTable, ...]:
    if characterisation.validation is None:
        return ()
    both = ((JACKKNIFE, characterisation.validation.jackknife), (HALVES, characterisation.validation.halves))
    return tuple(
        ReportTable(columns, tuple(_repeat_row(repeat) for repeat in repeats), caption)
        for (columns, caption), repeats in both
        if repeats
    )


def _repeat_row(repeat: Repeat) -> tuple[str, ...]:
    figures_of = (repeat.changed, repeat.predicted, repeat.stated)
    return (
        f"{repeat.quantity} in {repeat.unit}",
        *(f"{x:.3g}" for x in figures_of),
        f"{repeat.ratio:.2f}",
        "greater than chance" if repeat.chance < USUAL_LIMITS.max_chance else "",
    )


def judgement_verdict(judgement: Judgement) -> PageVerdict:
    sentence = judgement.verdict[0].upper() + judgement.verdict[1:] + "."
    if judgement.contradicted:
        return PageVerdict("", "useless", "Contradicted", sentence)
    return PageVerdict("", "good", "Confirmed", sentence)


def judgement_section(judgement: Judgement) -> ReportSection:
    rows = [(p.name, str(p.points), p.camera, p.projector) for p in judgement.poses]
    rows.append(("all", str(sum(p.points for p in judgement.poses)), judgement.camera, judgement.projector))
    cells = tuple(
        (name, points, *(f"{x:.3f}" for e in (camera, projector) for x in (e.rms_px, e.predicted_px)),
         "contradicts" if camera.contradicts or projector.contradicts else "")
        for name, points, camera, projector in rows
    )  # fmt: skip
    picture = ReportFigure.of(
        drawn.judged_errors(judgement),
        "Bars: errors of each pose, with those predicted",
        drawn.JUDGED,
        wide=True,
    )
    left_out = tuple(judgement.left_out.items())
    tables = [ReportTable(JUDGED, cells, JUDGED_CAPTION)]
    if left_out:
        tables.append(ReportTable(("Pose left out", "Why"), left_out, has_sentences=True))
    return ReportSection(
        "Judgement", judgement.verdict[0].upper() + judgement.verdict[1:] + ".", tuple(tables), (picture,)
    )
