"""Frames prove that each shows its own pattern: every fault is named, and frames in step are accepted."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from fpplab.acquisition.acquire import _ends_black_and_white
from fpplab.acquisition.synchronisation import (
    LIMITS,
    LINEAR,
    Cause,
    Moments,
    SyncFault,
    SyncVerdict,
    _signal_spaces,
    check_synchronisation,
    considered_faults,
    provable,
    synchronisation_remedy,
)
from fpplab.core.conventions import Floats, Image, axis_length, full_scale, phase_of_coordinate, phase_steps
from fpplab.core.errors import CalibrationError, DataError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.pipeline.characterising import observe_session
from fpplab.pipeline.decoding import decode_session
from tests.diagnosis.scenes import Bench, plan_of
from tests.support.rigs import BOARD

SIZE = (912, 1140)
TRIGGERS = (Cause.LATE, Cause.EARLY, Cause.MISSED, Cause.DOUBLED)


def judged(frames: Sequence[Image], plan: Plan, bits: int = 8) -> SyncVerdict:
    """What the frames say of their synchronisation."""
    return check_synchronisation(Recording(frames, plan, SIZE, bits))


@dataclass(frozen=True)
class Scene:
    """A tilted board under fringes of amplitude 0.45 and offset 0.5 of the projector's light.

    noise: of the brightest fringes' amplitude. ambient: room light beside the projector's, of which each
    frame sees `flicker` more or less; lamp: the same of the projector's light. bounced: share of light that
    comes once more from the board as a whole. exposure: 1 where the brightest is just not saturated.
    """

    noise: float = 0.01
    gamma: float = 1.0
    ambient: float = 0.05
    flicker: float = 0.0
    lamp: float = 0.0
    bounced: float = 0.0
    exposure: float = 1.0
    albedo: tuple[float, float] = (0.6, 1.0)
    bits: int = 8

    def frames(self, plan: Plan, seed: int = 0) -> list[Image]:
        """What a camera of 96 x 72 pixels sees of the plan."""
        random = np.random.default_rng(seed)
        v, u = np.mgrid[0:72, 0:96].astype(np.float64)
        light = {"x": SIZE[0] * (0.1 + 0.7 * u / 96 + 0.1 * v / 72), "y": SIZE[1] * (0.2 + 0.6 * v / 72)}
        dark, bright = self.albedo
        albedo = np.where((u // 12 + v // 12) % 2, bright, dark)
        return [
            self._frame(light, albedo, f, shift, random)
            for f in plan.fringes
            for shift in phase_steps(f.steps)
        ]

    def _frame(
        self,
        light: dict[str, Floats],
        albedo: Floats,
        fringe: Sinusoid,
        shift: float,
        random: np.random.Generator,
    ) -> Image:
        phase = phase_of_coordinate(light[fringe.axis], fringe.stripes, axis_length(SIZE, fringe.axis))
        shown = (
            0.5 + 0.45 * np.cos(phase + fringe.phase_origin_rad - fringe.shift_sign * shift)
        ) ** self.gamma
        shown = shown * (1 + self.lamp * random.normal()) + self.ambient * (
            1 + self.flicker * random.normal()
        )
        shown = shown + self.bounced * cv2.blur(albedo * shown, (31, 31))
        level = albedo * shown * self.exposure / (0.96 * (1 + self.bounced) + self.ambient)
        level = level + random.normal(0.0, self.noise * 0.45 * self.exposure, level.shape)
        raw = np.rint(np.clip(level, 0.0, 1.0) * full_scale(self.bits))
        return raw.astype(np.uint8 if self.bits == 8 else np.uint16)


def spoilt(frames: list[Image], fault: SyncFault) -> list[Image]:
    """Frames taken with a fault; a frame without a pattern is as dark as the darkest that is seen."""
    nothing = np.min(frames, axis=0)
    return [nothing if k is None else frames[k] for k in fault.shown(len(frames))]


def sets(*fringes: tuple[str, float, int]) -> Plan:
    return Plan(fringes=tuple(Sinusoid(axis=a, stripes=s, steps=n) for a, s, n in fringes))  # type: ignore[arg-type]


@st.composite
def plans(draw: st.DrawFn, least_steps: int = 3, least_sets: int = 1) -> Plan:
    one = st.builds(
        Sinusoid,
        axis=st.sampled_from("xy"),
        stripes=st.sampled_from((1.0, 1.7, 4.0, 6.5, 8.0)),
        steps=st.integers(least_steps, 13),
        shift_sign=st.sampled_from((1, -1)),
        phase_origin_rad=st.sampled_from((0.0, -0.03, 2.0)),
    )
    return Plan(
        fringes=tuple(
            draw(st.lists(one, min_size=least_sets, max_size=4, unique_by=lambda f: (f.axis, f.stripes)))
        )
    )


SCENES = st.builds(
    Scene,
    noise=st.floats(0.0, 0.4),
    gamma=st.sampled_from((0.5, 0.8, 1.0, 1.4, 1.8, 2.2)),
    ambient=st.floats(0.0, 0.5),
    flicker=st.floats(0.0, 0.1),
    lamp=st.floats(0.0, 0.03),
    bounced=st.floats(0.0, 0.5),
    exposure=st.sampled_from((0.1, 0.5, 1.0, 1.5)),
    bits=st.sampled_from((8, 12)),
)


@settings(max_examples=25, deadline=None)
@given(plans(), SCENES, st.integers(0, 99))
def test_frames_in_step_are_accepted(plan: Plan, scene: Scene, seed: int) -> None:
    verdict = judged(scene.frames(plan, seed), plan, scene.bits)
    assert verdict.in_step, (verdict.describe(), verdict.misfit)


@settings(max_examples=25, deadline=None)
@given(st.data(), plans(least_steps=6, least_sets=2), st.floats(0.0, 0.03))
def test_every_fault_is_named(data: st.DataObject, plan: Plan, noise: float) -> None:
    fault = data.draw(st.sampled_from(list(considered_faults(plan.images))))
    verdict = judged(spoilt(Scene(noise=noise).frames(plan), fault), plan)
    assert fault in verdict.causes, verdict


@settings(max_examples=25, deadline=None)
@given(st.data(), plans(), st.floats(0.0, 0.03), st.sampled_from((0.5, 1.0, 2.2)))
def test_a_trigger_out_of_step_is_noticed_wherever_the_plan_can_tell(
    data: st.DataObject, plan: Plan, noise: float, gamma: float
) -> None:
    """For any response; where the frames cannot reveal the fault, the verdict says so."""
    fault = data.draw(st.sampled_from([f for f in considered_faults(plan.images) if f.cause in TRIGGERS]))
    verdict = judged(spoilt(Scene(noise=noise, gamma=gamma).frames(plan), fault), plan)
    assert not verdict.in_step or not provable(plan), (fault, verdict)
    assert verdict.provable or not provable(plan)


@pytest.mark.parametrize("name", ["plan_board", "plan_paper", "plan_slstudio_board"])
@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_every_trigger_fault_of_a_plan_that_comes_with_fpplab_is_named(name: str, noise: float) -> None:
    plan = Plan.load(name)
    plan = plan.model_copy(update={"fringes": tuple(coarser(f) for f in plan.fringes)})
    frames = Scene(noise=noise).frames(plan)
    for fault in considered_faults(plan.images):
        if fault.cause in TRIGGERS:
            verdict = judged(spoilt(frames, fault), plan)
            assert fault in verdict.causes or not verdict.fits, fault
            assert fault.describe() in verdict.describe() or not verdict.fits


def coarser(fringe: Sinusoid) -> Sinusoid:
    """A plan whose stripes a camera of so few pixels resolves."""
    return fringe.model_copy(update={"stripes": min(fringe.stripes, 12.0), "projector_size": None})


def test_faults_are_told_apart_by_what_they_show() -> None:
    assert SyncFault(Cause.LATE).shown(4) == [None, 0, 1, 2]
    assert SyncFault(Cause.EARLY).shown(4) == [1, 2, 3, None]
    assert SyncFault(Cause.MISSED, 1).shown(4) == [0, 2, 3, None]
    assert SyncFault(Cause.DOUBLED, 2).shown(4) == [0, 1, 1, 2]
    assert SyncFault(Cause.FOREIGN, 3).shown(4) == [0, 1, 2, None]
    assert SyncFault(Cause.SWAPPED, 1).shown(4) == [0, 2, 1, 3]
    rows = [tuple(fault.shown(7)) for fault in considered_faults(7)]
    assert len(set(rows)) == len(rows)


@pytest.mark.parametrize(
    ("plan", "proves"),
    [
        (sets(("x", 1, 3)), False),
        (sets(("x", 1, 4)), False),
        (sets(("x", 1, 5)), False),
        (sets(("x", 1, 6)), True),
        (sets(("x", 1, 3), ("x", 8, 3)), True),
        (sets(("x", 1, 4), ("y", 6.5, 3)), True),
    ],
)
def test_a_plan_says_whether_its_frames_prove_anything(plan: Plan, proves: bool) -> None:
    assert provable(plan) is proves
    assert judged(Scene().frames(plan), plan).provable is proves


def test_hypotheses_are_rated_by_their_marginal_likelihood() -> None:
    """That of Gaussian coefficients and misfit, with one offset for all sets and with one for each."""
    plan, steps = sets(("x", 4.0, 5), ("y", 6.5, 7)), (5, 7)
    fringes = [np.exp(2j * np.pi * np.arange(n) / n) for n in steps]
    waves = block_diag(*(np.stack([wave.real, wave.imag], axis=1) for wave in fringes))
    own = block_diag(*(np.ones((n, 1)) for n in steps))
    seen = waves @ [0.8, -0.3, 0.5, 0.9]
    moments = Moments(np.outer(seen, seen), np.outer(seen, seen))

    def expected(offsets: Floats) -> float:
        basis = np.hstack([offsets, waves])
        covariance = LIMITS.prior_variance * basis @ basis.T + LIMITS.misfit_in_step**2 * np.eye(len(seen))
        return float(multivariate_normal(cov=covariance).logpdf(seen))

    rated = [
        _signal_spaces(plan, LINEAR, (), separate).log_likelihoods(moments)[0] for separate in (False, True)
    ]
    assert rated[1] - rated[0] == pytest.approx(expected(own) - expected(own.sum(axis=1)[:, None]), abs=0.01)


def test_the_brightness_of_a_frame_is_nobodys_fault() -> None:
    """A lamp that is a fifth brighter in one frame, as a shutter or the mains may cause."""
    plan = sets(("x", 1, 6), ("x", 8, 6))
    frames = Scene(exposure=0.7).frames(plan)
    frames[4] = np.rint(frames[4] * 1.2).astype(np.uint8)
    assert judged(frames, plan).in_step


def test_frames_of_another_plan_do_not_fit() -> None:
    verdict = judged(Scene().frames(sets(("x", 1, 8), ("y", 6.5, 4))), sets(("x", 1, 6), ("x", 8, 6)))
    assert not verdict.in_step


@pytest.mark.parametrize(
    ("brightness", "is_end"),
    [
        ((50, 60, 70, 10, 90), True),
        ((50, 60, 90, 10, 90), False),  # a fringe as bright as the white that should end it
        ((50, 60, 95, 10, 90), False),
        ((50, 10, 70, 10, 90), False),
        ((50, 5, 70, 10, 90), False),
        ((50, 60, 70, 90, 10), False),
    ],
)
def test_the_end_is_the_darkest_frame_and_then_the_brightest(
    brightness: tuple[float, ...], is_end: bool
) -> None:
    assert _ends_black_and_white(brightness) is is_end


def test_a_torn_frame_is_named() -> None:
    plan = sets(("x", 1, 6), ("x", 8, 6))
    frames = Scene(noise=0.03).frames(plan)
    frames[3] = np.concatenate([frames[2][:40], frames[3][40:]])
    assert SyncFault(Cause.FOREIGN, 3) in judged(frames, plan).causes


def test_a_fault_that_leaves_most_of_the_misfit_is_not_named() -> None:
    """A part that moves in front of fine fringes is nobody's exchange of frames."""
    bench = Bench(plan=plan_of("x", (8, 8, 12), (1, 7, 55)), moves_px=0.8, seed=2)
    assert check_synchronisation(bench.recording()).causes == ()


