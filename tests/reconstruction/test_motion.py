"""A part that moves evenly during a scan is compensated and told; vibration is left alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from benchmarks.motion import DIRECTIONS, FOUR_STEPS, PLANS, MovingScene, measured, period_mm
from fpplab.core.progress import no_progress
from fpplab.diagnosis import Diagnosis, diagnose_scan
from fpplab.patterns.motion import Compensation, PartMotion
from fpplab.phase import decode
from fpplab.phase.limits import MOTION
from fpplab.pipeline.measuring import triangulate_recording
from fpplab.reconstruction.following import Follower, fit_set, patches_about
from fpplab.reconstruction.motion import _part_motion, compensate_motion
from fpplab.reconstruction.moving_parts import MovingPart, MovingTiles
from tests.diagnosis.scenes import Bench, plan_of

SEED = 3
UPWARDS = np.array([0.0, 0.0, 1.0])


def test_parts_at_rest_are_left_alone() -> None:
    scene = MovingScene(FOUR_STEPS, seed=SEED)
    recording = scene.recording()
    assert compensate_motion(recording, scene.rig) is recording


def test_motion_shows_in_tiles_of_sets_with_more_than_three_steps() -> None:
    for plan, shows in ((FOUR_STEPS, True), (plan_of(steps=(3, 3, 3)), False)):
        recording = MovingScene(plan, (0.0, 0.0, 5.0), SEED).recording()
        assert (MovingTiles.of(recording) is not None) == shows


@pytest.mark.whole
@pytest.mark.parametrize(
    "bench", [Bench(plan_of(), seed=SEED, moves_px=0.6), Bench(plan_of(), seed=SEED, flicker=0.05)]
)
def test_vibration_and_flicker_are_no_motion(bench: Bench) -> None:
    recording = bench.recording()
    assert compensate_motion(recording, bench.rig()) is recording


@pytest.mark.whole
def test_a_part_that_moves_is_compensated_and_told() -> None:
    displaced = 0.5 * period_mm(FOUR_STEPS, UPWARDS)
    scene = MovingScene(FOUR_STEPS, (0.0, 0.0, displaced), SEED)
    rest = replace(scene, moved_mm=(0.0, 0.0, 0.0))
    recording = scene.recording()
    stilled = compensate_motion(recording, scene.rig)
    assert stilled.motion is not None
    (part,) = stilled.motion.parts
    np.testing.assert_allclose(part.moved_mm, scene.moved_mm, atol=0.1)
    assert part.is_compensated
    still, without, compensated = (
        measured(each, frames)
        for each, frames in ((rest, rest.recording()), (scene, recording), (scene, stilled))
    )
    assert compensated.rms_um**2 - still.rms_um**2 < (without.rms_um / 5.0) ** 2
    assert compensated.rms_um < 1.5 * compensated.stated_um
    assert f"moved by {displaced:.1f}" in compensated.told


@pytest.mark.parametrize("way", DIRECTIONS)
def test_sets_that_share_an_offset_tell_phases_at_nearly_even_ones(way: str) -> None:
    """Steps of a quarter period are two thirds of one after a motion by two fringes."""
    displaced = 2.0 * period_mm(FOUR_STEPS, DIRECTIONS[way]) * DIRECTIONS[way]
    scene = MovingScene(FOUR_STEPS, (float(displaced[0]), float(displaced[1]), float(displaced[2])), SEED)
    points, _, part = scene.surface(scene.middle)
    follower = Follower(scene.recording(), scene.rig, points[..., 2], 1.0)
    pixels = np.argwhere(part)[::50]
    alone, together = (
        np.median(fit.inverse[:, 1, 1] + fit.inverse[:, 2, 2])
        for fit in (fit_set(*follower.followed(pixels, displaced, 2)), follower.fits(pixels, displaced)[2])
    )
    assert together < 0.2 * alone


def test_likely_depths_are_those_of_the_part() -> None:
    """At uneven steps too, where phases of single sets give wrong orders."""
    plan, direction = PLANS["nine"], DIRECTIONS["axial"]
    scene = MovingScene(plan, (0.0, 0.0, float(-period_mm(plan, direction))), SEED)
    points, _, part = scene.surface(scene.middle)
    level = np.full(part.shape, 450.0)
    follower = Follower(scene.recording(), scene.rig, level, 1.0)
    patches = patches_about(np.argwhere(binary_erosion(part, iterations=3))[::500], part.shape)
    depth, _ = follower.likely(patches, np.array(scene.moved_mm))
    off = np.abs(depth - points[..., 2][tuple(patches.T)])
    assert np.mean(off < 0.1) > 0.9


def test_pixels_beside_patches_have_the_depth_of_the_nearest(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = MovingScene(PLANS["nine"], seed=SEED)
    follower = Follower(scene.recording(), scene.rig, np.full(scene.surface(0.0)[2].shape, 300.0), 1.0)
    monkeypatch.setattr("fpplab.reconstruction.following.MOTION", MOTION._replace(max_patches=4))
    pixels = np.argwhere(scene.surface(0.0)[2])
    depth = follower.with_likely_depths(pixels, np.zeros(3)).depth
    assert (depth[tuple(pixels.T)] > 400.0).all()
    assert len(np.unique(depth[tuple(pixels.T)])) <= 4 * MOTION.patch_px**2
    assert depth[0, 0] == 300.0


@pytest.mark.whole
@pytest.mark.parametrize("fringes", [1.0, pytest.param(2.0, marks=pytest.mark.nightly)])
def test_a_part_whose_orders_depend_on_its_motion_is_compensated(fringes: float) -> None:
    """After two fringes one set shows two phases, and only both sets together tell the depth."""
    plan, direction = PLANS["nine"], DIRECTIONS["axial"]
    scene = MovingScene(plan, (0.0, 0.0, float(-fringes * period_mm(plan, direction))), 16)
    compensated = measured(scene, compensate_motion(scene.recording(), scene.rig))
    assert compensated.rms_um < 1.5 * compensated.stated_um
    assert compensated.share > 0.7
    assert "it is compensated" in compensated.told


def test_a_part_whose_orders_scatter_is_not_compensated() -> None:
    displaced = 0.5 * period_mm(FOUR_STEPS, UPWARDS)
    scene = MovingScene(FOUR_STEPS, (0.0, 0.0, displaced), SEED)
    points, _, part = scene.surface(scene.middle)
    part[:110] = part[130:] = False
    follower = Follower(scene.recording(), scene.rig, points[..., 2], 1.0)
    region = MovingPart(np.array(scene.moved_mm), 1e-6 * np.eye(3), part, np.zeros_like(part), 1.0, part)
    for share, is_compensated in ((0.95, True), (0.5, False)):
        measured_pixels = np.random.default_rng(SEED).random(part.shape) < share
        motion, _ = _part_motion(follower, replace(region, measured=measured_pixels))
        assert motion.is_compensated == is_compensated


def test_a_part_of_which_little_follows_is_not_compensated() -> None:
    moving = np.zeros((8, 8), np.bool_)
    moving[2:6] = True
    for rows, is_followed in ((3, True), (1, False)):
        mask = np.zeros_like(moving)
        mask[2 : 2 + rows] = True
        region = MovingPart(np.zeros(3), np.eye(3), mask, mask, 1.0, moving)
        assert region.is_followed == is_followed
        assert region.judged.mask.sum() == (8 * rows if is_followed else moving.sum())


def test_pixels_that_a_part_passes_by_do_not_spoil_its_own() -> None:
    scene = MovingScene(FOUR_STEPS, (0.0, 0.0, 2.0 * period_mm(FOUR_STEPS, UPWARDS)), SEED)
    points, _, part = scene.surface(scene.middle)
    follower = Follower(scene.recording(), scene.rig, points[..., 2], 1.0)
    every, moved = np.argwhere(np.ones_like(part)), np.array(scene.moved_mm)
    together = follower.residuals(every, moved, gains=False)[:, part.ravel()]
    alone = follower.residuals(np.argwhere(part), moved, gains=False)
    ratio = np.median(np.square(together).sum(axis=0)) / np.median(np.square(alone).sum(axis=0))
    assert ratio == pytest.approx(1.0, abs=0.2)


@pytest.mark.whole
def test_a_part_that_moves_as_the_fringes_do_is_not_good() -> None:
    plan, direction = PLANS["nine"], DIRECTIONS["axial"]
    scene = MovingScene(plan, (0.0, 0.0, float(2.0 * period_mm(plan, direction))), 17)
    told = measured(scene, compensate_motion(scene.recording(), scene.rig)).told
    assert told.startswith("verdict: doubtful: motion: ")


@pytest.mark.whole
def test_a_motion_is_told_where_it_leaves_no_points() -> None:
    scene = MovingScene(FOUR_STEPS, seed=SEED)
    part = PartMotion((1.4, 0.0, -2.4), 0.01, -0.58, (160, 120), 15_000, 2.0, 0.1, is_compensated=False)
    still = np.ones(scene.surface(0.0)[2].shape, np.float32)
    recording = replace(scene.recording(), motion=Compensation((part,), still, 0 * still))
    told = diagnose_scan(recording, decode(recording), None, scene.rig).sentence
    assert "moved by 2.78 mm (+1.40, +0.00, -2.40) over the scan" in told
    assert told.endswith("it is not compensated, since its frames do not allow it")


@pytest.mark.whole
def test_three_steps_say_what_an_unseen_motion_costs() -> None:
    scene = MovingScene(plan_of(steps=(3, 3, 3)), seed=SEED)
    recording = scene.recording()
    decoded, points = triangulate_recording(recording, scene.rig, None, no_progress)
    assert not isinstance(points, Diagnosis)
    unknown = diagnose_scan(recording, decoded, points, scene.rig).unknown
    assert any(text.startswith("motion: ") and "µm" in text for text in unknown)
