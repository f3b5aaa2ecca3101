"""The results of `fpplab characterise`: a calibration from poses of a board, and the judgement of one."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.characterisation import Characterisation, Combination, Correction, Judgement
from fpplab.diagnosis import Diagnosis
from fpplab.results.provenance import Provenance
from fpplab.setup.guide import GuidedRun


@dataclass(frozen=True, eq=False)
class CharacterisationResult:
    """A calibration, whether to believe it, and where it comes from."""

    characterisation: Characterisation
    guided: GuidedRun | None  # the poses in their order, where they were asked for one at a time
    diagnosis: Diagnosis
    provenance: Provenance
    calibration_file: Path
    report_file: Path

    def figures(self) -> dict[str, Any]:
        guided = {"guided": self.guided.summary()} if self.guided else {}
        return {
            **self.diagnosis.summary(),
            **self.characterisation.summary(),
            "left_out": self.characterisation.left_out,
            **guided,
        }

    def summary(self) -> dict[str, Any]:
        return {**self.figures(), "provenance": self.provenance.summary(), "report": str(self.report_file)}


@dataclass(frozen=True, eq=False)
class JudgementResult:
    """What poses that were not fitted say about a calibration."""

    judgement: Judgement
    provenance: Provenance
    report_file: Path | None

    def figures(self) -> dict[str, Any]:
        return {**self.judgement.summary(), "left_out": self.judgement.left_out}

    def summary(self) -> dict[str, Any]:
        return {
            **self.figures(),
            "provenance": self.provenance.summary(),
            "report": None if self.report_file is None else str(self.report_file),
        }


@dataclass(frozen=True, eq=False)
class CorrectionResult:
    """A calibration as a few poses of its board have it now."""

    correction: Correction
    provenance: Provenance
    calibration_file: Path
    report_file: Path

    def summary(self) -> dict[str, Any]:
        return {
            **self.correction.summary(),
            "left_out": self.correction.after.left_out,
            "provenance": self.provenance.summary(),
            "calibration": str(self.calibration_file),
            "report": str(self.report_file),
        }


@dataclass(frozen=True, eq=False)
class CombinationResult:
    """The mean of several calibrations of one rig, with what varies between them."""

    combination: Combination
    combined: tuple[Path, ...]
    calibration_file: Path

    def summary(self) -> dict[str, Any]:
        return {
            **self.combination.summary(),
            "combined": [str(path) for path in self.combined],
            "calibration": str(self.calibration_file),
        }