@pytest.mark.parametrize("scene", [Scene(exposure=0.0), Scene(exposure=9.0)], ids=["dark", "saturated"])
def test_where_nothing_is_seen_nothing_is_proven(scene: Scene) -> None:
    plan = sets(("x", 1, 6), ("x", 8, 6))
    verdict = judged(scene.frames(plan), plan)
    assert verdict.in_step
    assert not verdict.provable


@pytest.mark.parametrize("larger", [2, 5])
def test_frames_of_any_size_are_judged(larger: int) -> None:
    plan = sets(("x", 1.0, 4), ("x", 8.0, 6))
    frames = [np.repeat(np.repeat(frame, larger, axis=0), larger, axis=1) for frame in Scene().frames(plan)]
    assert judged(frames, plan).in_step
    assert not judged(spoilt(frames, SyncFault(Cause.MISSED, 3)), plan).in_step


def test_a_few_pixels_that_see_fringes_are_enough() -> None:
    """A small part in front of a dark background."""
    plan = sets(("x", 1, 6), ("x", 8, 6))
    frames = Scene(noise=0.0).frames(plan)
    part = np.zeros(frames[0].shape, bool)
    part[30:48, 40:60] = True
    random = np.random.default_rng(1)
    frames = [np.where(part, f, random.poisson(2.0, f.shape)).astype(np.uint8) for f in frames]
    assert judged(frames, plan).in_step
    assert judged(spoilt(frames, SyncFault(Cause.MISSED, 7)), plan).causes == (SyncFault(Cause.MISSED, 7),)


