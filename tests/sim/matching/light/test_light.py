"""Steps of a fit of light between the bounds of its parameters."""

import numpy as np
import pytest

from fpplab.core.conventions import Floats
from sim.matching.light.light_fit import _bounded_step


def equations(seed: int, size: int = 4) -> tuple[Floats, Floats]:
    random = np.random.default_rng(seed)
    matrix = random.normal(size=(60, size)) @ random.normal(size=(size, size))
    matrix /= np.sqrt(np.sum(matrix**2, axis=0))
    right_side = random.normal(size=60) + 3.0 * matrix.sum(axis=1)
    return np.asarray(matrix.T @ matrix, np.float64), np.asarray(matrix.T @ right_side, np.float64)


@pytest.mark.parametrize("seed", range(8))
def test_a_step_is_the_best_between_the_bounds(seed: int) -> None:
    """At a bound the cost would fall only beyond it, elsewhere it is stationary (Karush, Kuhn, Tucker)."""
    normal, gradient = equations(seed)
    lower, upper = np.full(4, -0.5), np.full(4, 1.0)
    step = _bounded_step(normal, gradient, lower, upper)
    slope = normal @ step - gradient
    at_lower, at_upper = np.isclose(step, lower), np.isclose(step, upper)
    assert (step >= lower - 1e-12).all()
    assert (step <= upper + 1e-12).all()
    assert at_upper.any() or at_lower.any()
    assert np.allclose(slope[~at_lower & ~at_upper], 0.0, atol=1e-8)
    assert (slope[at_lower] >= -1e-8).all()
    assert (slope[at_upper] <= 1e-8).all()


def test_a_parameter_at_its_bound_does_not_stop_the_others() -> None:
    """As ambient light and the dark level of the response: either makes up for the other."""
    matrix = np.array([[1.0, 1.0], [1.0, 1.02], [1.0, 0.97]])
    normal, gradient = matrix.T @ matrix, matrix.T @ np.array([1.0, 0.9, 1.2])
    free = np.linalg.solve(normal, gradient)
    assert free[1] < 0
    step = _bounded_step(normal, gradient, np.array([-10.0, 0.0]), np.array([10.0, 10.0]))
    assert step[1] == 0.0
    assert step[0] == pytest.approx(gradient[0] / normal[0, 0])
    assert step[0] < 0.5 * free[0], "not what goes along with the other"


def test_what_is_not_determined_stays() -> None:
    normal = np.array([[1.0, 1.0], [1.0, 1.0]])
    step = _bounded_step(normal, np.array([2.0, 2.0]), np.full(2, -9.0), np.full(2, 9.0))
    assert step == pytest.approx([1.0, 1.0])
