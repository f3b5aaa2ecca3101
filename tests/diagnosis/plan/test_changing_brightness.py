"""Frames whose brightness a camera or a program changed are told from Gray code and wrong orders."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from fpplab.core.conventions import Image
from fpplab.diagnosis.plan import describe_changing_brightness
from fpplab.pipeline.decoding import fault_in_step
from tests.diagnosis.plan.test_other_patterns import PLAN, SETS, GrayBench, sinusoids
from tests.diagnosis.scenes import Bench, plan_of


def stretched(frames: Sequence[Image]) -> list[Image]:
    """As programs save images that are shown at full contrast."""
    ranges = [(int(f.min()), int(f.max())) for f in frames]
    return [
        np.rint((f - float(low)) * (255.0 / (high - low))).astype(np.uint8)
        for f, (low, high) in zip(frames, ranges, strict=True)
    ]


def with_gains(spread: float, seed: int) -> Callable[[Sequence[Image]], list[Image]]:
    gains = 0.8 * (1.0 + spread * np.random.default_rng(seed).standard_normal(sum(SETS)))
    return lambda frames: [np.rint(f * gain).astype(np.uint8) for f, gain in zip(frames, gains, strict=True)]


@pytest.mark.parametrize("change", [with_gains(0.03, 1), with_gains(0.08, 2), with_gains(0.15, 3), stretched])
def test_changing_brightness_is_named(change: Callable[[Sequence[Image]], list[Image]]) -> None:
    said = describe_changing_brightness(change(sinusoids(61)), 255, SETS)
    assert said is not None
    assert "the brightness changes from frame to frame, by" in said
    assert "automatic exposure" in said


def test_it_is_named_before_anything_else(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Bench(plan=PLAN, seed=62).recording()
    changed = replace(recording, frames=with_gains(0.25, 4)(recording.frames), is_imported=True)
    fault = fault_in_step(changed)
    assert fault is not None
    assert fault.startswith("the brightness changes")


@pytest.mark.parametrize("seed", range(63, 67))
def test_other_images_are_left_to_the_other_checks(seed: int) -> None:
    bench = Bench(plan=PLAN, seed=seed, gamma=1.0 + 0.3 * (seed - 63), ambient=0.05 * (seed - 63))
    waves = list(bench.recording().frames)
    assert describe_changing_brightness(waves, 255, SETS) is None
    codes = list(GrayBench(plan=plan_of("x", (5,), (1,)), seed=seed).recording().frames)
    white, black = np.max(waves, axis=0), np.min(waves, axis=0)
    for frames in (
        [*codes, *waves[:9]],
        [white, black, *waves[:12]],
        [*waves[:12], white, black],
        [*waves[:9], waves[10], waves[9], *waves[11:]],
        [*waves[1:], waves[0]],
    ):
        assert describe_changing_brightness(frames, 255, SETS) is None