@pytest.mark.parametrize("trigger", ["stepped", "triggered"])
def test_a_session_out_of_step_is_refused_by_name(trigger: str) -> None:
    plan = sets(("x", 1, 6), ("x", 8, 6)).model_copy(update={"trigger": trigger})
    late = spoilt(Scene().frames(plan), SyncFault(Cause.LATE))
    recording = Recording(late, plan, SIZE, name="pose_04")
    session = SimpleNamespace(path=Path("pose_04"), recording=lambda progress=None: recording)
    with pytest.raises(
        CalibrationError, match=r"pose_04: every frame shows the pattern before its own"
    ) as told:
        observe_session(session, BOARD, (14.25, 17.8))  # type: ignore[arg-type]
    assert synchronisation_remedy(plan) in str(told.value)
    with pytest.raises(DataError, match=r"pose_04: every frame .* --force"):
        decode_session(session)  # type: ignore[arg-type]


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("name", ["skull_2x3", "calseq1", "calseq2", "calseq3", "calseq4", "calseq5"])
def test_real_captures_are_in_step_until_a_trigger_slips(captures: Path, name: str) -> None:
    plan = Plan.load("plan_slstudio_skull" if "skull" in name else "plan_slstudio_board")
    frames = [
        cv2.imread(str(captures / name / f"{i:02d}.png"), cv2.IMREAD_GRAYSCALE) for i in range(plan.images)
    ]
    assert judged(frames, plan).in_step
    assert judged(frames, plan).misfit < 0.03
    # A last set of three coarse stripes seen in part differs from a dark frame by brightness alone.
    told = [f for f in considered_faults(plan.images) if f.cause in (Cause.LATE, Cause.EARLY, Cause.DOUBLED)]
    told += [SyncFault(Cause.MISSED, k) for k in range(1, plan.images - 3)]
    for fault in told:
        assert not judged(spoilt(frames, fault), plan).in_step, fault
