"""Mistakes and faults of images from elsewhere: is the right explanation named first, and is advice safe.

    python -m benchmarks explanations            # ten seeds of each, some fifteen minutes on two cores
    python -m benchmarks.explanations 3 9000     # three seeds of each, from another first seed

Frames come from formulas (a part, a pinhole camera and projector, noise, blur and a bent response), with one
mistake in the plan, the images or the light. What is printed is followed as a person would who knows nothing
else, and the points are compared with the true ones.
"""

import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from multiprocessing import get_context
from typing import Any, cast
from unittest.mock import patch

import numpy as np

from benchmarks import Result, above, below
from benchmarks.diagnosis import ONE_THREAD
from fpplab.calibration.model import Calibration
from fpplab.cli import console
from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats, Image
from fpplab.core.errors import FppError
from fpplab.core.progress import no_progress
from fpplab.diagnosis import Diagnosis, Verdict, diagnose_scan
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.pipeline.decoding import fault_in_step, plan_fault
from fpplab.pipeline.measuring import triangulate_recording
from tests.diagnosis.scenes import Bench, plan_of

SEED, COUNT = 7400, 10
"""The first seed of those that nothing was developed with, and how many of each explanation."""
HEALTHY = 10
"""Right plans, and healthy scans, for each seed."""
MAX_ERROR_MM = 1.0
"""Median error along the camera's axis of points that are wrong. Chosen: noise is a tenth of it."""
MAX_REMEDIES = 3
STEPS = (3, 4, 5, 6, 8, 12)
OTHER_PLANS = ((1, 30), (1, 64), (1, 124), (1, 11, 124), (56, 63, 64), (59, 64, 70), (31, 32))
"""Stripes of right plans besides those that mistakes are made in: wide ratios and beats."""
OTHER_PLANS_SHARE = 0.5

Random = np.random.Generator
SetChange = Callable[[list[Sinusoid], Random], object]
ImageChange = Callable[[list[Image], Plan, Random], list[Image]]
DrawCase = Callable[[Random, int], "Drawn"]


@dataclass(frozen=True, eq=False)
class Drawn:
    """A recording with one thing wrong."""

    bench: Bench
    recording: Recording
    calibration: Calibration


@dataclass(frozen=True)
class Mistake:
    """One thing that is wrong, and how the first answer names it."""

    draw: DrawCase
    right: str  # a pattern of the first answer


@dataclass(frozen=True)
class Answer:
    """What is said first of a recording, and the points where there are any."""

    text: str
    verdict: str  # empty where it is refused before there are points
    cloud: Cloud | None

    @property
    def is_good(self) -> bool:
        """Whether the points are called good without reserve."""
        return self.verdict == Verdict.GOOD and "not checked" not in self.text


@dataclass(frozen=True)
class Outcome:
    """How one recording ended."""

    name: str
    seed: int
    text: str  # what was said first
    is_right: bool  # whether the right explanation was in it
    believed: str  # what led to wrong points that are called good; empty where nothing did


# --- what is wrong


def drawn_bench(random: Random, seed: int, axes: str = "", steps: Sequence[int] = (), **more: Any) -> Bench:
    """Draw a bench and its plan."""
    axes = axes or str(random.choice(["x", "xy"]))
    coarse, fine = (int(random.integers(5, 9)), int(random.integers(30, 64)))
    steps = tuple(steps) or tuple(int(n) for n in random.choice(STEPS, 3))
    bench = Bench(
        plan=plan_of(axes, tuple(steps), (1, coarse, fine)),
        seed=seed,
        gamma=float(random.uniform(1.0, 2.2)),
        ambient=float(random.uniform(0.0, 0.1)),
        white=float(random.uniform(0.5, 0.9)),
        camera_blur_px=float(random.uniform(0.5, 1.2)),
        bulge_mm=float(random.uniform(3.0, 10.0)),
    )
    return replace(bench, **more)


def drawn(bench: Bench, stated: Plan | None = None, frames: Iterable[Image] | None = None) -> Drawn:
    """Record it, as images of another program."""
    recording = replace(bench.recording(), is_imported=True)
    if stated is not None:
        recording = replace(recording, plan=stated)
    if frames is not None:
        recording = replace(recording, frames=list(frames))
    return Drawn(bench, recording, bench.rig())


