"""What the geometry promises: by hand for a simple rig, and beside what a scan then has."""

from pathlib import Path

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.devices.rig import Rig
from fpplab.patterns.plan import Plan
from fpplab.pipeline.measuring import reconstruct_points
from fpplab.pipeline.taking import take_or_resume_session
from fpplab.setup.live.expectation import RigGeometry, WorkingPoint
from fpplab.setup.live.orders import Order
from fpplab.setup.live.status import overall_median
from tests.setup.live.benches import PLAN, Operator, operate, rig_file

BASELINE, FOCAL, SIZE = 100.0, 500.0, (600, 400)


def parallel() -> Calibration:
    """Two equal devices side by side that look the same way."""
    one = Pinhole.from_focal(SIZE, (FOCAL, FOCAL), ((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2))
    return Calibration(one, one, RigidTransform(np.eye(3), np.array([-BASELINE, 0.0, 0.0])), {})


def converging(angle_deg: float) -> Calibration:
    """The projector is turned so that both middle rays meet 400 mm before the camera."""
    turn = RigidTransform.from_vectors(np.radians([0.0, angle_deg, 0.0]), np.zeros(3))
    centre = np.array([400.0 * np.tan(np.radians(angle_deg)), 0.0, 0.0])
    pose = RigidTransform(turn.rotation, -turn.rotation @ centre)
    return Calibration(parallel().camera, parallel().projector, pose, {})


@pytest.mark.parametrize("distance_mm", [200.0, 400.0, 1000.0])
def test_the_overlap_of_parallel_devices(distance_mm: float) -> None:
    geometry = RigGeometry(parallel())
    width = SIZE[0] * distance_mm / FOCAL
    assert geometry.overlap(distance_mm) == pytest.approx(1.0 - BASELINE / width, abs=1.0 / 36)
    outline = geometry.outline(distance_mm)
    assert np.ptp(outline[:, 0]) == pytest.approx(width - BASELINE, rel=0.08)
    assert set(outline[:, 2]) == {distance_mm}
    assert np.array_equal(outline[0], outline[-1])


def test_devices_that_see_nothing_in_common() -> None:
    geometry = RigGeometry(parallel(), DepthRange((50.0, 60.0), "rig"))
    assert geometry.overlap(50.0) == 0.0
    assert geometry.outline(50.0).shape == (0, 3)
    working = WorkingPoint(geometry, PLAN, 50.0)
    assert working.summary()["angle_deg"] is None
    assert working.summary()["calibration_um"] is None


def test_where_both_middle_rays_meet() -> None:
    geometry = RigGeometry(converging(20.0))
    assert geometry.meeting_mm == pytest.approx(400.0)
    near, far = geometry.depth_mm
    assert near < 400.0 < far
    assert WorkingPoint(geometry, PLAN, 400.0).angle_deg == pytest.approx(angle_at_400_mm(20.0), abs=0.3)
    away = geometry.calibration.T_projector_camera.rotation.T
    turned = RigidTransform(away, -away @ geometry.calibration.projector_centre)
    with pytest.raises(ConfigError, match="--distance"):
        _ = RigGeometry(Calibration(parallel().camera, parallel().projector, turned, {})).meeting_mm


def angle_at_400_mm(angle_deg: float) -> float:
    """The median over the field, by the law of cosines: the middle ray alone has the angle itself."""
    v, u = np.meshgrid(np.linspace(-0.4, 0.4, 81), np.linspace(-0.6, 0.6, 121), indexing="ij")
    points = 400.0 * np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    base = 400.0 * np.tan(np.radians(angle_deg))
    one, other = np.linalg.norm(points, axis=1), np.linalg.norm(points - [base, 0, 0], axis=1)
    seen = converging(angle_deg).projector.sees(points, converging(angle_deg).T_projector_camera)
    cosine = (one**2 + other**2 - base**2) / (2 * one * other)
    return float(np.degrees(np.median(np.arccos(cosine[seen]))))


def test_a_stated_range_is_the_range() -> None:
    stated = DepthRange((380.0, 480.0), "plan")
    assert RigGeometry(converging(15.0), stated).depth_mm == (380.0, 480.0)


def test_the_coordinates_change_along_the_ray() -> None:
    """For parallel devices u = f (x - b)/z, so that along the middle ray du/dz = f b/z²."""
    working = WorkingPoint(RigGeometry(parallel()), PLAN, 400.0)
    per_mm = working.px_per_mm[1:3, 2:4]
    assert per_mm[..., 0] == pytest.approx(FOCAL * BASELINE / 400.0**2, rel=0.05)
    assert per_mm[..., 1] == pytest.approx(0.0, abs=0.02)


GRAY = [{"kind": "even", "levels": [1, 0]}, {"kind": "gray", "axis": "x", "bits": 7, "cell_px": 2}]


# Darker images are rounded so coarsely that a scan states more, for neighbours are rounded alike.
@pytest.mark.parametrize(("exposure_s", "axes"), [(0.02, "x"), (0.01, "xy"), (0.02, "")])
def test_the_expected_noise_is_that_of_a_scan(exposure_s: float, axes: str, tmp_path: Path) -> None:
    """The plan has more steps and a set between those that the set-up shows; fringes are blurred."""
    sets = [
        {"axis": axis, "stripes": s, "steps": n}
        for axis in axes
        for s, n in ((1, 4), (6, 5), (38 if axis == "x" else 20, 9))
    ]
    plan = config.validate({"fringes": sets or GRAY, "exposure_s": exposure_s}, Plan, "plan")
    path = rig_file(tmp_path, projector={"blur": 1.0})
    world = Rig.load(path)
    with world:
        assert world.simulation is not None
        model = world.simulation.world  # type: ignore[attr-defined]
        known = Calibration(
            model.camera.model(),
            model.projector.model(),
            model.projector.T_camera_projector.transform().inverse(),
            {},
        )
        session = take_or_resume_session(world, plan, tmp_path / "scan")
    _, cloud = reconstruct_points(session, known)
    assert cloud.sigma_noise_mm is not None
    found = 1e3 * float(np.median(cloud.sigma_noise_mm))
    operator = Operator(Order.QUIT, after=17)
    operate(path, operator, plan=plan, working=WorkingPoint(RigGeometry(known), plan, 450.0))
    noise_um = operator.seen[-1].noise_um
    assert noise_um is not None
    assert overall_median(noise_um) == pytest.approx(found, rel=0.07 if axes else 0.15)
