"""The result of the demonstration: a whole measurement on the virtual bench."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fpplab.characterisation import Characterisation
from fpplab.comparison import Comparison
from fpplab.core.conventions import Floats
from fpplab.patterns.response import Response
from fpplab.reconstruction.filtering import count_removed
from fpplab.results.scan import ScanResult

UNFILTERED = ("points", "surface_smcd_um", "surface_rms_um", "surface_p95_um", "completeness", "outliers")
"""Figures that are also given without the plan's filter, so that its effect can be seen."""


@dataclass(frozen=True, eq=False)
class DemoScan:
    """One artefact of the demonstration, measured and compared with its true shape."""

    artefact: str
    scan: ScanResult
    comparison: Comparison  # of the cloud
    unfiltered: Comparison  # of the points without the plan's filter

    def summary(self) -> dict[str, Any]:
        return {
            "artefact": self.artefact,
            "images": self.scan.session.plan.frames,
            **self.comparison.summary(),
            "verdict": self.scan.diagnosis.verdict.value,
            "points": len(self.scan.cloud) if self.scan.cloud else 0,
            "removed": count_removed(self.scan.decoded) if self.scan.decoded else None,
            "unfiltered": {name: getattr(self.unfiltered, name) for name in UNFILTERED},
        }


@dataclass(frozen=True, eq=False)
class DemoResult:
    """Response, characterisation and scans of the virtual bench."""

    response: Response
    levels: Floats  # (K, 2) shown and seen, as shares of full scale
    characterisation: Characterisation
    scans: tuple[DemoScan, ...]
    seconds: float
    report_file: Path

    def summary(self) -> dict[str, Any]:
        distances = [scan.comparison.surface_smcd_um for scan in self.scans]
        left_out = list(self.characterisation.left_out)
        return {
            "gamma": self.response.summary(),
            "characterisation": {**self.characterisation.summary(), "left_out": left_out},
            "scans": [scan.summary() for scan in self.scans],
            # Every cloud of the demonstration lies on a pixel grid, so that every distance is known.
            "mean_surface_smcd_um": float(
                np.mean([distance for distance in distances if distance is not None])
            ),
            "seconds": self.seconds,
            "report": str(self.report_file),
        }
