"""Scores against exact references: planes, perfect clouds, and wrong fringe orders put in on purpose."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison import compare
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform
from fpplab.optimisation.scoring import LIMITS, TrueShape
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import FilterRules, Plan
from fpplab.phase import Decoded
from tests.comparison.test_comparison import CALIBRATION, PROJECTOR, H, W, perfect_cloud, placed

STRIPES = 32.0
PLAN = Plan(
    filter=FilterRules(),
    fringes=(Sinusoid(axis="x", stripes=1, steps=3), Sinusoid(axis="x", stripes=STRIPES, steps=3)),
)
UNFILTERED = PLAN.model_copy(update={"filter": None})
DENSITY = 20.0
PERIOD = PROJECTOR.size[0] / STRIPES


def maps_of(cloud: Cloud, calibration: Calibration = CALIBRATION) -> Decoded:
    """What a camera decodes of these points, without noise."""
    assert cloud.pixels is not None
    seen = calibration.projector.project(
        calibration.T_projector_camera.apply(cloud.points.astype(np.float64))
    )
    u = np.full((H, W), np.nan, np.float32)
    column, row = cloud.pixels.T
    u[row, column] = seen[:, 0]
    known = np.isfinite(u)
    modulation, sigma = (np.where(known, np.float32(level), np.float32(np.nan)) for level in (60, 0.01))
    return Decoded(u, np.full_like(u, np.nan), modulation, sigma)


def plate() -> trimesh.Trimesh:
    """A plate before the camera, its face at z = 445 mm."""
    mesh = trimesh.creation.box((90.0, 70.0, 5.0))
    mesh.apply_translation((0.0, 0.0, 447.5))
    return mesh


@cache
def truth_of(name: str, lit: bool = True, samples: int | None = LIMITS.samples) -> TrueShape:
    return TrueShape(mesh_of(name), CALIBRATION, lit, samples, DENSITY)


def mesh_of(name: str) -> trimesh.Trimesh:
    return plate() if name == "plate" else placed(name)


@pytest.mark.whole
def test_figures_of_all_points_equal_those_of_the_comparison() -> None:
    mesh = placed("pillars")
    cloud = perfect_cloud(mesh, noise_mm=0.05)
    found = truth_of("pillars", samples=None).compare(maps_of(cloud), cloud, PLAN, CALIBRATION, align=False)
    wanted = compare(cloud, mesh, CALIBRATION, density=DENSITY)
    assert found.points == wanted.points
    assert found.surface_smcd_um == pytest.approx(wanted.surface_smcd_um, rel=1e-6)
    assert found.surface_rms_um == pytest.approx(wanted.surface_rms_um, rel=1e-6)
    assert found.smcd_um == pytest.approx(wanted.smcd_um, rel=1e-6)
    assert found.completeness == pytest.approx(wanted.completeness, abs=1e-9)


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("name", ["pyramid", "pillars", "steps"])
def test_sampled_figures_differ_within_their_stated_spread(name: str) -> None:
    cloud = perfect_cloud(placed(name), noise_mm=0.05)
    thin, full = (
        truth_of(name, samples=samples).compare(maps_of(cloud), cloud, PLAN, CALIBRATION, align=False)
        for samples in (1500, None)
    )
    assert 0.0 < thin.surface_spread_um < 0.05 * full.surface_smcd_um
    assert abs(thin.surface_smcd_um - full.surface_smcd_um) < 4.0 * thin.surface_spread_um
    assert full.smcd_floor_um == pytest.approx(thin.smcd_floor_um, rel=0.05)


def test_plate_shifted_along_the_rays_is_off_by_the_shift_unless_aligned() -> None:
    cloud = perfect_cloud(plate())
    moved = replace(cloud, points=cloud.points * np.float32(1.0 + 0.2 / 445.0))
    truth = truth_of("plate")
    off = truth.compare(maps_of(cloud), moved, PLAN, CALIBRATION, align=False)
    # The outermost pixels lie inside the edges of the plate.
    assert off.surface_smcd_um == pytest.approx(200.0, rel=0.03)
    assert off.surface_rms_um == pytest.approx(200.0, rel=0.01)
    still, aligned = (truth.compare(maps_of(cloud), one, PLAN, CALIBRATION) for one in (cloud, moved))
    assert aligned.surface_smcd_um == pytest.approx(still.surface_smcd_um, abs=1.0)
    assert still.surface_smcd_um < 10.0


def test_smcd_floor_is_the_score_of_a_perfect_measurement() -> None:
    cloud = perfect_cloud(placed("pyramid"))
    found = truth_of("pyramid").compare(maps_of(cloud), cloud, PLAN, CALIBRATION, align=False)
    assert found.smcd_um == pytest.approx(found.smcd_floor_um, rel=0.02)
    assert found.surface_smcd_um < 0.05 * found.smcd_floor_um


@pytest.mark.parametrize(("wrong", "turns"), [(0, 1.0), (1, -1.0), (40, 0.75)])
def test_wrong_fringe_orders_are_counted(wrong: int, turns: float) -> None:
    decoded = maps_of(perfect_cloud(plate()))
    places = np.flatnonzero(np.isfinite(decoded.u.ravel()))
    chosen = np.random.default_rng(0).choice(places, wrong, replace=False)
    decoded.u.ravel()[chosen] += np.float32(turns * PERIOD)
    found = truth_of("plate").score(decoded, UNFILTERED, CALIBRATION)
    assert found.points == len(places)
    assert found.wrong_orders == pytest.approx(wrong / len(places), abs=1e-12)
    assert found.outliers == 0.0


def test_error_below_half_a_period_is_no_wrong_order() -> None:
    decoded = maps_of(perfect_cloud(plate()))
    decoded.u[::3] += np.float32(0.49 * PERIOD)
    assert truth_of("plate").score(decoded, UNFILTERED, CALIBRATION).wrong_orders == 0.0


@pytest.mark.whole
def test_filtered_points_count_as_outliers_not_as_wrong_orders() -> None:
    decoded = maps_of(perfect_cloud(plate()))
    row, column = H // 2, W // 2
    decoded.u[row, column] += np.float32(PERIOD)
    found = truth_of("plate").score(decoded, PLAN, CALIBRATION)
    assert found.wrong_orders == 0.0
    assert found.outliers == pytest.approx(1.0 / np.isfinite(decoded.u).sum())


def test_shadow_reduces_completeness_if_all_visible_surface_counts() -> None:
    mesh = placed("pillars")
    cloud = perfect_cloud(mesh)
    lit, all_of_it = (
        truth_of("pillars", lit=lit).compare(maps_of(cloud), cloud, PLAN, CALIBRATION, align=False)
        for lit in (True, False)
    )
    everywhere = perfect_cloud(mesh, lit=False)
    assert lit.completeness > 0.97
    assert all_of_it.completeness == pytest.approx(len(cloud) / len(everywhere), abs=0.03)
    assert all_of_it.surface_smcd_um > 5.0 * lit.surface_smcd_um


def test_true_shape_can_be_compared_with_another_calibration_of_the_rig() -> None:
    """As where the projector has moved: decoded with it and triangulated with it, the shape is the same."""
    mesh = placed("pyramid")
    shift = RigidTransform(np.eye(3), np.array([20.0, 0.0, 0.0]))
    elsewhere = replace(CALIBRATION, T_projector_camera=shift @ CALIBRATION.T_projector_camera)
    cloud = perfect_cloud(mesh, lit=False)
    truth = truth_of("pyramid", lit=False)
    found = truth.score(maps_of(cloud, elsewhere), UNFILTERED, elsewhere, align=False)
    assert found.surface_smcd_um < 10.0
    assert found.wrong_orders == 0.0


def test_empty_measurement_is_refused() -> None:
    nothing = maps_of(perfect_cloud(plate()))
    nothing.u[:] = np.nan
    with pytest.raises(DataError, match="no pixel has a projector coordinate"):
        truth_of("plate").score(nothing, PLAN, CALIBRATION)


def test_misplaced_shape_causes_no_wrong_orders_after_alignment() -> None:
    """The fixture knows poses in the true camera's frame, and a measured calibration has its own."""
    fine = (PLAN.fringes[0], Sinusoid(axis="x", stripes=128, steps=3))
    plan = UNFILTERED.model_copy(update={"fringes": fine})
    beside = placed("pillars").apply_translation((3.0, 0.0, 0.0))
    decoded = maps_of(perfect_cloud(beside))
    found = truth_of("pillars").score(decoded, plan, CALIBRATION)
    assert found.wrong_orders == 0.0
    assert truth_of("pillars").score(decoded, plan, CALIBRATION, align=False).wrong_orders > 0.001
    measured = np.argwhere(np.isfinite(decoded.u))
    row, column = measured[len(measured) // 2]
    decoded.u[row, column] += np.float32(2 * PROJECTOR.size[0] / 128)
    again = truth_of("pillars").score(decoded, plan, CALIBRATION)
    assert again.wrong_orders == pytest.approx(1.0 / again.points)
