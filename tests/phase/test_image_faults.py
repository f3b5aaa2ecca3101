"""σ holds for frames that something has changed between sensor and decoder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.image_faults import SIGMA_JUDGED, Damage, drawn_scene, jpeg, stated_and_actual
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.phase.error_model import error_model_of

SCENE = drawn_scene(21)
PROJECTOR = (912, 1140)


def damaged(damage: Damage) -> Recording:
    frames = damage(SCENE.frames, np.random.default_rng(22))
    return Recording(frames, SCENE.plan, PROJECTOR)


FAULTS = {name: SIGMA_JUDGED[name] for name in ("healthy", "gaussian", "bilateral", "sharpened", "lag")}


@pytest.mark.parametrize("fault", [*FAULTS, "jpeg"])
def test_sigma_is_that_of_the_errors(fault: str) -> None:
    decoded = decode(damaged(FAULTS.get(fault, jpeg(70))))
    stated, actual = stated_and_actual(SCENE, decoded)
    assert 0.8 < stated / actual < 1.25


def test_frames_as_the_sensor_gives_them_show_nothing() -> None:
    errors = error_model_of(damaged(FAULTS["healthy"]))
    assert errors.lag == 0.0
    assert all(one.scatter == 1.0 and one.ripple_rad == 0.0 for one in errors.sets)


def test_the_share_of_the_frame_before_is_found() -> None:
    frames = [frame.astype(float) for frame in SCENE.frames]
    for n in range(len(frames) - 1, 0, -1):
        frames[n] = 0.95 * frames[n] + 0.05 * frames[n - 1]
    mixed = [np.rint(frame).astype(np.uint8) for frame in frames]
    assert error_model_of(Recording(mixed, SCENE.plan, PROJECTOR)).lag == pytest.approx(0.05, abs=0.005)


def test_a_pixel_that_contradicts_its_sinusoid_tells_its_own_variance() -> None:
    frames = [frame.copy() for frame in SCENE.frames]
    first = SCENE.plan.set_starts[SCENE.plan.finest_set("x")]
    rows = slice(150, 200)
    frames[first + 1][rows] = frames[first][rows]
    decoded = decode(Recording(frames, SCENE.plan, PROJECTOR))
    changed = np.zeros(SCENE.judged.shape, bool)
    changed[rows] = True
    stated, actual = stated_and_actual(replace(SCENE, judged=SCENE.judged & changed), decoded)
    assert stated == pytest.approx(actual, rel=0.4)
