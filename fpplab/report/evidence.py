"""A picture for every finding: the frame, map or curve in which its cause shows, with its limit."""

from __future__ import annotations

from collections.abc import Sequence

from fpplab.core.drawing import common_style, encode_png
from fpplab.diagnosis import Finding
from fpplab.diagnosis.evidence import Evidence
from fpplab.report.parts import ReportFigure


def evidence_pictures(findings: Sequence[Finding], given: Evidence) -> list[tuple[Finding, bytes]]:
    """Draw what shows each finding."""
    pictures = [(one, _drawn(one, given)) for one in findings]
    return [(one, picture) for one, picture in pictures if picture is not None]


def _drawn(finding: Finding, given: Evidence) -> bytes | None:
    picture = finding.cause.picture
    if picture is None or not given.has(picture.needs):
        return None
    with common_style():
        figure = picture.draw(given, finding)
        return None if figure is None else encode_png(figure)


def evidence_report(findings: Sequence[Finding], given: Evidence) -> tuple[ReportFigure, ...]:
    """Draw what shows each finding, as figures of a page."""
    return tuple(
        ReportFigure.of(picture, f"What shows {_name(one)}", f"{_name(one).capitalize()}: {one.evidence}.")
        for one, picture in evidence_pictures(findings, given)
    )


def _name(finding: Finding) -> str:
    return finding.cause.key.replace("_", " ")
