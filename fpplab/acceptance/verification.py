"""The acceptance test: what a measuring system gets wrong on standards that are known.

In the manner of VDI/VDE 2634 part 2 ("Optical systems based on area scanning"), from single views:

* Probing error, form PF: span of the radial distances of a sphere's points from the sphere of free
  radius fitted to them by least squares. Probing error, size PS: its diameter minus the calibrated one.
* Sphere-spacing error SD: measured minus calibrated distance of a ball bar's two centres.
* Flatness measurement error F: span of the distances of a plane's points from the plane fitted to them.

Of each feature's points exactly `floor(0.003 N)`, the farthest from the fit, are left out of the fit
and of the span. A quantity is passed when its error in every position stays within the maximum
permissible error, less what the standard itself is uncertain by (ISO 14253-1).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fpplab.acceptance.fitting import Plane, Sphere, fit_plane, fit_sphere, fit_without_worst, peak_to_peak
from fpplab.acceptance.segmentation import find_plane, find_spheres, normals_of, plane_face, sphere_cap
from fpplab.acceptance.standard import QUANTITIES, Standard
from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import ConfigError, DataError

POSITIONS = 3
"""Fewer positions of a standard say little about the measuring volume."""
FAR_OFF = 0.1
"""Relative deviation from which a diameter or spacing is not that of the standard at all."""
VERDICTS = {True: "passed", False: "not passed", None: "not judged"}
"""What a judgement says to people."""

Clouds = Iterable[tuple[str, Cloud]]
"""Each with the name of its source."""


@dataclass(frozen=True, eq=False)
class MeasuredFeature:
    """One feature's points that count, (K, 3), their camera pixels (K, 2) or None, and how they lie.

    distances: (K,) in mm, signed, from the fit. kept: (K,), all but the farthest.
    """

    points: NDArray[np.float32]
    pixels: NDArray[np.int32] | None
    distances: Floats
    kept: Mask

    @classmethod
    def of(cls, cloud: Cloud, index: NDArray[np.intp], distances: Floats, kept: Mask) -> MeasuredFeature:
        pixels = None if cloud.pixels is None else cloud.pixels[index]
        return cls(cloud.points[index], pixels, distances, kept)

    @property
    def span_um(self) -> float:
        return 1e3 * peak_to_peak(self.distances[self.kept])

    @property
    def rms_um(self) -> float:
        return 1e3 * float(np.sqrt(np.mean(self.distances[self.kept] ** 2)))

    def summary(self) -> dict[str, Any]:
        """Counts and the root mean square, which says how much of a span is noise."""
        return {
            "rms_um": self.rms_um,
            "points": len(self.points),
            "discarded": int((~self.kept).sum()),
        }


@dataclass(frozen=True, eq=False)
class SphereTest:
    """One sphere in one position. number: 1 or 2, as in the standard's file."""

    number: int
    sphere: Sphere
    calibrated_mm: float
    solid_angle_sr: float
    measured: MeasuredFeature

    @property
    def form_um(self) -> float:
        """PF."""
        return self.measured.span_um

    @property
    def size_um(self) -> float:
        """PS."""
        return 1e3 * (2.0 * self.sphere.radius - self.calibrated_mm)

    def summary(self) -> dict[str, Any]:
        return {
            "sphere": self.number,
            "PF_um": self.form_um,
            "PS_um": self.size_um,
            "diameter_mm": 2.0 * self.sphere.radius,
            "centre_mm": self.sphere.centre.tolist(),
            "solid_angle_sr": self.solid_angle_sr,
            **self.measured.summary(),
        }


@dataclass(frozen=True, eq=False)
class BallBarTest:
    """A ball bar in one position."""

    source: str
    spheres: tuple[SphereTest, SphereTest]
    calibrated_mm: float

    @property
    def spacing_mm(self) -> float:
        first, second = (test.sphere.centre for test in self.spheres)
        return float(np.linalg.norm(second - first))

    @property
    def spacing_error_um(self) -> float:
        """SD."""
        return 1e3 * (self.spacing_mm - self.calibrated_mm)


@dataclass(frozen=True, eq=False)
class PlaneTest:
    """A plane in one position."""

    source: str
    plane: Plane
    area_mm2: float
    measured: MeasuredFeature

    @property
    def flatness_um(self) -> float:
        """F."""
        return self.measured.span_um

    def summary(self) -> dict[str, Any]:
        return {
            "source": self.source,
            "F_um": self.flatness_um,
            "area_mm2": self.area_mm2,
            "normal": self.plane.normal.tolist(),
            **self.measured.summary(),
        }


@dataclass(frozen=True)
class AcceptanceJudgement:
    """A quantity over all positions: the error of greatest size, and whether it is permitted.

    passed: None where no maximum permissible error was stated.
    """

    worst_um: float
    mpe_um: float | None
    known_to_um: float
    positions: int

    @property
    def passed(self) -> bool | None:
        return None if self.mpe_um is None else abs(self.worst_um) + self.known_to_um <= self.mpe_um

    def summary(self) -> dict[str, Any]:
        return {
            "worst_um": self.worst_um,
            "mpe_um": self.mpe_um,
            "standard_known_to_um": self.known_to_um,
            "values": self.positions,
            "passed": self.passed,
        }


