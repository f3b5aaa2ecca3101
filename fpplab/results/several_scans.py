"""The result of `fpplab report`: several scans side by side, and how far they are apart."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud, local_quadric_distance
from fpplab.core import config
from fpplab.core.conventions import Image
from fpplab.diagnosis import Diagnosis
from fpplab.patterns.plan import Plan
from fpplab.results.provenance import Provenance

MAX_FITTED = 20_000  # points whose neighbours are fitted (chosen): their median is known to one percent


def roughness_um(cloud: Cloud) -> float | None:
    """Measure how rough a cloud is: median distance of its points from their neighbours' quadric."""
    if cloud.pixels is None:
        return None
    distances = np.abs(local_quadric_distance(cloud, max_points=MAX_FITTED))
    finite = distances[np.isfinite(distances)]
    return 1e3 * float(np.median(finite)) if len(finite) else None


def noise_um(cloud: Cloud) -> float | None:
    return None if cloud.sigma_noise_mm is None else 1e3 * float(np.median(cloud.sigma_noise_mm))


@dataclass(frozen=True, eq=False)
class ScanRecord:
    """What is recorded of one scan."""

    name: str  # on the page
    provenance: Provenance  # where it comes from
    cloud: Cloud | None  # its points; None where there are none
    calibration: Calibration | None  # that it was reconstructed with, where it is recorded
    diagnosis: Diagnosis | None  # whether to believe it, where that is recorded or can be found out
    frame: tuple[Image, int] | None  # of the finest fringes, and its bit depth; None for a cloud alone
    plan: Plan | None = None  # that it was taken by; None for a cloud alone

    def summary(self) -> dict[str, Any]:
        judged = self.diagnosis.summary() if self.diagnosis else {"verdict": None}
        cloud = self.cloud
        return {
            "name": self.name,
            **judged,
            "points": len(cloud) if cloud else 0,
            "roughness_um": roughness_um(cloud) if cloud else None,
            "noise_um": noise_um(cloud) if cloud else None,
        }


@dataclass(frozen=True, eq=False)
class CloudDifference:
    """How far two clouds of one calibration are apart, along the camera's rays."""

    scan: str  # name
    reference: str  # name of what is subtracted
    distances_mm: NDArray[np.float32] | None  # (N,) for every point of the scan; None where not compared
    reason: str = ""  # why they are not compared

    def summary(self) -> dict[str, Any]:
        names = {"scan": self.scan, "reference": self.reference}
        if self.distances_mm is None:
            return {**names, "not_compared": self.reason}
        finite = 1e3 * self.distances_mm[np.isfinite(self.distances_mm)].astype(np.float64)
        return {
            **names,
            "pixels": len(finite),
            "median_um": float(np.median(finite)),
            "rms_um": float(np.sqrt(np.mean(finite**2))),
            "p95_um": float(np.percentile(np.abs(finite), 95)),
        }


def plan_differences(scans: Sequence[ScanRecord]) -> dict[str, dict[str, str]]:
    terms = {scan.name: _plan_terms(scan.plan) for scan in scans if scan.plan is not None}
    names = dict.fromkeys(name for values in terms.values() for name in values)
    rows = {name: {scan: values.get(name, "–") for scan, values in terms.items()} for name in names}
    return {name: row for name, row in rows.items() if len(set(row.values())) > 1}


def _plan_terms(plan: Plan) -> dict[str, str]:
    terms = {}
    for axis in plan.axes:
        sets = [each for each in plan.sets if each.coded_axis == axis]
        terms[f"stripes along {axis}"] = ", ".join(each.short_name for each in sets)
        terms[f"images along {axis}"] = ", ".join(str(each.images) for each in sets)
    terms["images"] = str(plan.frames)
    return terms | {name: str(value) for name, value in config.plain(plan).items() if name != "fringes"}


@dataclass(frozen=True, eq=False)
class ScansResult:
    """Several scans, and the difference of each from the first."""

    scans: tuple[ScanRecord, ...]
    differences: tuple[CloudDifference, ...]
    report_file: Path

    def figures(self) -> dict[str, Any]:
        return {
            "scans": [scan.summary() for scan in self.scans],
            "differences": [difference.summary() for difference in self.differences],
            "plans": plan_differences(self.scans),
        }

    def summary(self) -> dict[str, Any]:
        return {
            **self.figures(),
            "provenance": {scan.name: scan.provenance.summary() for scan in self.scans},
            "report": str(self.report_file),
        }