def with_sets(change: SetChange, axes: str = "", steps: Sequence[int] = ()) -> DrawCase:
    """Misstate sets of the plan; `change` edits the list in place or gives another."""

    def draw(random: Random, seed: int) -> Drawn:
        bench = drawn_bench(random, seed, axes, steps)
        sets = sinusoids_of(bench.plan)
        edited = change(sets, random)
        stated = tuple(edited if isinstance(edited, list) else sets)
        return drawn(bench, bench.plan.model_copy(update={"fringes": stated}))

    return draw


def with_frames(change: ImageChange, axes: str = "", steps: Sequence[int] = (), **more: Any) -> DrawCase:
    """Change the images."""

    def draw(random: Random, seed: int) -> Drawn:
        bench = drawn_bench(random, seed, axes, steps, **more)
        right = drawn(bench)
        frames = [unturned(f) for f in change(list(right.recording.frames), bench.plan, random)]
        return replace(right, recording=replace(right.recording, frames=frames))

    return draw


def with_bench(axes: str = "", steps: Sequence[int] = (), **ranges: tuple[float, float]) -> DrawCase:
    """Give the bench a fault of a strength that is drawn."""

    def draw(random: Random, seed: int) -> Drawn:
        bench = drawn_bench(random, seed, axes, steps)
        values: dict[str, Any] = {name: float(random.uniform(*span)) for name, span in ranges.items()}
        return drawn(replace(bench, **values))

    return draw


def unturned(view: Image) -> Image:
    """Copy a view so that its rows follow one another."""
    return cast(Image, np.ascontiguousarray(view))


def by_set(order: Callable[[list[Image]], list[Image]]) -> ImageChange:
    """Give each set's images in another order."""

    def change(frames: list[Image], plan: Plan, _: Random) -> list[Image]:
        starts = plan.set_starts
        return [f for a, b in pairwise(starts) for f in order(frames[a:b])]

    return change


def sinusoids_of(plan: Plan) -> list[Sinusoid]:
    """Give the sets of a plan, all of which are sinusoids."""
    return [s for s in plan.fringes if isinstance(s, Sinusoid)]


def put(sets: list[Sinusoid], k: int, **fields: object) -> None:
    """Edit a set."""
    sets[k] = sets[k].model_copy(update=fields)


def _other_stripes(sets: list[Sinusoid], random: Random) -> None:
    k = int(random.integers(1, 3))
    stripes = sets[k].stripes
    off = max(1, round(stripes * random.uniform(0.05, 0.2)))
    put(sets, k, stripes=stripes + off * int(random.choice([-1, 1])))


def _other_origin(sets: list[Sinusoid], random: Random) -> None:
    put(
        sets,
        int(random.integers(1, 3)),
        phase_origin_rad=float(random.uniform(1.0, 2.5) * random.choice([-1, 1])),
    )


def _other_sign(sets: list[Sinusoid], random: Random) -> None:
    put(sets, int(random.integers(0, 3)), shift_sign=-1)


def _other_signs(*axes: str) -> Callable[[list[Sinusoid], Random], list[Sinusoid]]:
    return lambda sets, _: [s.model_copy(update={"shift_sign": -1}) if s.axis in axes else s for s in sets]


def _other_axis(sets: list[Sinusoid], random: Random) -> None:
    k = int(random.integers(0, 6))
    put(sets, k, axis="y" if sets[k].axis == "x" else "x")


def _two_sets(random: Random, seed: int) -> Drawn:
    steps = tuple(int(n) for n in random.choice(STEPS, 4))
    bench = replace(drawn_bench(random, seed, "x"), plan=plan_of("x", steps, (1, 4, 16, 64)))
    return drawn(bench, plan_of("x", steps, (1, 8, 32, 64)))


def _moved(frames: list[Image], _: Plan, random: Random) -> list[Image]:
    by, axis = int(random.integers(4, 17)) * int(random.choice([-1, 1])), int(random.integers(2))
    return [cast(Image, np.roll(f, by, axis=axis)) for f in frames]


def _gains(frames: list[Image], _: Plan, random: Random) -> list[Image]:
    gains = 0.75 * (1.0 + random.uniform(0.05, 0.15) * random.uniform(-1.7, 1.7, len(frames)))
    return [np.rint(f * g).astype(np.uint8) for f, g in zip(frames, gains, strict=True)]


