"""The result of `fpplab check`: what is wrong with a rig, and what shows it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.calibration.model import Calibration
from fpplab.results.characterisation import CorrectionResult, JudgementResult
from fpplab.results.provenance import Provenance
from fpplab.setup.rig_check.check import RigCheck


@dataclass(frozen=True, eq=False)
class CheckResult:
    """What a check found, with what it was measured, and what was written."""

    check: RigCheck
    calibration: Calibration | None  # that was checked too
    provenance: Provenance
    report_file: Path | None = None
    picture_files: tuple[Path, ...] = ()  # of the findings and the levels

    def summary(self) -> dict[str, Any]:
        return {
            **self.check.summary(),
            "provenance": self.provenance.summary(),
            "report": None if self.report_file is None else str(self.report_file),
            "pictures": [str(path) for path in self.picture_files],
        }


@dataclass(frozen=True, eq=False)
class BoardCheckResult:
    """What one pose of the board says about a rig's calibration."""

    judged: JudgementResult
    corrected: CorrectionResult | None  # where the pose contradicts the calibration

    def summary(self) -> dict[str, Any]:
        corrected = {} if self.corrected is None else {"corrected": self.corrected.summary()}
        return {**self.judged.summary(), **corrected}
