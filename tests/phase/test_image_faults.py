"""σ holds for frames that something has changed between sensor and decoder."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.image_faults import (
    OTHERS,
    SIGMA_JUDGED,
    Damage,
    KnownScene,
    drawn_scene,
    jpeg,
    stated_and_actual,
)
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.phase.common_errors import fit_sinusoids, fringe_levels
from fpplab.phase.error_model import error_model_of
from fpplab.phase.isolated import isolated_pixels

PROJECTOR = (912, 1140)


@cache
def known_scene() -> KnownScene:
    return drawn_scene(21)


def damaged(damage: Damage) -> Recording:
    frames = damage(known_scene().frames, np.random.default_rng(22))
    return Recording(frames, known_scene().plan, PROJECTOR)


FAULTS = {name: SIGMA_JUDGED[name] for name in ("healthy", "gaussian", "bilateral", "sharpened", "lag")}


@pytest.mark.parametrize("fault", [*FAULTS, "jpeg"])
def test_sigma_is_that_of_the_errors(fault: str) -> None:
    decoded = decode(damaged(FAULTS.get(fault, jpeg(70))))
    stated, actual = stated_and_actual(known_scene(), decoded)
    assert 0.8 < stated / actual < 1.25


@pytest.mark.parametrize("fault", ["jpeg", "median", "bilateral", "non_local"])
def test_sigma_holds_for_filtered_frames_of_three_steps(fault: str) -> None:
    scene, damage = drawn_scene(22, (3,)), SIGMA_JUDGED[fault]
    frames = damage(scene.frames, np.random.default_rng(22))
    stated, actual = stated_and_actual(scene, decode(Recording(frames, scene.plan, PROJECTOR)))
    assert 0.8 < stated / actual < 1.25


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(("fault", "seed"), [("median", 8331), ("sharpened", 8330)])
def test_sigma_is_not_that_of_what_a_filter_bends(fault: str, seed: int) -> None:
    scene = drawn_scene(seed)
    frames = SIGMA_JUDGED[fault](scene.frames, np.random.default_rng([44, seed]))
    stated, actual = stated_and_actual(scene, decode(Recording(frames, scene.plan, PROJECTOR)))
    assert 0.8 < stated / actual < 1.25


def test_frames_as_the_sensor_gives_them_show_nothing() -> None:
    three_steps = drawn_scene(22, (3,))
    for recording in (damaged(FAULTS["healthy"]), Recording(three_steps.frames, three_steps.plan, PROJECTOR)):
        errors = error_model_of(recording)
        assert errors.lag == 0.0
        assert all(one.scatter == 1.0 and one.ripple_rad == 0.0 for one in errors.sets)


def vibrating(scene: KnownScene, px: float, seed: int) -> Recording:
    """Displace the projector's picture on the part in every frame, by a standard deviation in px."""
    frames, random = list(scene.frames), np.random.default_rng(seed)
    for fringe, first, end in zip(
        scene.plan.fringes, *(scene.plan.set_starts[k:] for k in (0, 1)), strict=False
    ):
        levels = np.stack(frames[first:end]).astype(np.float64)
        fitted = fit_sinusoids(levels.reshape(len(levels), -1), fringe)
        by_phase = fringe_levels(fitted, fringe.phase_shifts())[1].reshape(levels.shape)
        moved = px * fringe.phase_per_px(PROJECTOR) * random.standard_normal((len(levels), 1, 1))
        frames[first:end] = list(np.clip(np.rint(levels + moved * by_phase), 0, 255).astype(np.uint8))
    return Recording(frames, scene.plan, PROJECTOR)


@pytest.mark.parametrize("seed", [47, 52, 57])
def test_vibration_is_not_stated_as_noise(seed: int) -> None:
    scene = drawn_scene(seed, (6,))
    moved = decode(vibrating(scene, 0.15, seed))
    used = scene.judged & moved.valid
    error = (moved.u - scene.seen[..., 0])[used]
    # Of the error by vibration, which is common to all pixels of a phase, its first harmonics.
    phase = scene.plan.finest.phase_per_px(PROJECTOR) * (scene.seen[..., 0][used] + 0.5)
    waves = np.stack([part(k * phase) for k in range(4) for part in (np.cos, np.sin)], axis=1)
    noise = error - waves @ np.linalg.lstsq(waves, error, rcond=None)[0]
    stated = float(np.sqrt(np.mean(np.square(moved.sigma[used]))))
    assert 0.85 < stated / noise.std() < 1.25


