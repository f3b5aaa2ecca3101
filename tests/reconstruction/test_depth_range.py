"""Intervals of projector coordinates are those of the epipolar segments; a guided plan measures with them."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.core.conventions import AXES
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import RigidTransform
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.pipeline.depth import check_plan, plan_with_depth
from fpplab.reconstruction.depth_range import decoding_bounds, depth_bounds
from fpplab.reconstruction.limits import RECONSTRUCTION_LIMITS
from fpplab.reconstruction.points import triangulate
from tests.support.warmup import DISTANCE_MM, frames_of_plane, small_rig

RIG = small_rig()
NEAR, FAR = DISTANCE_MM - 40.0, DISTANCE_MM + 40.0
RANGE = DepthRange((NEAR, FAR), "plan")


def plan_of(stripes: tuple[float, ...], unwrapping: str = "guided", axes: str = "x") -> Plan:
    fringes = tuple(Sinusoid(axis=a, stripes=s, steps=4) for a in AXES if a in axes for s in stripes)
    return Plan(fringes=fringes, unwrapping=unwrapping, depth_mm=(NEAR, FAR))


def test_the_intervals_hold_every_point_of_the_range_and_little_more() -> None:
    bounds = depth_bounds(plan_of((10.0, 100.0), axes="xy"), RIG, RANGE)
    width, height = RIG.camera.size
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    slopes = RIG.camera.normalise(np.stack([u, v], axis=-1))
    rays = np.concatenate([slopes, np.ones((height, width, 1))], axis=-1)
    seen = np.stack(
        [RIG.projector.project(z * rays, RIG.T_projector_camera) for z in np.linspace(NEAR, FAR, 33)]
    )
    # Where the interval is cut at the projector's edge, interpolation over 16 px rounds the corner.
    for k, axis in enumerate(AXES):
        last = RIG.projector.size[k] - 0.5
        least, most = (np.clip(end, -0.5, last) for end in (seen[..., k].min(0), seen[..., k].max(0)))
        assert (bounds[axis].lower <= least + 1e-3).all()
        assert (bounds[axis].upper >= most - 1e-3).all()
        assert (
            bounds[axis].upper - bounds[axis].lower
            <= most - least + 2 * RECONSTRUCTION_LIMITS.interval_margin_px + 1.0
        ).all()


def test_a_guided_plan_measures_what_a_plan_with_one_stripe_does() -> None:
    guided, usual = plan_of((9.0, 40.0, 120.0)), plan_of((1.0, 9.0, 40.0, 120.0), "hierarchical")
    clouds = []
    for plan in (guided, usual):
        recording = Recording(frames_of_plane(plan, RIG, 16), plan, RIG.projector.size, 16)
        decoded = decode(recording, bounds=decoding_bounds(plan, RIG, RANGE))
        clouds.append(triangulate(decoded, RIG))
    assert len(clouds[0]) == len(clouds[1]) > 1000
    np.testing.assert_allclose(clouds[0].points[:, 2], DISTANCE_MM, atol=0.05)


def test_without_a_range_there_are_no_intervals_and_guided_plans_are_refused() -> None:
    plan = plan_of((9.0, 120.0)).model_copy(update={"depth_mm": None})
    assert not decoding_bounds(plan, RIG, None)
    with pytest.raises(ConfigError, match="needs a calibration and a depth range"):
        check_plan(plan, "plan", RIG)
    check_plan(plan_with_depth(plan, (NEAR, FAR)), "plan", RIG)


def test_a_range_that_is_too_wide_for_the_plan_is_refused() -> None:
    with pytest.raises(ConfigError, match="guided unwrapping in this depth range needs a set"):
        check_plan(plan_with_depth(plan_of((40.0, 120.0)), (100.0, 2000.0)), "plan", RIG)


def test_a_range_behind_the_projector_is_refused() -> None:
    ahead = RigidTransform(RIG.T_projector_camera.rotation, np.array([0.0, 0.0, -200.0]))
    rig = replace(RIG, T_projector_camera=ahead)
    with pytest.raises(
        ConfigError, match=r"rig\.yaml: 'depth_mm': 100 to 500 mm has points behind the projector"
    ):
        depth_bounds(plan_of((9.0, 120.0)), rig, DepthRange((100.0, 500.0), "rig.yaml: 'depth_mm'"))


@pytest.mark.parametrize("depth", [(500.0, 300.0), (-1.0, 300.0), (300.0, 300.0)])
def test_a_range_that_is_none_is_refused(depth: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match=r"--depth: .*depth_mm"):
        plan_with_depth(plan_of((9.0, 120.0)), depth)
