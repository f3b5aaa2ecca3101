"""Plans of fine fringes alone, and the uncertainty where their sets disagree."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded, check_unwrapping
from fpplab.phase.bounds import widest_interval_share
from fpplab.phase.disagreement import widened_by_disagreement
from fpplab.phase.fine_plan import error_ratio, fine_plan
from fpplab.reconstruction.depth_range import decoding_bounds
from sim.world import World

DEPTH_MM = (425.0, 475.0)


@pytest.fixture(scope="module")
def known() -> Calibration:
    world = World.load(config.find_config("world_demo", "world"))
    return Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})


def stripes(plan: Plan) -> list[float]:
    return [fringe.stripes for fringe in plan.fringes]


@pytest.mark.parametrize("depth_mm", [DEPTH_MM, (440.0, 450.0), (400.0, 520.0)])
def test_the_depth_range_tells_the_orders(known: Calibration, depth_mm: tuple[float, float]) -> None:
    plan = fine_plan(known, depth_mm)
    share = widest_interval_share(
        decoding_bounds(plan, known, DepthRange(depth_mm, "test")), "x", known.projector.size
    )
    assert share is not None
    check_unwrapping(plan, "test", {"x": share})
    half, second, finest = stripes(plan)
    assert (finest - second) * share < 0.85, "a margin for noise"
    assert finest == 228, "four projector px"
    assert half == 114


def test_the_plan_that_comes_with_fpplab_is_the_written_one(known: Calibration) -> None:
    ready = Plan.load("plan_interreflections")
    assert ready.fringes == fine_plan(known, DEPTH_MM).fringes
    assert ready.depth_mm == DEPTH_MM


def test_blur_makes_fringes_wider(known: Calibration) -> None:
    assert stripes(fine_plan(known, DEPTH_MM, 1.2))[-1] == pytest.approx(912 / (2.4 * np.pi), abs=1e-3)


def test_the_axis_is_the_one_that_shows_depth(known: Calibration) -> None:
    assert {fringe.axis for fringe in fine_plan(known, DEPTH_MM).fringes} == {"x"}
    pose = known.T_projector_camera
    above = replace(known, T_projector_camera=replace(pose, translation=pose.translation[[1, 0, 2]]))
    assert {fringe.axis for fringe in fine_plan(above, (440.0, 450.0)).fringes} == {"y"}


def test_what_no_plan_suits_is_refused(known: Calibration) -> None:
    with pytest.raises(ConfigError, match=r"between 200 and 900 mm .* a range of about \d+ mm at most"):
        fine_plan(known, (200.0, 900.0))
    with pytest.raises(ConfigError, match="the projector lights nothing"):
        fine_plan(known, (10.0, 12.0))
    fine_plan(known, DEPTH_MM, noise=0.02)
    with pytest.raises(ConfigError, match=r"noise of 20\.0 % of the modulation"):
        fine_plan(known, DEPTH_MM, noise=0.2)


def test_walls_are_bent_less_by_finer_fringes(known: Calibration) -> None:
    offered = fine_plan(known, DEPTH_MM)
    ratio = error_ratio(Plan.load("plan_paper"), offered, known.projector.size)
    assert ratio == pytest.approx(6.72, abs=0.01)
    assert error_ratio(offered, offered, known.projector.size) == 1.0


def test_uncertainty_is_widened_where_fine_sets_disagree(known: Calibration) -> None:
    ones = np.ones((60, 60), np.float32)
    misfit = np.abs(np.random.default_rng(4).standard_normal((60, 60, 2))).mean(axis=2).astype(np.float32)
    misfit[:30] = 3.0
    misfit[50, 50] = np.nan
    decoded = Decoded(ones, ones, 50 * ones, 0.03 * ones, disagreement=misfit, sigma_phase_error=0.04 * ones)
    decoded = replace(decoded, disagreement=misfit)
    widened = widened_by_disagreement(decoded, fine_plan(known, DEPTH_MM))
    ratio = 3.0 / max(1.0, decoded.typical_disagreement)
    np.testing.assert_allclose(widened.sigma_total[:25], ratio * 0.05, rtol=1e-5)
    np.testing.assert_allclose(widened.sigma_total[35:], 0.05, rtol=1e-5)
    assert widened_by_disagreement(decoded, Plan.load("plan_paper")) is decoded, "wide sets say little"
    for widest, is_fine in ((15.0, False), (17.0, True), (64.0, True)):
        sets = [Sinusoid(axis="x", stripes=stripes, steps=4) for stripes in (widest, 64.0)]
        plan = Plan(fringes=tuple(sets), unwrapping="guided", depth_mm=DEPTH_MM)
        assert (widened_by_disagreement(decoded, plan) is not decoded) == is_fine
