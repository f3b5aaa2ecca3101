"""A picture for every finding: the frame, map or curve in which its cause shows, with its limit."""

from collections.abc import Sequence

from fpplab.core.drawing import common_style, encode_png
from fpplab.diagnosis import Finding
from fpplab.diagnosis.evidence import Evidence
from fpplab.report.parts import ReportFigure


def evidence_pictures(findings: Sequence[Finding], evidence: Evidence) -> list[tuple[Finding, bytes]]:
    pictures = [(finding, _draw_finding(finding, evidence)) for finding in findings]
    return [(finding, picture) for finding, picture in pictures if picture is not None]


def _draw_finding(finding: Finding, evidence: Evidence) -> bytes | None:
    picture = finding.cause.picture
    if picture is None or not evidence.has(picture.needs):
        return None
    with common_style():
        figure = picture.draw(evidence, finding)
        return None if figure is None else encode_png(figure)


def evidence_report(findings: Sequence[Finding], evidence: Evidence) -> tuple[ReportFigure, ...]:
    return tuple(
        ReportFigure.of(
            picture, f"What shows {_name(finding)}", f"{_name(finding).capitalize()}: {finding.evidence}."
        )
        for finding, picture in evidence_pictures(findings, evidence)
    )


def _name(finding: Finding) -> str:
    return finding.cause.key.replace("_", " ")
