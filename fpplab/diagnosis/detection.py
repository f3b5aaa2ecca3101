"""Looking for all causes in what is known of a scan."""

from collections.abc import Iterable

from fpplab.diagnosis.catalogue import known_causes
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import DetectionStage, Finding

FRAME_STAGES = (DetectionStage.VISIBILITY, DetectionStage.COLOUR, DetectionStage.FRAMES, DetectionStage.BLUR)
"""Stages that need frames alone."""


def find_causes(
    evidence: Evidence, stages: Iterable[DetectionStage] = tuple(DetectionStage)
) -> list[Finding]:
    """Look for causes stage by stage, but for stages that a finding makes meaningless."""
    findings: list[Finding] = []
    for stage in sorted(stages):
        if not _is_possible(stage, evidence) or any(
            stage in finding.cause.invalidates for finding in findings
        ):
            continue
        before = tuple(findings)
        for cause in known_causes().values():
            for detector in cause.detectors:
                if detector.stage is not stage:
                    continue
                new = list(detector.find(evidence, before))
                if detector.replaces and new:
                    findings = [finding for finding in findings if finding.cause != cause]
                findings += new
    return findings


def _is_possible(stage: DetectionStage, evidence: Evidence) -> bool:
    if stage in (DetectionStage.REFLECTIONS, DetectionStage.POINTS):
        return evidence.has_points
    if stage is DetectionStage.PLAN:
        return evidence.calibration is not None and evidence.decoded is not None
    return True
