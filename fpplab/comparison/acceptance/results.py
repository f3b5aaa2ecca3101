"""Errors of a measuring system on calibrated standards, and whether they are within what is permitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.clouds import Cloud
from fpplab.comparison.acceptance.fitting import F, Plane, Sphere, fit_without_worst, peak_to_peak
from fpplab.comparison.acceptance.standard import QUANTITIES, Standard
from fpplab.core.conventions import Floats, Mask

CONVENTIONS = {
    "PF": "range of the points that remain when the 3 ‰ farthest from the fit are removed",
    "PF_all": "range of all points",
    "F": "range of the points that remain when the 3 ‰ farthest from the fit are removed",
    "F_all": "range of all points",
}
"""What the errors of form are the range of; those without `_all` are judged."""
VERDICTS = {True: "passed", False: "not passed", None: "not judged"}  # words for a judgement in reports


@dataclass(frozen=True, eq=False)
class MeasuredFeature:
    """The evaluated points of one feature, and their distances from its fit."""

    points: NDArray[np.float32]  # (K, 3) in mm in the camera's frame
    pixels: NDArray[np.int32] | None  # camera pixels (K, 2) as (u, v), None where unknown
    distances: Floats  # signed distances (K,) in mm from the fit
    kept: Mask  # (K,), False for the farthest points, which were discarded
    span_all_um: float  # greatest minus least distance in µm of all points from a fit to all points

    @classmethod
    def fitted(
        cls, cloud: Cloud, index: NDArray[np.intp], fit: Callable[[Floats], F]
    ) -> tuple[F, MeasuredFeature]:
        # index (K,); fit (M, 3)
        points = np.asarray(cloud.points[index], np.float64)
        feature, kept = fit_without_worst(points, fit)
        pixels = None if cloud.pixels is None else cloud.pixels[index]
        span_all_um = 1e3 * peak_to_peak(fit(points).distances(points))
        return feature, cls(cloud.points[index], pixels, feature.distances(points), kept, span_all_um)

    @property
    def span_um(self) -> float:
        """Greatest minus least distance of the kept points, in µm."""
        return 1e3 * peak_to_peak(self.distances[self.kept])

    @property
    def rms_um(self) -> float:
        """Root mean square distance of the kept points, in µm."""
        return 1e3 * float(np.sqrt(np.mean(self.distances[self.kept] ** 2)))

    def summary(self) -> dict[str, Any]:
        return {"rms_um": self.rms_um, "points": len(self.points), "discarded": int((~self.kept).sum())}


@dataclass(frozen=True, eq=False)
class SphereTest:
    """The result of one sphere in one position."""

    number: int  # 1 or 2, in the order of the standard's file
    sphere: Sphere  # the fit, in mm in the camera's frame
    calibrated_mm: float  # calibrated diameter in mm
    solid_angle_sr: float  # solid angle of the measured cap in sr
    measured: MeasuredFeature  # the evaluated points

    @property
    def form_um(self) -> float:
        """Probing error, form (PF), in µm."""
        return self.measured.span_um

    @property
    def size_um(self) -> float:
        """Probing error, size (PS), in µm."""
        return 1e3 * (2.0 * self.sphere.radius - self.calibrated_mm)

    def summary(self) -> dict[str, Any]:
        return {
            "sphere": self.number,
            "PF_um": self.form_um,
            "PF_all_um": self.measured.span_all_um,
            "PS_um": self.size_um,
            "diameter_mm": 2.0 * self.sphere.radius,
            "centre_mm": self.sphere.centre.tolist(),
            "solid_angle_sr": self.solid_angle_sr,
            **self.measured.summary(),
        }


@dataclass(frozen=True, eq=False)
class BallBarTest:
    """The result of a ball bar in one position."""

    source: str  # name of the cloud
    spheres: tuple[SphereTest, SphereTest]  # the two spheres in the order of the standard's file
    calibrated_mm: float  # calibrated distance between their centres in mm

    @property
    def spacing_mm(self) -> float:
        """Measured distance between the two centres, in mm."""
        first, second = (test.sphere.centre for test in self.spheres)
        return float(np.linalg.norm(second - first))

    @property
    def spacing_error_um(self) -> float:
        """Sphere-spacing error (SD), in µm."""
        return 1e3 * (self.spacing_mm - self.calibrated_mm)


@dataclass(frozen=True, eq=False)
class PlaneTest:
    """The result of a plane in one position."""

    source: str  # name of the cloud
    plane: Plane  # the fit, in mm in the camera's frame
    area_mm2: float  # evaluated area in mm²
    measured: MeasuredFeature  # the evaluated points

    @property
    def flatness_um(self) -> float:
        """Flatness measurement error (F), in µm."""
        return self.measured.span_um

    def summary(self) -> dict[str, Any]:
        return {
            "source": self.source,
            "F_um": self.flatness_um,
            "F_all_um": self.measured.span_all_um,
            "area_mm2": self.area_mm2,
            "normal": self.plane.normal.tolist(),
            **self.measured.summary(),
        }


@dataclass(frozen=True)
class AcceptanceJudgement:
    """The judgement of one quantity over all positions."""

    worst_um: float  # the error of greatest magnitude, signed, in µm
    mpe_um: float | None  # maximum permissible error in µm, None where none is stated
    reference_uncertainty_um: float  # uncertainty of the standard itself in µm
    positions: int  # number of values that were measured
    min_positions: int  # number of values that the standard's file asks for
    worst_all_um: float | None = None  # for errors of form

    @property
    def passed(self) -> bool | None:
        """Whether the error is permitted, None where no maximum permissible error is stated."""
        return (
            None if self.mpe_um is None else abs(self.worst_um) + self.reference_uncertainty_um <= self.mpe_um
        )

    def summary(self) -> dict[str, Any]:
        return {
            "worst_um": self.worst_um,
            "worst_all_um": self.worst_all_um,
            "mpe_um": self.mpe_um,
            "standard_known_to_um": self.reference_uncertainty_um,
            "values": self.positions,
            "least_values": self.min_positions,
            "passed": self.passed,
        }


@dataclass(frozen=True, eq=False)
class Acceptance:
    """The result of an acceptance test."""

    standard: Standard  # what was measured, and the maximum permissible errors
    bars: tuple[BallBarTest, ...] = ()  # one per position of the ball bar
    planes: tuple[PlaneTest, ...] = ()  # one per position of the plane

    def errors_um(self) -> dict[str, list[float]]:
        spheres = [test for bar in self.bars for test in bar.spheres]
        values = {
            "PF": [test.form_um for test in spheres],
            "PS": [test.size_um for test in spheres],
            "SD": [bar.spacing_error_um for bar in self.bars],
            "F": [plane.flatness_um for plane in self.planes],
        }
        return {name: values[name] for name in QUANTITIES if values[name]}

    def judgements(self) -> dict[str, AcceptanceJudgement]:
        standard, with_all = self.standard, self._form_of_all_points_um()
        return {
            name: AcceptanceJudgement(
                max(values, key=abs),
                standard.permitted_um(name),
                standard.reference_uncertainty_um(name),
                len(values),
                getattr(standard.positions, name),
                max(with_all[name]) if name in with_all else None,
            )
            for name, values in self.errors_um().items()
        }

    def _form_of_all_points_um(self) -> dict[str, list[float]]:
        """Collect the errors of form in µm with all points, none discarded."""
        spheres = [test.measured.span_all_um for bar in self.bars for test in bar.spheres]
        return {"PF": spheres, "F": [plane.measured.span_all_um for plane in self.planes]}

    @property
    def passed(self) -> bool | None:
        judged = [j.passed for j in self.judgements().values() if j.passed is not None]
        return all(judged) if judged else None

    def notices(self) -> list[str]:
        judged = self.judgements()
        notices = [
            f"{name}: measured in {judgement.positions} of at least {judgement.min_positions} positions; "
            "add positions, spread over the measuring volume"
            for name, judgement in judged.items()
            if judgement.positions < judgement.min_positions
        ]
        unjudged = [name for name, judgement in judged.items() if judgement.passed is None]
        if unjudged:
            notices.append(f"no maximum permissible error is stated for {', '.join(unjudged)}: not judged")
        return notices

    def summary(self) -> dict[str, Any]:
        return {
            "standard": self.standard.name,
            "passed": self.passed,
            "cap_deg": self.standard.evaluation.cap_deg,
            "edge_mm": self.standard.evaluation.edge_mm,
            "conventions": CONVENTIONS,
            "quantities": {name: judgement.summary() for name, judgement in self.judgements().items()},
            "spheres": [
                {"source": bar.source, **test.summary()} for bar in self.bars for test in bar.spheres
            ],
            "spacings": [
                {"source": bar.source, "SD_um": bar.spacing_error_um, "spacing_mm": bar.spacing_mm}
                for bar in self.bars
            ],
            "planes": [plane.summary() for plane in self.planes],
            "notices": self.notices(),
        }


def shared_variance(measured: MeasuredFeature) -> float | None:
    """Estimate which share of the variance of a feature's errors neighbouring pixels have in common."""
    # Errors of bent surfaces are shared, noise is not.
    if measured.pixels is None:
        return None
    pixels, distances = measured.pixels[measured.kept], measured.distances[measured.kept]
    order = np.lexsort((pixels[:, 0], pixels[:, 1]))
    pixels, distances = pixels[order], distances[order]
    adjacent = (np.diff(pixels[:, 0]) == 1) & (np.diff(pixels[:, 1]) == 0)
    if np.count_nonzero(adjacent) < 100:  # chosen: fewer pairs show nothing
        return None
    product = distances[:-1][adjacent] * distances[1:][adjacent]
    return float(np.mean(product) / max(float(np.mean(distances**2)), 1e-30))
