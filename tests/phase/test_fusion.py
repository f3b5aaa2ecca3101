"""The coordinate uses all images: its scatter reaches the Cramér-Rao bound, and its sigma says so."""

import numpy as np
import pytest

from fpplab.core.conventions import Axis
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.phase.precision import coordinate_spread

WIDTH, HEIGHT, LEVEL, MODULATION = 912, 200, 32000.0, 20000.0


def plan_of(stripes: tuple[float, ...], steps: tuple[int, ...], unwrapping: str, axis: Axis = "x") -> Plan:
    fringes = (Sinusoid(axis=axis, stripes=s, steps=n) for s, n in zip(stripes, steps, strict=True))
    return Plan(fringes=tuple(fringes), unwrapping=unwrapping)


def errors(
    plan: Plan, noise: float, seed: int, bias: dict[int, float] | None = None
) -> tuple[Decoded, np.ndarray]:
    """Decode frames of all coordinates with Gaussian noise in units of B; `bias` in rad by fringe set."""
    axis = plan.axes[0]
    size = (WIDTH, HEIGHT) if axis == "x" else (HEIGHT, WIDTH)
    random, truth = np.random.default_rng(seed), np.tile(np.linspace(5.0, WIDTH - 6.0, WIDTH), (HEIGHT, 1))
    truth = truth if axis == "x" else truth.T
    frames = []
    for index, step, _ in plan.steps():
        fringe = plan.fringes[index]
        phase = 2 * np.pi * fringe.stripes * (truth + 0.5) / WIDTH + (bias or {}).get(index, 0.0)
        level = LEVEL + MODULATION * np.cos(phase - fringe.phase_shifts()[step])
        level += MODULATION * random.normal(0.0, noise, truth.shape)
        frames.append(np.rint(level).astype(np.uint16))
    decoded = decode(Recording(frames, plan, size, 16))
    return decoded, (decoded.u if axis == "x" else decoded.v) - truth


PLANS = [
    ((1.0, 8.0, 64.0), (12, 12, 12), "hierarchical", 0.02),
    ((1.0, 19.03, 167.2), (3, 3, 12), "hierarchical", 0.02),
    ((144.0, 155.0, 167.0), (6, 6, 6), "heterodyne", 0.01),
    ((146.0, 156.0, 167.0), (3, 3, 3), "heterodyne", 0.01),
    ((59.0, 64.0, 70.0), (3, 3, 3), "heterodyne", 0.02),
]


@pytest.mark.parametrize(("stripes", "steps", "unwrapping", "noise"), PLANS)
@pytest.mark.parametrize("axis", ["x", "y"])
def test_the_scatter_is_the_bound_of_all_images(
    stripes: tuple[float, ...], steps: tuple[int, ...], unwrapping: str, noise: float, axis: Axis
) -> None:
    plan = plan_of(stripes, steps, unwrapping, axis)
    decoded, error = errors(plan, noise, seed=11)
    assert decoded.valid.mean() > 0.999
    size = (WIDTH, HEIGHT) if axis == "x" else (HEIGHT, WIDTH)
    bound = noise * coordinate_spread(plan, axis, size)
    # 182,400 pixels: the standard deviation is known to 0.17 %.
    assert np.nanstd(error) == pytest.approx(bound, rel=0.01)
    # Three steps show their noise in the offsets alone, which fewer pixels tell less well.
    assert np.nanstd(error / decoded.sigma) == pytest.approx(1.0, abs=0.03)
    assert np.nanmean(error) == pytest.approx(0.0, abs=5 * bound / np.sqrt(error.size))
    assert np.nanmean(decoded.disagreement**2) == pytest.approx(1.0, abs=0.06)


def test_the_bound_is_the_published_formula() -> None:
    plan = plan_of((59.0, 64.0, 70.0), (3, 3, 3), "heterodyne")
    information = sum(3 / 2 * (2 * np.pi * s / WIDTH) ** 2 for s in (59, 64, 70))
    assert coordinate_spread(plan, "x", (WIDTH, 1)) == pytest.approx(1 / np.sqrt(information))
    # Monte Carlo of independent code at noise/B = 0.02: 0.0214 px.
    assert 0.02 * coordinate_spread(plan, "x", (WIDTH, 1)) == pytest.approx(0.0214, rel=0.015)


def test_a_set_that_contradicts_the_finest_does_not_move_the_coordinate() -> None:
    stripes, steps = (146.0, 156.0, 167.0), (3, 3, 3)
    plan, noise = plan_of(stripes, steps, "heterodyne"), 0.004
    biased, error = errors(plan, noise, seed=5, bias={0: 2 * np.pi * 0.02})
    right = np.abs(error) < 2.0
    bound = noise * coordinate_spread(plan, "x", (WIDTH, 1), [1, 2])
    assert right.mean() > 0.99
    assert np.std(error[right]) == pytest.approx(bound, rel=0.02)
    assert abs(np.mean(error[right])) < 5 * bound / np.sqrt(error.size)
    assert np.median(biased.disagreement[right]) > 10


def test_the_rounding_of_float32_is_part_of_sigma() -> None:
    plan = plan_of((1.0, 8.0, 64.0), (12, 12, 12), "hierarchical")
    decoded, error = errors(plan, 0.0, seed=0)
    assert np.nanstd(error) < 3 * np.nanmedian(decoded.sigma) < 1e-3
