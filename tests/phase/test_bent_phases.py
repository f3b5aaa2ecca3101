"""A bent response at three steps: what the frames say of their phase error, and which pixels are kept."""

import numpy as np
import pytest

from fpplab.diagnosis.verdict import diagnose_frames
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode

WIDTH, SIZE = 912, (160, 240)


def bent(
    sets: list[tuple[float, int]],
    gamma: float,
    seed: int,
    unwrapping: str = "hierarchical",
    bias_rad: np.ndarray | float = 0.0,
) -> tuple[Recording, np.ndarray]:
    """A projector's picture, its power law, a surface, noise and rounding; and the true coordinate.

    The bias is that of the first set's phase.
    """
    random = np.random.default_rng(seed)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] / SIZE[1]
    truth = 60 + 780 * x + 40 * np.sin(5 * x + 7 * y + seed)
    shade = 0.8 + 0.15 * np.cos(9 * x - 4 * y)
    frames = []
    for stripes, steps in sets:
        for n in range(steps):
            angle = 2 * np.pi * (stripes * (truth + 0.5) / WIDTH - n / steps)
            angle += bias_rad * ((stripes, steps) == sets[0])
            light = (12 + 203 * (0.5 + 0.5 * np.cos(angle)) ** gamma) * shade
            frames.append(np.rint(light + random.normal(0.0, 1.2, SIZE)).clip(0, 255).astype(np.uint8))
    fringes = tuple(Sinusoid(axis="x", stripes=s, steps=n) for s, n in sets)
    return Recording(frames, Plan(fringes=fringes, unwrapping=unwrapping), (WIDTH, 600)), truth


def stated_over_actual(decoded: Decoded, truth: np.ndarray) -> float:
    error = (decoded.u - truth)[decoded.valid]
    assert decoded.sigma_phase_error is not None
    stated = np.sqrt(np.nanmean(decoded.sigma_phase_error**2))
    return float(stated / np.sqrt(error.var() - np.nanmean(decoded.sigma**2)))


@pytest.mark.parametrize(
    ("stripes", "unwrapping", "gamma"),
    [((1, 8, 64), "hierarchical", gamma) for gamma in (1.1, 1.3, 1.6, 1.9, 2.2)]
    + [((1, 6.5, 41.3), "hierarchical", 1.9), ((56, 63, 64), "heterodyne", 1.3)],
)
def test_the_phase_error_of_three_steps_is_stated(stripes, unwrapping, gamma) -> None:
    recording, truth = bent([(s, 3) for s in stripes], gamma, seed=int(100 * gamma), unwrapping=unwrapping)
    decoded = decode(recording)
    assert decoded.valid.mean() > 0.8
    assert stated_over_actual(decoded, truth) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("steps", [3, 4, 12])
def test_a_bent_response_costs_no_pixels_and_is_named_first(steps) -> None:
    recording, truth = bent([(s, steps) for s in (1, 8, 64)], 2.2, seed=steps)
    decoded = decode(recording)
    assert decoded.valid.mean() > 0.9
    assert np.abs(decoded.u - truth)[decoded.valid].max() < 3.0
    first = diagnose_frames(recording, decoded)[0]
    assert first.cause.key == "response"
    assert float(first.evidence.rsplit(" ", 1)[1]) == pytest.approx(2.2, abs=0.1)


def test_something_else_than_a_bent_response_is_no_sinusoid_still() -> None:
    recording, _ = bent([(s, 8) for s in (1, 8, 64)], 2.2, seed=1)
    recording.frames[20][40:80] = 255 - recording.frames[20][40:80]
    assert decode(recording).valid[40:80].mean() < 0.5
    assert decode(recording).valid[100:].all()


def test_phases_that_contradict_each_other_throughout_tell_no_response() -> None:
    recording, _ = bent([(1, 3), (9, 3), (64, 3)], 1.0, seed=2)
    wrong = recording.plan.model_copy(
        update={"fringes": tuple(Sinusoid(axis="x", stripes=s, steps=3) for s in (1, 7, 51))}
    )
    assert all(
        f.cause.key != "response" for f in diagnose_frames(Recording(recording.frames, wrong, (WIDTH, 600)))
    )