def test_bands_of_rows_show_of_neighbours_what_the_whole_image_does() -> None:
    """Rows of different bands are no neighbours, though they follow each other in the frames."""
    scene = drawn_scene(23, (3,))
    dark = [frame // 6 for frame in scene.frames]
    rows = np.concatenate([np.arange(first, first + 18) for first in range(0, len(dark[0]) - 18, 36)])
    bands = Recording([frame[rows] for frame in dark], scene.plan, PROJECTOR)
    assert max(errors.scatter for errors in error_model_of(replace(bands, rows=rows)).sets) < 1.3
    assert max(errors.scatter for errors in error_model_of(bands).sets) > 2.0


def test_light_that_differs_by_phase_and_frame_is_no_filter() -> None:
    # Such as that of a projector whose period does not divide the exposure.
    scene, random = drawn_scene(23, (12,)), np.random.default_rng(24)
    finest = scene.plan.finest
    phase = finest.phase_per_px(PROJECTOR) * (scene.seen[..., 0] + 0.5)
    frames = list(scene.frames)
    for n in scene.plan.finest_images:
        changed = frames[n] * (1.0 + 0.03 * np.cos(3 * phase + random.uniform(0, 6)))
        frames[n] = np.clip(np.rint(changed), 0, 255).astype(np.uint8)
    errors = error_model_of(Recording(frames, scene.plan, PROJECTOR)).sets[scene.plan.finest_set("x")]
    assert errors.scatter == 1.0


def test_the_share_of_the_frame_before_is_found() -> None:
    frames = [frame.astype(float) for frame in known_scene().frames]
    for n in range(len(frames) - 1, 0, -1):
        frames[n] = 0.95 * frames[n] + 0.05 * frames[n - 1]
    mixed = [np.rint(frame).astype(np.uint8) for frame in frames]
    assert error_model_of(Recording(mixed, known_scene().plan, PROJECTOR)).lag == pytest.approx(
        0.05, abs=0.005
    )


def test_a_pixel_that_contradicts_its_sinusoid_tells_its_own_variance() -> None:
    frames = [frame.copy() for frame in known_scene().frames]
    first = known_scene().plan.set_starts[known_scene().plan.finest_set("x")]
    rows = slice(150, 200)
    frames[first + 1][rows] = frames[first][rows]
    decoded = decode(Recording(frames, known_scene().plan, PROJECTOR))
    changed = np.zeros(known_scene().judged.shape, bool)
    changed[rows] = True
    stated, actual = stated_and_actual(replace(known_scene(), judged=known_scene().judged & changed), decoded)
    assert stated == pytest.approx(actual, rel=0.4)


@pytest.mark.parametrize("seed", [1, 2])
def test_wrong_orders_of_hot_pixels_are_left_out(seed: int) -> None:
    scene = drawn_scene(seed)
    frames = OTHERS["hot_pixels"](scene.frames, np.random.default_rng(seed))
    decoded = decode(Recording(frames, scene.plan, PROJECTOR))
    error = np.abs(decoded.u - scene.seen[..., 0])[scene.judged & decoded.valid]
    assert error.max() < 0.5 * PROJECTOR[0] / max(fringe.stripes for fringe in scene.plan.fringes)
    assert (scene.judged & ~decoded.valid).mean() < 0.01


def test_a_pixel_is_isolated_that_at_most_one_neighbour_agrees_with() -> None:
    coordinate = np.tile(np.arange(9, dtype=np.float32), (9, 1))
    coordinate[2, 2] += 12.0
    coordinate[6, 5:7] += 12.0  # two that touch
    coordinate[:, 8] += 30.0  # the edge of a part
    assert np.argwhere(isolated_pixels(coordinate, 12.0)).tolist() == [[2, 2], [6, 5], [6, 6]]
    coordinate[1:3, 1] = coordinate[1:3, 3] = np.nan
    assert not isolated_pixels(coordinate, 12.0)[2, 2], "few neighbours are measured"
    apart = 20.0 * np.arange(81, dtype=np.float32).reshape(9, 9)
    assert not isolated_pixels(apart, 12.0).any(), "no neighbours are of one surface"
