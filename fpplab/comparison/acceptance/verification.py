"""The acceptance test: errors of a measuring system on calibrated standards.

After VDI/VDE 2634 part 2 ("Optical systems based on area scanning"), from single views:

* Probing error, form PF: span of the radial distances of a sphere's points from the sphere of free
  radius fitted to them by least squares. Probing error, size PS: its diameter minus the calibrated one.
* Sphere-spacing error SD: measured minus calibrated distance of a ball bar's two centres.
* Flatness measurement error F: span of the distances of a plane's points from the plane fitted to them.

PF and F are given by two conventions. `PF` and `F`, which are judged: of each feature's points exactly
`floor(0.003 N)`, the farthest from the fit, are left out of the fit and of the span. `PF_all` and `F_all`:
the fit and the span are those of all points. A quantity is passed when its error in every position stays
within the maximum permissible error, reduced by the uncertainty of the standard itself (ISO 14253-1).
"""

from collections.abc import Iterable
from typing import TypeVar

import numpy as np

from fpplab.clouds import Cloud
from fpplab.comparison.acceptance.fitting import fit_plane, fit_sphere
from fpplab.comparison.acceptance.results import (
    Acceptance,
    BallBarTest,
    MeasuredFeature,
    PlaneTest,
    SphereTest,
)
from fpplab.comparison.acceptance.segmentation import (
    find_plane,
    find_spheres,
    normals_of,
    plane_face,
    sphere_cap,
)
from fpplab.comparison.acceptance.standard import Standard
from fpplab.core.errors import ConfigError, DataError

Clouds = Iterable[tuple[str, Cloud]]  # clouds in mm in the camera's frame, each after the name of its source


def verify(standard: Standard, bars: Clouds = (), planes: Clouds = ()) -> Acceptance:
    """Run the acceptance test on clouds of the standards."""
    # Clouds are taken from the iterables one after the other, so that they need not all be in memory.
    acceptance = Acceptance(
        standard,
        tuple(verify_ball_bar(cloud, standard, source) for source, cloud in bars),
        tuple(verify_plane(cloud, standard, source) for source, cloud in planes),
    )
    if not (acceptance.bars or acceptance.planes):
        raise ConfigError("there is nothing to verify; give clouds of a ball bar, of a plane, or both")
    return acceptance


def verify_ball_bar(cloud: Cloud, standard: Standard, source: str) -> BallBarTest:
    """Measure the two spheres of a ball bar, and their spacing."""
    bar = _described(standard.ball_bar, "ball_bar", standard)
    points = np.asarray(cloud.points, np.float64)
    radius = sum(bar.diameters_mm) / 4
    centres = find_spheres(points, normals_of(cloud), radius, 2, source)
    caps = [sphere_cap(points, centre, radius, standard.evaluation, source) for centre in centres]
    fits = [(*MeasuredFeature.fitted(cloud, cap.index, fit_sphere), cap.solid_angle_sr) for cap in caps]
    # Nothing but their size distinguishes the spheres.
    by_size = sorted(fits, key=lambda fit: fit[0].radius)
    order = sorted((0, 1), key=lambda i: bar.diameters_mm[i])
    tests = {
        number + 1: SphereTest(number + 1, sphere, bar.diameters_mm[number], solid_angle_sr, measured)
        for number, (sphere, measured, solid_angle_sr) in zip(order, by_size, strict=True)
    }
    for test in tests.values():
        _refuse_other("a sphere's diameter", 2 * test.sphere.radius, test.calibrated_mm, source)
    result = BallBarTest(source, (tests[1], tests[2]), bar.spacing_mm)
    _refuse_other("the spheres' spacing", result.spacing_mm, bar.spacing_mm, source)
    return result


def verify_plane(cloud: Cloud, standard: Standard, source: str) -> PlaneTest:
    """Measure the flatness of a plane."""
    description = _described(standard.plane, "plane", standard)
    points = np.asarray(cloud.points, np.float64)
    coarse_plane = find_plane(points, max(description.size_mm), source)
    face = plane_face(points, coarse_plane, description.size_mm, standard.evaluation, source)
    plane, measured = MeasuredFeature.fitted(cloud, face.index, fit_plane)
    return PlaneTest(source, plane, face.area_mm2, measured)


S = TypeVar("S")


def _described(standard: S | None, what: str, of: Standard) -> S:
    if standard is None:
        raise ConfigError(f"standard '{of.name}': '{what}' is missing; describe it in its file")
    return standard


def _refuse_other(what: str, measured: float, calibrated: float, source: str) -> None:
    if abs(measured - calibrated) > 0.1 * calibrated:  # chosen: no error of measurement is as large
        raise DataError(
            f"{source}: {what} measures {measured:.3g} mm, but the standard's is {calibrated:.3g} mm; "
            "check that this is the standard that its file describes"
        )
