"""Brightness models of a board's points, their derivatives, and their fits beside SciPy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import erf

from fpplab.core.cholesky import solve_positive
from fpplab.targets.detection import fit_centres
from fpplab.targets.profiles import PointModel, crossing_edges, disc, profile

EDGES = crossing_edges(2.0)
DISC = disc(1.2, 2.0)
THETAS = {
    0: np.array([0.3, -0.2, 0.2, 1.6, 1.3]),
    1: np.array([-0.4, 0.1, 0.0045, 0.0006, 0.0061, 1.1]),
}
MODELS = pytest.mark.parametrize("model", [EDGES, DISC], ids=["edges", "disc"])
JACOBIAN = np.array([[10.0, 1.0], [-1.5, 9.0]])


def plainly(model: PointModel, theta: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The models written down once more, for whole arrays."""
    u, v = x - theta[0], y - theta[1]
    if model is EDGES:
        edges = [(np.cos(t) * v - np.sin(t) * u) / theta[4] for t in theta[2:4]]
        return np.asarray(erf(edges[0]) * erf(edges[1]))
    along_u, along_v = theta[2] * u + theta[3] * v, theta[3] * u + theta[4] * v
    radius = np.sqrt(np.maximum(u * along_u + v * along_v, 1e-12))
    return np.asarray(erf((radius - 1) * radius / np.maximum(np.hypot(along_u, along_v), 1e-12) / theta[5]))


@MODELS
def test_brightness_is_the_models_formula(model: PointModel) -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-20, 21.0), np.arange(-20, 21.0)))
    theta = THETAS[int(model.surroundings)]
    np.testing.assert_allclose(model.brightness(theta, x, y), plainly(model, theta, x, y), atol=5e-10)


@MODELS
@given(x=st.floats(-25, 25), y=st.floats(-25, 25))
def test_derivatives_are_those_of_the_brightness(model: PointModel, x: float, y: float) -> None:
    kind, theta = int(model.surroundings), THETAS[int(model.surroundings)]
    slopes = np.full(len(theta), np.nan)
    _, varies = profile(kind, theta, x, y, slopes)
    spare = np.empty(len(theta))
    steps = 1e-5 * np.maximum(np.abs(theta), 0.01)
    expected = np.empty(len(theta))
    for k, step in enumerate(steps):
        up, down = theta.copy(), theta.copy()
        up[k] += step
        down[k] -= step
        expected[k] = (profile(kind, up, x, y, spare)[0] - profile(kind, down, x, y, spare)[0]) / (2 * step)
    found = slopes if varies else np.zeros(len(theta))
    # Where the model is cut off at ±1 it jumps by 2e-10, which the difference divides by its step.
    np.testing.assert_allclose(found * steps, expected * steps, atol=2e-10)


def by_scipy(model: PointModel, level: NDArray[np.float64], pixel: np.ndarray) -> np.ndarray:
    """Centre by variable projection with numerical derivatives, over the same square of the board."""
    v, u = np.indices(level.shape).reshape(2, -1)
    inside = (
        np.abs((np.stack([u, v], axis=1) - pixel) @ np.linalg.inv(JACOBIAN).T).max(axis=1) <= model.half_mm
    )
    x, y, seen = u[inside] - pixel[0], v[inside] - pixel[1], level.ravel()[inside]

    def misfit(theta: np.ndarray) -> np.ndarray:
        basis = np.stack([np.ones(len(x)), x, y, plainly(model, theta, x, y)], axis=1)
        return np.asarray(seen - basis @ np.linalg.lstsq(basis, seen, rcond=None)[0])

    fit = least_squares(misfit, model.initial_parameters(JACOBIAN), method="lm", xtol=1e-12, ftol=1e-12)
    return np.asarray(pixel + fit.x[:2])


@MODELS
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_centres_are_those_of_a_fit_by_scipy(model: PointModel, noise: float) -> None:
    random = np.random.default_rng(3)
    theta = model.initial_parameters(JACOBIAN)
    theta[:2], theta[-1] = (0.37, -0.61), 1.4
    v, u = np.indices((70, 70)).astype(np.float64)
    shape = plainly(model, theta, (u - 35).ravel(), (v - 34).ravel()).reshape(u.shape)
    level = 120 + 0.2 * u - 0.1 * v + 60 * shape + random.normal(0, noise, u.shape)
    pixel = np.array([35.0, 34.0])
    found = fit_centres(level, pixel[None], JACOBIAN[None], model)[0]
    assert found == pytest.approx(by_scipy(model, level, pixel), abs=1e-5)
    assert found == pytest.approx(pixel + theta[:2], abs=1e-6 if noise == 0 else 0.06)


@MODELS
def test_a_window_of_few_pixels_has_no_centre(model: PointModel) -> None:
    even = np.full((70, 70), 100.0)
    small = np.array([[3.0, 0.0], [0.0, 3.0]]) / 4
    assert np.isnan(fit_centres(even, np.array([[35.0, 35.0]]), small[None], model)).all()
    assert fit_centres(even, np.empty((0, 2)), np.empty((0, 2, 2)), model).shape == (0, 2)


@given(seed=st.integers(0, 1000), n=st.integers(1, 10), damping=st.sampled_from([0.0, 0.1]))
def test_normal_equations_are_solved(seed: int, n: int, damping: float) -> None:
    random = np.random.default_rng(seed)
    slopes = random.normal(size=(n + 5, n)) * 10.0 ** random.uniform(-3, 3, n)
    matrix, right, found = slopes.T @ slopes, random.normal(size=n), np.empty(n)
    assert solve_positive(matrix, right, damping, found)
    damped = matrix + damping * np.diag(np.diag(matrix))
    scale = np.sqrt(np.diag(damped))
    expected = np.linalg.solve(damped / np.outer(scale, scale), right / scale) / scale
    np.testing.assert_allclose(found * scale, expected * scale, rtol=1e-6, atol=1e-9)


def test_a_matrix_that_is_not_positive_is_told() -> None:
    assert not solve_positive(np.array([[1.0, 2.0], [2.0, 1.0]]), np.ones(2), 0.0, np.empty(2))
    assert not solve_positive(np.zeros((1, 1)), np.ones(1), 0.0, np.empty(1))
