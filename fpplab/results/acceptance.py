"""The result of `fpplab verify`: an acceptance test, and whether to believe the system."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.comparison.acceptance import Acceptance
from fpplab.diagnosis import Diagnosis
from fpplab.results.provenance import Provenance


@dataclass(frozen=True, eq=False)
class AcceptanceResult:
    """Judged positions of the standards, with the verdict on the system."""

    acceptance: Acceptance
    diagnosis: Diagnosis
    provenance: Mapping[str, Provenance]  # by name of the cloud or session
    seconds: float
    report_file: Path

    def summary(self) -> dict[str, Any]:
        return {
            **self.diagnosis.summary(),
            **self.acceptance.summary(),
            "seconds": self.seconds,
            "report": str(self.report_file),
            "provenance": {name: source.summary() for name, source in self.provenance.items()},
        }
