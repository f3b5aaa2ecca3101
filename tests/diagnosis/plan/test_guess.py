"""Plans guessed from images alone."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from fpplab.core.errors import DataError
from fpplab.diagnosis.plan import guess_plan
from fpplab.diagnosis.plan.guess import set_sizes
from tests.diagnosis.scenes import PROJECTOR, Bench, plan_of

PLANS = {
    "twelve steps": ("x", (12, 12, 12, 12), (1, 4, 16, 64)),
    "unequal steps": ("x", (3, 3, 12), (1, 8, 64)),
    "two axes": ("xy", (4, 4, 6), (1, 8, 48)),
    "beats": ("x", (6, 6, 6), (49, 56, 64)),
    "fine first": ("x", (3, 3), (16, 1)),
    "rows": ("y", (4, 4), (1, 20)),
}


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("name", PLANS)
def test_a_plan_is_found_from_its_images(name: str) -> None:
    axes, steps, stripes = PLANS[name]
    plan = plan_of(axes, steps, stripes)
    frames = Bench(plan=plan, seed=700 + list(PLANS).index(name)).recording().frames
    found = guess_plan(frames, 8, PROJECTOR)
    shown = [(s.axis, s.stripes, s.images) for s in found.plan.fringes]
    assert shown == [(s.axis, s.stripes, s.images) for s in plan.fringes]
    assert found.plan.unwrapping == ("heterodyne" if name == "beats" else "hierarchical")
    assert found.disagreement < 1.5
    assert found.assumed


def test_a_bent_response_of_three_steps_gives_no_other_stripes() -> None:
    frames = Bench(plan=plan_of("x", (3, 3, 3), (1, 7, 45)), seed=706, gamma=2.0).recording().frames
    assert [s.stripes for s in guess_plan(frames, 8, PROJECTOR).plan.fringes] == [1.0, 7.0, 45.0]
    # Of one stripe the images show a part of a period, which the response bends by an amount that is unknown.
    frames = Bench(plan=plan_of("x", (3, 3), (1, 16)), seed=707, gamma=2.0).recording().frames
    found = guess_plan(frames, 8, PROJECTOR, finest=16.0).plan
    assert [s.stripes for s in found.fringes] == [1.0, 16.0]
    with pytest.raises(DataError, match="with 37 stripes in the finest they agree on no position"):
        guess_plan(frames, 8, PROJECTOR, finest=37.0)


def test_images_in_reverse_order_within_their_sets_are_taken_for_the_other_sign() -> None:
    recording = Bench(plan=plan_of("x", (4, 4), (1, 16)), seed=8).recording()
    frames = [f for k in (0, 1) for f in reversed(recording.of_set(k))]
    found = guess_plan(frames, 8, PROJECTOR).plan
    assert [s.stripes for s in found.fringes] == [1.0, 16.0]
    assert [getattr(s, "shift_sign", 0) for s in found.fringes] == [-1, -1]


def test_stripes_that_cannot_be_told_are_asked_for() -> None:
    plan = plan_of("x", (6, 6), (37, 43))
    frames = Bench(plan=plan, seed=4).recording().frames
    with pytest.raises(DataError, match="--finest"):
        guess_plan(frames[6:], 8, PROJECTOR)


def test_images_that_are_no_fringe_sets_are_refused() -> None:
    frames = Bench(plan=plan_of("x", (4, 4), (1, 16)), seed=5).recording().frames
    white = np.full_like(frames[0], 200)
    with pytest.raises(DataError, match="leave out white"):
        set_sizes([white, *frames, white // 4], 255)
    with pytest.raises(DataError, match="too few: a set has at least 3"):
        set_sizes(frames[:2], 255)
    with pytest.raises(DataError, match="too few pixels"):
        set_sizes([white] * 6, 255)


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("name", ["skull_2x3", "calseq1", "calseq2", "calseq3", "calseq4", "calseq5"])
def test_plans_of_real_captures_are_found(captures: Path, name: str) -> None:
    count = 6 if "skull" in name else 12
    frames = [cv2.imread(str(captures / name / f"{i:02d}.png"), cv2.IMREAD_GRAYSCALE) for i in range(count)]
    found = guess_plan(frames, 8, (1824, 1140)).plan
    expected = [("x", 16.0, 3), ("x", 1.0, 3), ("y", 16.0, 3), ("y", 1.0, 3)]
    assert [(s.axis, s.stripes, s.images) for s in found.fringes] == expected[: count // 3]