def _swapped(frames: list[Image], _: Plan, random: Random) -> list[Image]:
    a, b = random.choice(len(frames), 2, replace=False)
    frames[a], frames[b] = frames[b], frames[a]
    return frames


def _missed(frames: list[Image], _: Plan, random: Random) -> list[Image]:
    k = int(random.integers(2, len(frames) - 2))
    return [*frames[:k], *frames[k + 1 :], np.full_like(frames[0], 3)]


def _foreign(frames: list[Image], _: Plan, random: Random) -> list[Image]:
    frames[int(random.integers(len(frames)))] = np.full_like(frames[0], 4)
    return frames


MANY = (8, 8, 12)
LIGHT = r"|^\w+: response|^\w+: harmonics"
"""A bent response is a fault as well, and may stand first."""
MOTION = f"vibration|moved|scene or its light changed{LIGHT}"
UNPLACED = "not checked: that the images"
MISTAKES: dict[str, Mistake] = {
    "steps reversed": Mistake(with_frames(by_set(lambda f: f[::-1])), "in reverse order"),
    "steps late": Mistake(with_frames(by_set(lambda f: [f[-1], *f[:-1]])), "one step late"),
    "steps early": Mistake(with_frames(by_set(lambda f: [*f[1:], f[0]])), "one step early"),
    "sets in another order": Mistake(
        with_sets(lambda sets, _: sets[::-1], "x", (4, 4, 4)), "in another order"
    ),
    "stripes of one set": Mistake(with_sets(_other_stripes), r"shows \d+ stripes"),
    "stripes of two sets": Mistake(_two_sets, "shows 4 stripes.*shows 16 stripes"),
    "origin of one set": Mistake(with_sets(_other_origin), "does not begin where"),
    "sign of one set": Mistake(with_sets(_other_sign), "runs against that of"),
    "sign along x": Mistake(with_sets(_other_signs("x")), "steps of every set along x run the other way"),
    "sign along both": Mistake(
        with_sets(_other_signs("x", "y"), "xy"),
        "steps of every set along x and every set along y run the other way",
    ),
    "axis of one set": Mistake(with_sets(_other_axis, "xy"), "run along the other axis"),
    "axes exchanged": Mistake(
        with_sets(
            lambda sets, _: [s.model_copy(update={"axis": "yx"["xy".index(s.axis)]}) for s in sets], "xy"
        ),
        "axes of the sets are exchanged|along the other axis",
    ),
    "images turned": Mistake(
        with_frames(lambda frames, *_: [f[::-1, ::-1] for f in frames]), "turned by 180"
    ),
    "images mirrored": Mistake(
        with_frames(lambda frames, *_: [f[:, ::-1] for f in frames]), "images are mirrored, left to right"
    ),
    "images upside down": Mistake(
        with_frames(lambda frames, *_: [f[::-1] for f in frames]), f"upside down, mirrored|{UNPLACED}{LIGHT}"
    ),
    "region moved": Mistake(with_frames(_moved), f"region|{UNPLACED}{LIGHT}"),
    "bent response": Mistake(
        with_bench(steps=(3, 3, 3), gamma=(1.5, 2.2)), "^\\w+: response|^\\w+: harmonics"
    ),
    "flicker": Mistake(with_bench(flicker=(0.03, 0.1)), f"flicker|brightness{LIGHT}"),
    "gain of each frame": Mistake(with_frames(_gains, steps=(4, 6, 8)), f"brightness|flicker{LIGHT}"),
    "two images exchanged": Mistake(with_frames(_swapped, steps=MANY), "show each other's pattern"),
    "an image missed": Mistake(with_frames(_missed, steps=MANY), "was missed|one too (late|early)"),
    "a black image": Mistake(with_frames(_foreign, steps=MANY), "none of the plan's patterns|is black"),
    "projector moved": Mistake(with_bench("xy", turned_deg=(0.3, 0.8)), f"stale_calibration{LIGHT}"),
    "part moves": Mistake(with_bench(steps=MANY, moves_px=(0.4, 1.0)), MOTION),
}


# --- what is said, and what comes of it


def answer(recording: Recording, calibration: Calibration) -> Answer:
    """Give what `fpplab reconstruct` says first."""
    if fault := fault_in_step(recording):
        return Answer(f"out_of_step: {fault}", "", None)
    try:
        decoded, points = triangulate_recording(recording, calibration, None, no_progress)
    except FppError as error:
        return Answer(f"refused: {error}", "", None)
    if isinstance(points, Diagnosis):
        return Answer(_said(points), points.verdict, None)
    judged = diagnose_scan(recording, decoded, points, calibration)
    return Answer(_said(judged), judged.verdict, points)


