"""Mistakes in a plan are named, and right plans are left alone."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fpplab.core.conventions import Axis
from fpplab.diagnosis.plan import check_plan_fit
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from tests.diagnosis.scenes import PROJECTOR, Bench, plan_of

PLAN = plan_of("x", (12, 12, 12, 12), (1, 4, 16, 64))
BOTH = plan_of("xy", (4, 4, 6), (1, 8, 48))
FOUR = plan_of("x", (4, 4, 8), (1, 8, 64))
FIVE = plan_of("x", (5, 5, 5), (1, 8, 64))
BEATS = plan_of("x", (6, 6, 6), (49, 56, 64)).model_copy(update={"unwrapping": "heterodyne"})

Change = Callable[[Recording], Recording]


def with_sets(recording: Recording, sets: list[FringeSet]) -> Recording:
    return replace(recording, plan=recording.plan.model_copy(update={"fringes": tuple(sets)}))


def each(change: Callable[[FringeSet], FringeSet]) -> Change:
    return lambda recording: with_sets(recording, [change(s) for s in recording.plan.fringes])


def one(k: int, **fields: object) -> Change:
    def change(recording: Recording) -> Recording:
        sets = list(recording.plan.fringes)
        sets[k] = sets[k].model_copy(update=fields)
        return with_sets(recording, sets)

    return change


def within_sets(order: Callable[[list[np.ndarray]], list[np.ndarray]]) -> Change:
    def change(recording: Recording) -> Recording:
        frames = [f for k in range(len(recording.plan.fringes)) for f in order(list(recording.of_set(k)))]
        return replace(recording, frames=frames)

    return change


def flipped(s: FringeSet, axis: Axis) -> FringeSet:
    return s.model_copy(update={"shift_sign": -1}) if s.axis == axis else s


def exchanged(s: FringeSet) -> FringeSet:
    return s.model_copy(update={"axis": "y" if s.axis == "x" else "x"})


def backwards(recording: Recording) -> Recording:
    frames = [f for k in reversed(range(len(recording.plan.fringes))) for f in recording.of_set(k)]
    return replace(recording, frames=frames)


def swapped(first: int, second: int) -> Change:
    def change(recording: Recording) -> Recording:
        frames = list(recording.frames)
        frames[first], frames[second] = frames[second], frames[first]
        return replace(recording, frames=frames)

    return change


MISTAKES: dict[str, tuple[Plan, Change, str]] = {
    "steps reversed": (PLAN, within_sets(lambda f: f[::-1]), "images of each set were taken in reverse"),
    "late": (PLAN, within_sets(lambda f: [f[-1], *f[:-1]]), "one step late"),
    "early": (PLAN, within_sets(lambda f: [*f[1:], f[0]]), "one step early"),
    "sets reversed": (PLAN, backwards, "have 64, 16, 4, 1 stripes"),
    "60 stripes": (PLAN, one(3, stripes=60.0), r"write 'stripes: 64' in 'fringes\[3\]'"),
    "128 stripes": (PLAN, one(3, stripes=128.0), r"write 'stripes: 64' in 'fringes\[3\]'"),
    "15 stripes": (PLAN, one(2, stripes=15.0), r"write 'stripes: 16' in 'fringes\[2\]'"),
    "8 and 32 stripes": (
        PLAN,
        lambda r: one(1, stripes=8.0)(one(2, stripes=32.0)(r)),
        r"write 'stripes: 4' in 'fringes\[1\]'.*write 'stripes: 16' in 'fringes\[2\]'",
    ),
    "phase origin": (
        PLAN,
        one(3, phase_origin_rad=1.5),
        r"write 'phase_origin_rad: -?0.0\d+' in 'fringes\[3",
    ),
    "sign of one set": (PLAN, one(2, shift_sign=-1), r"write 'shift_sign: 1' in 'fringes\[2\]'"),
    "axis of one set": (BOTH, one(0, axis="y"), r"write 'axis: x' in 'fringes\[0\]'"),
    "sign of x": (BOTH, each(lambda s: flipped(s, "x")), "mirrored.*of every set along x rises.*see whether"),
    "sign of y": (BOTH, each(lambda s: flipped(s, "y")), "mirrored.*of every set along y rises.*see whether"),
    "axes exchanged": (BOTH, each(exchanged), "mirrored.*'axis: x' in every set along y"),
    "beats in another order": (BEATS, backwards, "have 64, 56, 49 stripes"),
    "all reversed": (FOUR, lambda r: replace(r, frames=list(r.frames)[::-1]), "images are in reverse order"),
    "two of the coarse": (FOUR, swapped(1, 2), "images 1 and 2 are exchanged"),
    "two of the middle": (FOUR, swapped(4, 7), "images 4 and 7 are exchanged"),
    "two of five": (FIVE, swapped(6, 8), "images 6 and 8 are exchanged"),
    "55 stripes": (BEATS, one(1, stripes=55.0), r"write 'stripes: 56' in 'fringes\[1\]'"),
}


ALIKE = {
    "late",
    "two of the coarse",
    "early",
    "128 stripes",
    "15 stripes",
    "8 and 32 stripes",
    "sign of y",
    "55 stripes",
}
"""Mistakes that another one stands for in a merge."""


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.nightly if n in ALIKE else ()) for n in MISTAKES]
)
def test_a_mistake_is_named_with_what_to_write(name: str) -> None:
    plan, change, told = MISTAKES[name]
    seed = 500 + list(MISTAKES).index(name)
    found = check_plan_fit(change(Bench(plan=plan, seed=seed).recording()))
    assert found is not None
    assert found.fault is not None
    assert_told(found.fault, told)


@pytest.mark.whole
def test_frames_whose_response_is_straightened_tell_a_mistake_best() -> None:
    bench = Bench(plan=plan_of("x", (8, 3, 3), (1, 8, 42)), seed=9152, gamma=1.6)
    found = check_plan_fit(one(2, shift_sign=-1)(bench.recording()))
    assert found is not None
    assert found.better_disagreement < 0.1 * found.disagreement
    assert_told(
        found.fault or "",
        r"a response of gamma 1\.\d straightened\); write 'shift_sign: 1' in 'fringes\[2\]'",
    )


def assert_told(said: str, told: str) -> None:
    import re

    assert re.search(told, said), said


@pytest.mark.whole
@pytest.mark.parametrize(
    ("axis", "sign", "told"), [("x", -1, "see whether the images"), ("y", 1, "'axis: x'")]
)
def test_what_one_axis_cannot_prove_is_said_to_be_unusual(axis: Axis, sign: int, told: str) -> None:
    recording = each(lambda s: s.model_copy(update={"axis": axis, "shift_sign": sign}))(
        Bench(plan=PLAN, seed=61).recording()
    )
    found = check_plan_fit(recording)
    assert found is not None
    assert found.fault is None
    assert found.note is not None
    assert told in found.note


def right_plan(seed: int) -> Bench:
    """A bench of any health, with a plan that is right."""
    random = np.random.default_rng([91, seed])
    axes = str(random.choice(["x", "xy"]))
    coarse, fine = int(random.integers(5, 9)), int(random.integers(30, 90))
    steps = tuple(int(n) for n in random.choice([3, 4, 5, 8], 3))
    if random.random() < 0.3:
        stripes, method = (fine - 7, fine, fine + 8), "heterodyne"
    else:
        stripes, method = (1, coarse, fine), "hierarchical"
    if method == "heterodyne" and np.gcd.reduce(np.diff(stripes)) != 1:
        method, stripes = "hierarchical", (1, coarse, fine)
    plan = plan_of(axes, steps, stripes).model_copy(update={"unwrapping": method})
    return Bench(
        plan=plan,
        seed=seed,
        gamma=float(random.uniform(0.7, 1.5)),
        ambient=float(random.uniform(0.0, 0.3)),
        flicker=float(random.uniform(0.0, 0.01)),
        camera_blur_px=float(random.uniform(0.4, 1.5)),
        white=float(random.uniform(0.3, 0.9)),
        moves_px=float(random.choice([0.0, 0.2])),
    )


def assert_left_alone(bench: Bench) -> None:
    found = check_plan_fit(bench.recording())
    assert found is not None
    assert found.fault is None
    assert found.note is None


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("seed", range(4))
def test_a_right_plan_is_left_alone(seed: int) -> None:
    assert_left_alone(right_plan(seed))


@pytest.mark.parametrize(("gamma", "seed"), [(1.6, 301), (2.2, 301)])
def test_sets_whose_orders_are_doubtful_accuse_no_plan(gamma: float, seed: int) -> None:
    assert_left_alone(Bench(plan=plan_of("x", (3, 3), (1, 64)), seed=seed, gamma=gamma, ambient=0.05))


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(100, 160))
def test_many_right_plans_are_left_alone(seed: int) -> None:
    assert_left_alone(right_plan(seed))


def test_too_few_pixels_with_fringes_say_nothing() -> None:
    recording = Bench(plan=BOTH, seed=3).recording()
    assert check_plan_fit(replace(recording, frames=[np.full_like(f, 9) for f in recording.frames])) is None


@pytest.mark.parametrize("seed", [300, 302])
def test_fringes_that_blur_has_turned_into_noise_say_nothing(seed: int) -> None:
    assert check_plan_fit(Bench(plan=BOTH, seed=seed, projector_blur_px=15.0).recording()) is None


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("name", ["calseq1", "calseq2", "calseq3", "calseq4", "calseq5", "skull_2x3"])
def test_plans_of_real_captures_are_left_alone_and_their_mistakes_named(captures: Path, name: str) -> None:
    plan = Plan.load("plan_slstudio_skull" if "skull" in name else "plan_slstudio_board")
    frames = [
        cv2.imread(str(captures / name / f"{i:02d}.png"), cv2.IMREAD_GRAYSCALE) for i in range(plan.images)
    ]
    right = Recording(frames, plan, (1824, 1140))
    found = check_plan_fit(right)
    assert found is not None
    assert found.fault is None
    assert found.note is None
    bent = [np.rint(255.0 * (frame / 255.0) ** 2.2).astype(np.uint8) for frame in frames]
    found = check_plan_fit(replace(right, frames=bent))
    assert found is not None
    assert found.fault is None
    wrong = check_plan_fit(one(0, stripes=20.0)(right))
    assert wrong is not None
    assert wrong.fault is not None
    assert "write 'stripes: 16' in 'fringes[0]'" in wrong.fault


def test_sets_of_the_bench_are_sinusoids() -> None:
    """The mistakes above are edits of their fields."""
    assert all(isinstance(s, Sinusoid) for s in PLAN.fringes)
    assert PROJECTOR == (912, 1140)
