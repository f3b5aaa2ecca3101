"""Images that are no sinusoids with equal steps are named, with their numbers; what decodes is left alone."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fpplab.acquisition.synchronisation import check_synchronisation
from fpplab.core.conventions import Floats, Image
from fpplab.core.errors import DataError
from fpplab.diagnosis.plan import check_plan_fit, guess_plan, name_other_patterns
from fpplab.diagnosis.plan.other_patterns import measured_phase_shifts
from fpplab.patterns.plan import Plan
from fpplab.phase import decode
from tests.diagnosis.scenes import PROJECTOR, Bench, plan_of

SETS = (4, 4, 6)
PLAN = plan_of("x", SETS, (1, 8, 48))


class GrayBench(Bench):
    """Shows the bits of the Gray code of a column, the coarsest first, and the reverse of each if asked."""

    def _exposed(
        self, k: int, step: int, seen: Floats, albedo: Floats, inside: Floats, random: np.random.Generator,
        elapsed: float,
    ) -> Image:  # fmt: skip
        bits = self.plan.fringes[k].images
        number = np.floor((seen[..., 0] + 0.5) / PROJECTOR[0] * 2**bits).astype(np.int64)
        bit = (number ^ (number >> 1)) >> (bits - 1 - step) & 1
        level = self.white * albedo * (inside * (0.01 + 0.99 * bit) + self.ambient)
        blurred = cv2.GaussianBlur(level.astype(np.float32), (0, 0), self.camera_blur_px)
        electrons = random.poisson(self.full_well_e * np.maximum(blurred, 0.0))
        return np.asarray(np.clip(np.rint(255 * electrons / self.full_well_e), 0, 255).astype(np.uint8))


@dataclass(frozen=True)
class UnequalBench(Bench):
    """Shows the last set at other phase shifts."""

    shifts_deg: tuple[float, ...] = field(default=())

    def _exposed(
        self, k: int, step: int, seen: Floats, albedo: Floats, inside: Floats, random: np.random.Generator,
        elapsed: float,
    ) -> Image:  # fmt: skip
        last = k == len(self.plan.fringes) - 1
        count = self.plan.fringes[k].images
        # A fraction of a step is a phase shift like any other.
        shown = self.shifts_deg[step] / 360.0 * count if last else step
        return super()._exposed(k, shown, seen, albedo, inside, random, elapsed)  # type: ignore[arg-type]


def gray(seed: int, bits: int = 5) -> list[Image]:
    return list(GrayBench(plan=plan_of("x", (bits,), (1,)), seed=seed).recording().frames)


def sinusoids(seed: int, plan: Plan = PLAN) -> list[Image]:
    return list(Bench(plan=plan, seed=seed).recording().frames)


def test_gray_code_is_named_wherever_it_stands() -> None:
    codes, waves = gray(31), sinusoids(31)
    orders: dict[str, Sequence[Image]] = {
        "0-4": [*codes, *waves],
        "14-18": [*waves, *codes],
        "4-8": [*waves[:4], *codes, *waves[4:]],
    }
    for numbers, frames in orders.items():
        said = name_other_patterns(frames, 255)
        assert said is not None
        assert f"images {numbers} have black and white stripes, as of Gray code" in said
        assert f"'--skip {numbers}'" in said
        with pytest.raises(DataError, match="as of Gray code"):
            guess_plan(frames, 8, PROJECTOR)


def test_white_and_black_images_are_named() -> None:
    waves = sinusoids(32)
    white, black = np.max(waves, axis=0), np.min(waves, axis=0)
    said = name_other_patterns([white, black, *waves], 255)
    assert said is not None
    assert "image 0 is white; image 1 is black" in said
    assert "'--skip 0-1'" in said
    behind = name_other_patterns([*waves, *gray(32), white], 255)
    assert behind is not None
    assert "image 19 is white; images 14-18 have" in behind
    assert "'--skip 14-19'" in behind


@pytest.mark.parametrize(
    "shifts", [(0, 50, 110, 180, 270, 340), (0, 40, 80, 120, 160, 200), (0, 90, 100, 190, 200, 290)]
)
def test_unequal_phase_steps_are_named(shifts: tuple[float, ...]) -> None:
    frames = UnequalBench(plan=PLAN, seed=33, shifts_deg=shifts).recording().frames
    said = name_other_patterns(frames, 255, SETS)
    assert said is not None
    assert "the images of 'fringes[2]' have unequal phase steps" in said
    found = measured_phase_shifts(
        np.stack([f[100:220:3, 90:380:3].ravel() for f in frames[8:]]).astype(float)
    )
    assert found is not None
    signed = min((found, -found % 360.0), key=lambda one: float(np.abs(one - shifts).max()))
    assert np.abs(signed - shifts).max() < 8.0


def test_motion_may_seem_to_be_unequal_steps_of_the_finest_set_alone() -> None:
    sizes, motion = (8, 8, 12), "or the scene moved"
    flat = Bench(plan=plan_of("x", sizes, (1, 8, 60)), seed=9150, bulge_mm=3.7, camera_blur_px=1.1)
    moving = replace(flat, moves_px=0.95).recording()
    said = name_other_patterns(moving.frames, 255, sizes)
    assert said is not None
    assert "the images of 'fringes[2]' have unequal phase steps" in said
    assert motion in said
    shown = UnequalBench(plan=plan_of("x", (6,), (48,)), seed=33, shifts_deg=(0, 40, 80, 120, 160, 200))
    said = name_other_patterns(shown.recording().frames, 255, (6,))
    assert said is not None
    assert motion not in said


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("seed", range(40, 46))
def test_sinusoids_are_left_alone(seed: int) -> None:
    bench = Bench(plan=PLAN, seed=seed, gamma=1.0 + 0.1 * (seed - 40), ambient=0.05 * (seed - 40))
    assert name_other_patterns(bench.recording().frames, 255, SETS) is None


def test_swapped_images_are_left_to_the_check_of_their_order() -> None:
    recording = Bench(plan=PLAN, seed=47).recording()
    frames = list(recording.frames)
    frames[9], frames[10] = frames[10], frames[9]
    assert name_other_patterns(frames, 255, SETS) is None
    said = check_synchronisation(replace(recording, frames=frames)).describe()
    assert said == "frames 9 and 10 show each other's pattern"


@pytest.mark.parametrize("seed", [51, 52])
@pytest.mark.parametrize(("gains", "lights"), [((1.0, 0.45, 0.7), (0, 0, 0)), ((0.6, 0.6, 0.6), (0, 40, 15))])
def test_an_exposure_or_room_light_of_each_set_is_no_mistake(
    seed: int, gains: tuple[float, ...], lights: tuple[float, ...]
) -> None:
    """The phase of each set is its own: nothing is refused, and the coordinates are those of equal sets."""
    right = Bench(plan=PLAN, seed=seed).recording()
    frames = [
        np.clip(np.rint(frame * gains[k] + lights[k]), 0, 255).astype(np.uint8)
        for k in range(len(SETS))
        for frame in right.of_set(k)
    ]
    changed = replace(right, frames=frames)
    assert check_synchronisation(changed).in_step
    found = check_plan_fit(changed)
    assert found is not None
    assert found.fault is None
    assert found.note is None
    assert name_other_patterns(frames, 255, SETS) is None
    first, then = decode(right), decode(changed)
    both = first.valid & then.valid
    assert both.sum() > 0.9 * first.valid.sum()
    assert np.median(np.abs(first.u - then.u)[both]) < 0.1


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("name", ["skull_2x3", "calseq1", "calseq2", "calseq3", "calseq4", "calseq5"])
def test_real_captures_are_left_alone(captures: Path, name: str) -> None:
    plan = Plan.load("plan_slstudio_skull" if "skull" in name else "plan_slstudio_board")
    paths = [captures / name / f"{i:02d}.png" for i in range(plan.images)]
    frames = [np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) for path in paths]
    assert name_other_patterns(frames, 255, [s.images for s in plan.fringes]) is None