def _said(judged: Diagnosis) -> str:
    if not judged.findings:
        unplaced = [text.removeprefix("region: ") for text in judged.unknown if text.startswith("region: ")]
        return f"{judged.verdict}: {judged.reason}" + "".join(f"; not checked: {text}" for text in unplaced)
    first = judged.findings[0]
    return f"{first.sentence}; {first.remedy}"


def depth_error_mm(bench: Bench, cloud: Cloud) -> float:
    """Compute how far points are off along the camera's axis."""
    depth = true_depth(bench)
    assert cloud.pixels is not None
    u, v = cloud.pixels.T
    return float(np.median(np.abs(cloud.points[:, 2] - depth[v, u])))


def true_depth(bench: Bench) -> Floats:
    """Give the distance of the part in each pixel."""
    return np.asarray(bench._part(np.random.default_rng([17, bench.seed]))[0])  # noqa: SLF001


def judge_explanation(name: str, seed: int) -> Outcome:
    """Ask about one recording, and follow the advice."""
    mistake = MISTAKES[name]
    case = mistake.draw(np.random.default_rng([seed, list(MISTAKES).index(name)]), seed)
    said = answer(case.recording, case.calibration)
    is_right = re.search(mistake.right, said.text, re.DOTALL) is not None
    believed = _believed(said, case.bench, "at once")
    fault = plan_fault(case.recording) or ""
    for advice in (said.text, "" if fault in said.text else fault):
        followed, text = case.recording, advice
        for _ in range(MAX_REMEDIES):
            changed = follow_advice(followed, text)
            if changed is None or believed:
                break
            then = answer(changed, case.calibration)
            believed = _believed(then, case.bench, text)
            followed, text = changed, then.text
    return Outcome(name, seed, said.text, is_right, believed)


def _believed(said: Answer, bench: Bench, told: str) -> str:
    if said.is_good and said.cloud is not None and depth_error_mm(bench, said.cloud) > MAX_ERROR_MM:
        return f"{told} -> good, {depth_error_mm(bench, said.cloud):.1f} mm off"
    return ""


WRITE = re.compile(r"write '(axis|stripes|shift_sign|phase_origin_rad): ([^']+)' in ([^;]*)")


def follow_advice(recording: Recording, text: str) -> Recording | None:
    """Do what a text says, word for word; None where it says nothing that can be done without looking."""
    sets, frames, is_changed = sinusoids_of(recording.plan), list(recording.frames), False
    for key, value, places in WRITE.findall(text):
        of_axes = re.findall(r"every set along ([xy])", places)
        chosen = [int(k) for k in re.findall(r"fringes\[(\d+)\]", places)]
        chosen += [k for k, s in enumerate(sets) if s.axis in of_axes]
        for k in chosen:
            put(sets, k, **{key: value if key == "axis" else float(value)})
            is_changed = True
    if match := re.search(r"in the order of the images they have ([\d., ]+) stripes", text):
        for k, stripes in enumerate(match.group(1).split(",")):
            put(sets, k, stripes=float(stripes))
        is_changed = True
    orders: tuple[tuple[str, Callable[[list[Image]], list[Image]]], ...] = (
        ("; reverse the images of each set", lambda f: f[::-1]),
        ("; begin each set one image later", lambda f: [*f[1:], f[0]]),
        ("; begin each set one image earlier", lambda f: [f[-1], *f[:-1]]),
    )
    for words, order in orders:
        if words in text and not is_changed:
            frames, is_changed = by_set(order)(frames, recording.plan, np.random.default_rng(0)), True
    turns: tuple[tuple[str, Callable[[Image], Image]], ...] = (
        ("; turn the images by 180°", lambda f: f[::-1, ::-1]),
        ("; mirror the images left to right", lambda f: f[:, ::-1]),
        ("; mirror the images top to bottom", lambda f: f[::-1]),
    )
    for words, turn in turns:
        if words in text:
            frames, is_changed = [unturned(turn(f)) for f in frames], True
    if match := re.search(r"; change the sign of 'shift_sign' in ([^;]*)", text):
        for k, s in enumerate(sets):
            if f"every set along {s.axis}" in match.group(1):
                put(sets, k, shift_sign=-s.shift_sign)
        is_changed = True
    if "; write the other axis in every set" in text:
        sets = [s.model_copy(update={"axis": "y" if s.axis == "x" else "x"}) for s in sets]
        is_changed = True
    if not is_changed:
        return None
    plan = recording.plan.model_copy(update={"fringes": tuple(sets)})
    return replace(recording, plan=plan, frames=frames)