@dataclass(frozen=True, eq=False)
class Acceptance:
    """The result of an acceptance test."""

    standard: Standard
    bars: tuple[BallBarTest, ...] = ()
    planes: tuple[PlaneTest, ...] = ()

    def errors_um(self) -> dict[str, list[float]]:
        """Every value of every quantity that was measured."""
        spheres = [test for bar in self.bars for test in bar.spheres]
        values = {
            "PF": [test.form_um for test in spheres],
            "PS": [test.size_um for test in spheres],
            "SD": [bar.spacing_error_um for bar in self.bars],
            "F": [plane.flatness_um for plane in self.planes],
        }
        return {name: values[name] for name in QUANTITIES if values[name]}

    def judgements(self) -> dict[str, AcceptanceJudgement]:
        """By quantity, those that were measured."""
        standard = self.standard
        return {
            name: AcceptanceJudgement(
                max(values, key=abs), standard.permitted_um(name), standard.known_to_um(name), len(values)
            )
            for name, values in self.errors_um().items()
        }

    @property
    def passed(self) -> bool | None:
        """Whether every quantity that was judged is permitted; None where none was."""
        judged = [j.passed for j in self.judgements().values() if j.passed is not None]
        return all(judged) if judged else None

    def notices(self) -> list[str]:
        """What limits the meaning of the result."""
        said = []
        for what, count in (("ball bar", len(self.bars)), ("plane", len(self.planes))):
            if 0 < count < POSITIONS:
                said.append(
                    f"{what}: measured in {count} of at least {POSITIONS} recommended positions; spread them "
                    "over the measuring volume, the guideline itself asks for more"
                )
        unjudged = [name for name, found in self.judgements().items() if found.passed is None]
        if unjudged:
            said.append(f"no maximum permissible error is stated for {', '.join(unjudged)}: not judged")
        return said

    def summary(self) -> dict[str, Any]:
        """Plain values, errors in µm; the keys of `fpplab verify --json`."""
        return {
            "standard": self.standard.name,
            "passed": self.passed,
            "quantities": {name: found.summary() for name, found in self.judgements().items()},
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


def verify(standard: Standard, bars: Clouds = (), planes: Clouds = ()) -> Acceptance:
    """The acceptance test on clouds in mm in the camera's frame, each with the name of its source.

    bars: one cloud per position of the ball bar. planes: one per position of the plane. They are taken
    one after the other, so that they need not all be in memory.
    Raises `ConfigError` when there is nothing to test or its standard is not described, `DataError` when
    a standard is not found, or too little of it was measured.
    """
    found = Acceptance(
        standard,
        tuple(verify_ball_bar(cloud, standard, source) for source, cloud in bars),
        tuple(verify_plane(cloud, standard, source) for source, cloud in planes),
    )
    if not (found.bars or found.planes):
        raise ConfigError("there is nothing to verify; give clouds of a ball bar, of a plane, or both")
    return found


def verify_ball_bar(cloud: Cloud, standard: Standard, source: str) -> BallBarTest:
    """The two spheres of a ball bar, and their spacing. Raises `ConfigError`, `DataError` as `verify`."""
    bar = _described(standard.ball_bar, "ball_bar", standard)
    points = np.asarray(cloud.points, np.float64)
    radius = sum(bar.diameters_mm) / 4
    centres = find_spheres(points, normals_of(cloud), radius, 2, source)
    fits = [_fit(points, cloud, centre, radius, standard, source) for centre in centres]
    # Nothing else tells two spheres apart than that one is the greater.
    by_size = sorted(fits, key=lambda fit: fit[0].radius)
    order = sorted((0, 1), key=lambda i: bar.diameters_mm[i])
    tests = {
        number + 1: SphereTest(number + 1, fit[0], bar.diameters_mm[number], fit[1], fit[2])
        for number, fit in zip(order, by_size, strict=True)
    }
    for test in tests.values():
        _refuse_other("a sphere's diameter", 2 * test.sphere.radius, test.calibrated_mm, source)
    result = BallBarTest(source, (tests[1], tests[2]), bar.spacing_mm)
    _refuse_other("the spheres' spacing", result.spacing_mm, bar.spacing_mm, source)
    return result


def verify_plane(cloud: Cloud, standard: Standard, source: str) -> PlaneTest:
    """A plane's flatness. Raises `ConfigError`, `DataError` as `verify`."""
    known = _described(standard.plane, "plane", standard)
    points = np.asarray(cloud.points, np.float64)
    found = find_plane(points, max(known.size_mm), source)
    face = plane_face(points, found, known.size_mm, standard.evaluation, source)
    plane, kept = fit_without_worst(points[face.index], fit_plane)
    distances = plane.distances(points[face.index])
    return PlaneTest(source, plane, face.area_mm2, MeasuredFeature.of(cloud, face.index, distances, kept))


def _fit(
    points: Floats, cloud: Cloud, centre: Floats, radius: float, standard: Standard, source: str
) -> tuple[Sphere, float, MeasuredFeature]:
    cap = sphere_cap(points, centre, radius, standard.evaluation, source)
    sphere, kept = fit_without_worst(points[cap.index], fit_sphere)
    distances = sphere.distances(points[cap.index])
    return sphere, cap.solid_angle_sr, MeasuredFeature.of(cloud, cap.index, distances, kept)


S = TypeVar("S")


def _described(standard: S | None, what: str, of: Standard) -> S:
    if standard is None:
        raise ConfigError(f"standard '{of.name}': '{what}' is missing; describe it in its file")
    return standard


def _refuse_other(what: str, found: float, calibrated: float, source: str) -> None:
    if abs(found - calibrated) > FAR_OFF * calibrated:
        raise DataError(
            f"{source}: {what} measures {found:.3g} mm, but the standard's is {calibrated:.3g} mm; "
            "see that this is the standard that its file describes"
        )
