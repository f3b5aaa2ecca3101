"""The result of `fpplab compare`: how far a cloud is from the true shape."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.clouds import Cloud
from fpplab.comparison import Comparison
from fpplab.diagnosis import Diagnosis
from fpplab.results.provenance import Provenance


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """A cloud, its distances from the true shape, and what may explain or contradict them."""

    name: str  # of the cloud's session, or of its file
    cloud: Cloud
    comparison: Comparison
    misplaced: str | None  # that the mesh only stands elsewhere, where it does
    diagnosis: Diagnosis | None  # of the scan, where its session records it
    provenance: Provenance
    report_file: Path | None = None

    @property
    def headline(self) -> str:
        comparison = self.comparison
        mean_um, kind = comparison.surface_smcd_um, "surface SMCD"
        if mean_um is None:
            mean_um, kind = comparison.smcd_um, "SMCD"
        return (
            f"{mean_um:.1f} µm from the true shape ({kind}), {comparison.surface_rms_um:.1f} µm RMS, "
            f"{100 * comparison.completeness:.1f} % complete, "
            f"{'aligned' if comparison.alignment else 'not aligned'}"
        )

    def figures(self) -> dict[str, Any]:
        figures = self.comparison.summary()
        if self.misplaced:
            figures["warnings"] = [self.misplaced, *self.comparison.warnings()]
        return figures

    def summary(self) -> dict[str, Any]:
        return {
            **self.figures(),
            "provenance": self.provenance.summary(),
            "report": None if self.report_file is None else str(self.report_file),
        }
