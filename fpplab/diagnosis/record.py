"""The verdict on a scan as a file inside its session, so that later reports need not judge again."""

from pathlib import Path
from typing import Any

from pydantic import AliasChoices, Field, field_validator

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.errors import ConfigError
from fpplab.core.files import write_text
from fpplab.core.origin import Origin
from fpplab.core.session_names import VERDICT
from fpplab.diagnosis.catalogue import cause_named
from fpplab.diagnosis.criteria import Criterion
from fpplab.diagnosis.finding import Finding
from fpplab.diagnosis.verdict import Diagnosis, Verdict


class FindingFile(Document):
    """A finding in a file."""

    cause: str
    """What is wrong: the key of a cause."""
    evidence: str
    """How it shows."""
    remedy: str
    """What to do."""
    excess: float
    """Measured value over its limit."""

    @field_validator("cause")
    @classmethod
    def _known_cause(cls, cause: str) -> str:
        try:
            return cause_named(cause).key
        except ConfigError as error:
            raise ValueError(str(error)) from error


class DiagnosisFile(Origin):
    """A verdict in a file, with when and by which program it was given."""

    verdict: Verdict
    """Whether to believe the points."""
    reason: str
    """One sentence."""
    findings: tuple[FindingFile, ...]
    """What is wrong, the worst first."""
    unverified: tuple[str, ...] = Field(validation_alias=AliasChoices("unverified", "not_checked"))
    """What nothing checked, and why; version 0.1 calls it `not_checked`."""
    criteria: tuple[Criterion, ...] = ()
    """What the verdict was given by; older files have none."""
    limits: dict[str, dict[str, Any]] | None = None
    """Limits of an expert that are not the usual ones, by section and name."""

    def diagnosis(self) -> Diagnosis:
        findings = tuple(
            Finding(cause_named(finding.cause), finding.evidence, finding.excess, finding.remedy)
            for finding in self.findings
        )
        limits = self.limits or {}
        return Diagnosis(self.verdict, self.reason, findings, self.unverified, self.criteria, limits)


def save_diagnosis(diagnosis: Diagnosis, folder: Path) -> None:
    findings = tuple(
        FindingFile(
            cause=finding.cause.key,
            evidence=finding.evidence,
            remedy=finding.remedy,
            excess=min(float(finding.excess), 1e9),  # a file holds no infinite number
        )
        for finding in diagnosis.findings
    )
    file = DiagnosisFile.now(
        verdict=diagnosis.verdict,
        reason=diagnosis.reason,
        findings=findings,
        unverified=tuple(diagnosis.unknown),
        criteria=tuple(diagnosis.criteria),
        limits={name: dict(values) for name, values in diagnosis.changed_limits.items()} or None,
    )
    write_text(folder / VERDICT, config.dump(file))


def load_diagnosis(folder: Path) -> DiagnosisFile | None:
    path = folder / VERDICT
    return config.load_document(path, DiagnosisFile) if path.is_file() else None
