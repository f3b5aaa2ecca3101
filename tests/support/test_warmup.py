"""The small scene that the set-up compiles with is a whole measurement, and a right one."""

import numpy as np
import pytest

from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.reconstruction.points import triangulate
from tests.support.warmup import (
    DISTANCE_MM,
    SIZE,
    decode_code,
    frames_of_plane,
    observe_board,
    small_rig,
    warm_up,
)


@pytest.mark.parametrize("plan", ["plan_paper", "plan_board"])
def test_the_plane_is_measured_where_it_is(plan: str) -> None:
    rig, chosen = small_rig(), Plan.load(plan)
    decoded = decode(Recording(frames_of_plane(chosen, rig, 16), chosen, rig.projector.size, 16))
    cloud = triangulate(decoded, rig)
    assert len(cloud) == SIZE[0] * SIZE[1]
    assert np.abs(cloud.points[:, 2] - DISTANCE_MM).max() < 1e-3


def test_every_point_of_the_board_is_observed_where_it_is() -> None:
    found = observe_board()
    assert len(found.ids) == 52
    np.testing.assert_allclose(found.projector_px, found.camera_px, atol=1e-6)


def test_the_code_is_that_of_the_image() -> None:
    u = decode_code().u
    assert np.isfinite(u).mean() > 0.95
    np.testing.assert_allclose(
        u[np.isfinite(u)], np.broadcast_to(np.arange(SIZE[0]), u.shape)[np.isfinite(u)], atol=2.0
    )


@pytest.mark.whole
def test_every_pixel_of_the_warm_up_is_measured() -> None:
    assert warm_up() == SIZE[0] * SIZE[1]
