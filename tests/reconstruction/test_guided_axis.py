"""A plan's guided axis: what three images along y tell of the geometry and of the points."""

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import full_scale
from fpplab.core.geometry import RigidTransform
from fpplab.diagnosis import Verdict, diagnose_scan
from fpplab.diagnosis.points import systematic_epipolar_px
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.points import points_of
from tests.support.warmup import frames_of_plane, small_rig

PLAN, RIG = Plan.load("plan_scan"), small_rig()
PX_PER_TURN = 2200.0 * np.radians(0.1)
"""How far a turn by 0.1 degrees about x moves the middle of the picture, in rows."""


def recording(gamma: float = 1.0) -> Recording:
    """Frames of a plane with a camera's noise; the response is bent by an exponent."""
    random = np.random.default_rng(7)
    frames = []
    for image in frames_of_plane(PLAN, RIG, 16):
        level = 250.0 * (image / full_scale(16)) ** gamma
        frames.append(np.rint(level + random.normal(0.0, 1.0, level.shape)).clip(0, 254).astype(np.uint8))
    return Recording(frames, PLAN, RIG.projector.size)


def turned(degrees: float) -> Calibration:
    turn = RigidTransform.from_vectors(np.array([np.radians(degrees), 0.0, 0.0]), np.zeros(3))
    return Calibration(RIG.camera, RIG.projector, turn @ RIG.T_projector_camera, {})


def decoded_with(calibration: Calibration, of: Recording) -> Decoded:
    return decode(of, bounds=decoding_bounds(PLAN, calibration, None))


def test_the_coordinate_is_right_and_as_uncertain_as_it_says() -> None:
    of = recording()
    decoded = decoded_with(RIG, of)
    true = decode(
        Recording(frames_of_plane(PLAN, RIG, 16), PLAN, RIG.projector.size, 16),
        bounds=decoding_bounds(PLAN, RIG, None),
    )
    assert decoded.valid.mean() > 0.95
    assert (np.isfinite(decoded.v) == decoded.valid).all()
    ratio = np.nanstd((decoded.v - true.v) / (decoded.sigma_total * decoded.v_per_u))
    assert 0.8 < ratio < 1.25


@pytest.mark.parametrize("gamma", [1.0, 1.6])
def test_a_sound_geometry_is_no_finding_and_a_turned_one_is(gamma: float) -> None:
    of = recording(gamma)
    for degrees, found in ((0.0, False), (0.1, True)):
        calibration = turned(degrees)
        decoded, cloud = points_of(decoded_with(calibration, of), calibration, PLAN)
        off = systematic_epipolar_px(cloud)
        assert off == pytest.approx(degrees / 0.1 * PX_PER_TURN, abs=0.5)
        keys = [finding.cause.key for finding in diagnose_scan(of, decoded, cloud, calibration).findings]
        assert ("stale_calibration" in keys) is found


def test_orders_that_nothing_tells_are_refused() -> None:
    of, calibration = recording(), turned(0.25)
    decoded, cloud = points_of(decoded_with(calibration, of), calibration, PLAN)
    assert np.isnan(decoded.v).all()
    assert decoded.valid.mean() > 0.95
    diagnosis = diagnose_scan(of, decoded, cloud, calibration)
    assert diagnosis.verdict is Verdict.USELESS
    assert "stale_calibration" in [finding.cause.key for finding in diagnosis.findings]


def test_without_a_calibration_the_other_axis_is_decoded() -> None:
    decoded = decode(recording())
    assert decoded.valid.mean() > 0.95
    assert np.isnan(decoded.v).all()
