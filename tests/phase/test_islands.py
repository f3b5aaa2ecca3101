"""One set of fringes: islands that neighbours unwrap, and orders that are known or said to be unknown."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError
from fpplab.diagnosis import Diagnosis, Verdict, diagnose_decoded
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import KnownCoordinate, Recording
from fpplab.phase import Decoded, check_unwrapping, decode
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.islands import find_islands
from fpplab.pipeline.measuring import triangulate_recording
from tests.support.warmup import SIZE as CAMERA
from tests.support.warmup import small_rig

WIDTH, STRIPES = 912, 40.0
PERIOD = WIDTH / STRIPES
Y, X = np.mgrid[:110, :150].astype(float)
INSIDE = (X > 45) & (X < 115) & (Y > 30) & (Y < 80)
FLAT: Floats = 200.0 + 0.9 * X + 0.1 * Y
SHAPES = {
    "plane with a step": (FLAT + np.where(INSIDE, 1.37 * PERIOD, 0.0), 2),
    "free form": (FLAT + 8.0 * np.sin(X / 40.0) * np.cos(Y / 30.0), 1),
    "dome": (FLAT + 0.03 * np.maximum(50.0**2 - (X - 75) ** 2 - (Y - 55) ** 2, 0.0), 1),
}


def one_set(steps: int, axes: str = "x", **more: Any) -> Plan:
    fringes = [{"axis": axis, "stripes": STRIPES, "steps": steps} for axis in axes]
    return config.validate({"fringes": fringes, "unwrapping": "spatial", **more}, Plan, "plan")


def recorded(coordinate: Floats, steps: int = 4, seed: int = 1) -> Recording:
    """Frames of a modulation of 60 grey levels."""
    plan, random = one_set(steps), np.random.default_rng(seed)
    light = [plan.sets[0].light(n, coordinate, WIDTH) for n in range(steps)]
    levels = 40.0 + 120.0 * np.array(light)
    levels += random.normal(0.0, 1.0, levels.shape)
    return Recording(list(np.rint(levels * 4095 / 255).astype(np.uint16)), plan, (WIDTH, 1140), bits=12)


def errors_by_island(decoded: Decoded, truth: Floats) -> dict[int, Floats]:
    assert decoded.island is not None
    return {int(k): (decoded.u - truth)[decoded.island == k] for k in np.unique(decoded.island) if k}


@pytest.mark.parametrize("steps", [3, 4])
@pytest.mark.parametrize("shape", SHAPES)
def test_islands_are_right_up_to_one_number_of_periods(steps: int, shape: str) -> None:
    """Their spread is the bound of Cramér and Rao, and stated also for three steps."""
    truth, count = SHAPES[shape]
    decoded = decode(recorded(truth, steps))
    errors = errors_by_island(decoded, truth)
    assert len(errors) == count
    assert decoded.valid.mean() > 0.95
    bound = np.sqrt(2.0 / steps) / 60.0 * PERIOD / (2.0 * np.pi)
    for island, error in errors.items():
        assert island < 0
        order = np.rint(np.median(error) / PERIOD)
        assert np.abs(error - order * PERIOD).max() < 8.0 * bound
        assert np.std(error) < 1.1 * bound
        stated = decoded.sigma[decoded.island == island]
        assert 0.85 < np.std(error) / np.median(stated) < 1.15


def test_a_tilted_part_is_not_joined_by_an_edge_that_looks_like_a_crease() -> None:
    truth = FLAT + np.where(INSIDE, (1.0 - 0.008 - 0.016 * (79.5 - Y)) * PERIOD, 0.0)
    errors = errors_by_island(decode(recorded(truth, 3)), truth)
    for error in errors.values():
        orders = np.rint(error / PERIOD)
        assert (orders == np.median(orders)).all()


def test_two_faces_of_a_body_are_one_island() -> None:
    truth = FLAT + 0.3 * np.abs(X - 75.0)
    (error,) = errors_by_island(decode(recorded(truth)), truth).values()
    assert np.ptp(np.rint(error / PERIOD)) == 0
    assert error.size > 0.95 * truth.size


@pytest.mark.parametrize("change", [0.06, 0.2, 1.2])
def test_a_step_that_passes_through_a_whole_period_is_no_bridge(change: float) -> None:
    truth = FLAT + np.where(INSIDE, (1.0 + change * (Y - 55.0) / 25.0) * PERIOD, 0.0)
    for error in errors_by_island(decode(recorded(truth)), truth).values():
        orders = np.rint(error / PERIOD)
        assert (orders == np.median(orders)).all()


def test_a_phase_that_does_not_close_is_given_up() -> None:
    turn = np.arctan2(Y - 55.3, X - 75.3)
    islands = find_islands(
        turn % (2.0 * np.pi), np.full(turn.shape, 0.02), np.hypot(Y - 55.3, X - 75.3) > 5.0
    )
    assert islands.contradictory.any()
    assert islands.count == 0


def test_the_geometry_tells_an_order_where_only_one_is_possible() -> None:
    truth, _ = SHAPES["plane with a step"]
    for half, known in ((0.4 * PERIOD, True), (1.2 * PERIOD, False)):
        bounds = PossibleCoordinates((truth - half).astype(np.float32), (truth + half).astype(np.float32))
        decoded = decode(recorded(truth), bounds={"x": bounds})
        for island, error in errors_by_island(decoded, truth).items():
            assert (island > 0) is known
            assert not known or np.abs(error).max() < 1.0


def test_islands_of_no_possible_order_are_unknown() -> None:
    off = np.full(X.shape, 700.0, np.float32)
    decoded = decode(recorded(FLAT), bounds={"x": PossibleCoordinates(off, off + 100.0)})
    assert not decoded.of_known_order().valid.any()


def test_a_point_of_known_coordinate_tells_the_order_of_its_island() -> None:
    truth, _ = SHAPES["plane with a step"]
    point = KnownCoordinate((80, 50), float(truth[50, 80]) + 3.0)
    decoded = decode(replace(recorded(truth), known=(point,)))
    assert decoded.island is not None
    known = decoded.island > 0
    assert known[50, 80]
    assert np.abs(decoded.u - truth)[known].max() < 1.0
    placed = decoded.of_known_order()
    assert (placed.valid == known).all()
    other = KnownCoordinate((60, 50), float(truth[50, 60]) + PERIOD)
    assert not decode(replace(recorded(truth), known=(point, other))).of_known_order().valid.any()


def test_a_point_beside_the_image_is_refused() -> None:
    with pytest.raises(ConfigError, match="--known: pixel 150, 3 is none of the frames' 150 x 110"):
        decode(replace(recorded(FLAT), known=(KnownCoordinate((150, 3), 1.0),)))


def test_the_verdict_begins_with_what_is_unknown() -> None:
    truth, _ = SHAPES["plane with a step"]
    recording = recorded(truth)
    diagnosis = diagnose_decoded(recording, decode(recording))
    assert diagnosis.verdict is Verdict.UNVERIFIED
    assert diagnosis.reason.startswith(
        "2 of 2 islands, with 100% of the pixels, have an unknown fringe order"
    )
    assert any(text.startswith("islands: a step of a whole number") for text in diagnosis.unknown)


def test_more_than_one_set_is_refused() -> None:
    for plan in (one_set(4, "xy"), one_set(4, "xx")):
        with pytest.raises(ConfigError, match="spatial unwrapping takes one set along one axis"):
            check_unwrapping(plan, "plan")


def frames_of_terraces(rig: Calibration, plan: Plan) -> Recording:
    """A plane at 400 mm with a terrace that is 9 mm nearer."""
    u, v = np.meshgrid(np.arange(CAMERA[0], dtype=float), np.arange(CAMERA[1], dtype=float))
    slopes = rig.camera.normalise(np.stack([u, v], axis=-1))
    depth = np.where((u > 30) & (u < 70), 391.0, 400.0)[..., None]
    points = depth * np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1)
    coordinate = rig.projector.project(points, rig.T_projector_camera)[..., 0]
    random = np.random.default_rng(3)
    frames = [30 + 150 * plan.sets[0].light(n, coordinate, WIDTH) for n in range(4)]
    noisy = [np.rint(level + random.normal(0, 1, level.shape)).astype(np.uint8) for level in frames]
    return Recording(noisy, plan, rig.projector.size)


@pytest.mark.parametrize("depth", [(385.0, 410.0), (300.0, 600.0), None])
def test_points_are_those_of_islands_whose_order_is_known(depth: tuple[float, float] | None) -> None:
    rig = small_rig()
    recording = frames_of_terraces(rig, one_set(4))
    recording = replace(recording, depth=None if depth is None else DepthRange(depth, "--depth"))
    decoded, points = triangulate_recording(recording, rig, None, lambda share: None)
    assert decoded.island is not None
    if depth == (385.0, 410.0):
        assert not isinstance(points, Diagnosis)
        assert len(points) > 0.8 * decoded.island.size
        near = np.abs(points.points[:, 2, None] - np.array([391.0, 400.0])).min(axis=1)
        assert near.max() < 1.0
    else:
        assert isinstance(points, Diagnosis)
        assert points.verdict is Verdict.USELESS
        assert "have an unknown fringe order" in points.reason