# --- right plans, healthy scans


def of_right_plan(seed: int) -> str:
    """What is said against a right plan under any response; empty where nothing is."""
    random = np.random.default_rng([seed, 91])
    bench = drawn_bench(random, seed)
    if random.random() < OTHER_PLANS_SHARE:
        stripes = OTHER_PLANS[int(random.integers(len(OTHER_PLANS)))]
        steps = tuple(int(n) for n in random.choice(STEPS, len(stripes)))
        method = "heterodyne" if stripes[0] > 1 else "hierarchical"
        plan = plan_of("".join(bench.plan.axes), steps, stripes).model_copy(update={"unwrapping": method})
        bench = replace(bench, plan=plan, full_well_e=float(random.choice([400.0, 2000.0, 12000.0])))
    case = drawn(bench)
    said = answer(case.recording, case.calibration)
    wrong = plan_fault(case.recording) or ""
    is_blamed = re.match(r"wrong_plan|wrong_orientation|out_of_step|refused", said.text)
    return wrong or (said.text if is_blamed else "")


def of_healthy_scan(seed: int) -> str:
    """What is said against a healthy scan; empty where nothing is."""
    random = np.random.default_rng([seed, 92])
    case = drawn(drawn_bench(random, seed, gamma=float(random.uniform(0.97, 1.03))))
    said = answer(case.recording, case.calibration)
    return "" if said.verdict == Verdict.GOOD else said.text


def run() -> list[Result]:
    """Judge every explanation with seeds that nothing was developed with."""
    return measure_explanations(COUNT, SEED)


def measure_explanations(count: int, first: int, names: Sequence[str] = tuple(MISTAKES)) -> list[Result]:
    """Judge a number of recordings of each explanation, and ten times as many without a mistake."""
    work = [(name, seed) for seed in range(first, first + count) for name in names]
    healthy = range(first, first + HEALTHY * count)
    with (
        patch.dict(os.environ, ONE_THREAD),
        ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool,
    ):
        # All are under way together, and each is told as it comes.
        ahead = pool.map(judge_explanation, *zip(*work, strict=True))
        plans_ahead, scans_ahead = (pool.map(of, healthy) for of in (of_right_plan, of_healthy_scan))
        outcomes = [tell_outcome(one) for one in ahead]
        plans = [_blamed("right plan", *each) for each in zip(healthy, plans_ahead, strict=True)]
        scans = [_blamed("healthy scan", *each) for each in zip(healthy, scans_ahead, strict=True)]
    for name in names:
        rights = [one.is_right for one in outcomes if one.name == name]
        console.log_status(f"{name}: {sum(rights)} of {len(rights)} right first")
    right = 100.0 * float(np.mean([one.is_right for one in outcomes]))
    believed = float(sum(bool(one.believed) for one in outcomes))
    return [
        above("explanations_right_first", right, "%", 95.0),
        below("explanations_believed_and_wrong", believed, "clouds", 1e-9),
        below("right_plans_blamed", float(sum(plans)), f"of {len(plans)} plans", 1e-9),
        below("healthy_scans_blamed", float(sum(scans)), f"of {len(scans)} scans", 1e-9),
    ]


def tell_outcome(outcome: Outcome) -> Outcome:
    """Print what is wrong about an outcome."""
    place = f"{outcome.name}, seed {outcome.seed}"
    if not outcome.is_right:
        console.log_status(f"{place}: {outcome.text[:240]}")
    if outcome.believed:
        console.log_status(f"{place}: BELIEVED: {outcome.believed[:300]}")
    return outcome


def _blamed(what: str, seed: int, text: str) -> bool:
    if text:
        console.log_status(f"{what}, seed {seed}: {text[:240]}")
    return bool(text)


if __name__ == "__main__":
    for one in measure_explanations(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:] or tuple(MISTAKES)):
        console.log_status(f"{one.name}: {one.value:g} {one.unit}")
