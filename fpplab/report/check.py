"""The page of `fpplab check`: what is wrong with a rig, and what its camera sees."""

from pathlib import Path

import numpy as np

from fpplab.core.errors import DataError
from fpplab.core.files import write_parts
from fpplab.diagnosis.evidence import Evidence
from fpplab.report.evidence import evidence_pictures, evidence_report
from fpplab.report.maps import camera_image
from fpplab.report.page import PageBasis, write_page
from fpplab.report.parts import PageVerdict, ReportFigure, ReportSection, ReportTable, listed
from fpplab.report.response_figures import marker_levels
from fpplab.report.wording import NOT_KNOWN, percent_text
from fpplab.results.check import CheckResult
from fpplab.setup.rig_check.check import RigCheck


def write_check_report(path: Path, result: CheckResult) -> None:
    check = result.check
    basis = PageBasis((check_verdict(check),), {"rig": result.provenance}, check.summary())
    write_page(path, "Check of a rig", [], _sections(check, evidence_of(result)), verdicts_and_sources=basis)


def write_check_pictures(out: Path, result: CheckResult) -> tuple[Path, ...]:
    evidence = evidence_of(result)
    levels = marker_levels(result.check.shown, evidence.runs) if evidence.runs else None
    if out.suffix == ".png":
        pictures = {out: levels} if levels else {}
    else:
        _make_folder(out)
        findings = result.check.findings
        pictures = {
            out / f"{1 + findings.index(finding):02d}_{finding.cause.key}.png": picture
            for finding, picture in evidence_pictures(findings, evidence)
        }
        if levels:
            pictures[out / "levels.png"] = levels
    for path, picture in pictures.items():
        write_parts(path, picture)
    return tuple(pictures)


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{path}: cannot be made: {error}; choose another --out") from error


def check_verdict(check: RigCheck) -> PageVerdict:
    if not check.findings:
        sentence = "Nothing is wrong with what was checked."
        return PageVerdict("", "good", "In order", sentence, unknown=check.unknown)
    label = "1 finding" if len(check.findings) == 1 else f"{len(check.findings)} findings"
    reason = "Measure only after what follows is fixed, the first finding first."
    return PageVerdict("", "doubtful", label, reason, listed(check.findings), check.unknown)


def evidence_of(result: CheckResult) -> Evidence:
    check = result.check
    runs = {run.how: run.levels for run in check.runs}
    return Evidence(check.recording, check.decoded, check.cloud, result.calibration, check.shown, runs)


def _sections(check: RigCheck, evidence: Evidence) -> list[ReportSection]:
    sections = []
    if shown := evidence_report(check.findings, evidence):
        sections.append(ReportSection("What shows it", figures=shown))
    if check.recording is not None:
        drawn = camera_image(check.recording.mean_image())
        alt, caption = "Camera image, the mean of all frames with fringes", "Mean of the frames with fringes."
        sections.append(
            ReportSection("What the camera sees", figures=(ReportFigure.of(drawn, alt, caption),))
        )
    runs = {run.how: run.levels for run in check.runs}
    if runs:
        measured = any(np.isfinite(levels).any() for levels in runs.values())
        pictures = (_marker_figure(check),) if measured else ()
        sections.append(
            ReportSection("Synchronisation", _settling_sentence(check), (_levels_table(check),), pictures)
        )
    return sections


def _settling_sentence(check: RigCheck) -> str:
    text = "Uniform grey-level images, each of which must appear in its own frame."
    if check.settle_s is not None:
        text += f" A stepped plan needs a settling time of {check.settle_s:g} s."
    return text


def _marker_figure(check: RigCheck) -> ReportFigure:
    drawn = marker_levels(check.shown, {run.how: run.levels for run in check.runs})
    caption = "Levels seen in each frame, and those expected of frames in step."
    return ReportFigure.of(drawn, "Levels seen frame by frame", caption, wide=True)


def _levels_table(check: RigCheck) -> ReportTable:
    rows = tuple(
        (str(k), str(shown), *(_level(run.levels[k]) for run in check.runs))
        for k, shown in enumerate(check.shown.tolist())
    )
    columns = ("Frame", "Level shown, of 255", *(f"Seen, {run.how}" for run in check.runs))
    return ReportTable(columns, rows, "Levels seen as shares of full scale.")


def _level(level: float) -> str:
    return percent_text(level) if np.isfinite(level) else NOT_KNOWN
