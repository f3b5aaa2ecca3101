"""Low-dimensional pattern sets, and the look-up, without Blender."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fpplab.conventions import Floats, Lattice
from fpplab.patterns import make_patterns, uniform_patterns
from fpplab.plan import FringeSet, Plan
from sim.light import look_up, span

SIZE = (57, 64)
ROUNDING = 1 / np.sqrt(12) / 255


def stack(plan: Plan, response: float = 1.0) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    images = [p.image for p in make_patterns(plan, SIZE, Lattice.DIAMOND)]
    return ((np.stack(images) / 255) ** response).astype(np.float32)


@pytest.mark.parametrize(
    ("stripes", "channels"), [((4,), 3), ((1, 8), 5), ((0.9, 4, 20), 7), ((0.9, 7.5, 13, 20), 9)]
)
def test_fringe_sets_need_one_channel_and_two_each(stripes: tuple[float, ...], channels: int) -> None:
    plan = Plan(fringes=tuple(FringeSet(axis="x", stripes=s, steps=8) for s in stripes))
    levels = stack(plan)
    basis = span(levels, ROUNDING)
    assert len(basis.channels) == channels
    assert basis.channels.min() >= -1e-6
    assert basis.channels.max() <= 1 + 1e-6
    error = np.einsum("nc,cvu->nvu", basis.weights, basis.channels) - levels
    assert np.sqrt((error**2).mean(axis=(1, 2))).max() <= ROUNDING * 1.001


def test_bent_response_needs_its_harmonics_and_is_still_right() -> None:
    plan = Plan(fringes=(FringeSet(axis="y", stripes=3, steps=8),))
    levels = stack(plan, 2.2)
    basis = span(levels, 2.2 * ROUNDING)
    assert len(basis.channels) > 3
    error = np.einsum("nc,cvu->nvu", basis.weights, basis.channels) - levels
    assert np.sqrt((error**2).mean(axis=(1, 2))).max() <= 2.2 * ROUNDING * 1.001


def test_uniform_patterns_need_white_alone() -> None:
    levels = np.stack([p.image for p in uniform_patterns([0, 77, 255], SIZE)]).astype(np.float32) / 255
    basis = span(levels, ROUNDING)
    assert len(basis.channels) == 1
    np.testing.assert_allclose(basis.weights[:, 0], np.array([0, 77, 255]) / 255, atol=1e-6)


def test_unrelated_patterns_come_back_exactly() -> None:
    levels = (np.random.default_rng(3).random((5, *SIZE[::-1])) > 0.5).astype(np.float32)
    basis = span(levels, ROUNDING)
    assert len(basis.channels) == 6
    np.testing.assert_allclose(np.einsum("nc,cvu->nvu", basis.weights, basis.channels), levels, atol=1e-4)


def samples(points: Floats, shade: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    out = np.zeros((1, 1, len(points), 4), np.float32)
    out[0, 0, :, :2], out[0, 0, :, 2] = points, shade
    return out


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0, 8.99), st.floats(0, 6.99)), min_size=1, max_size=20),
    st.floats(0.015625, 1),
)
def test_look_up_interpolates_a_plane_exactly(points: list[tuple[float, float]], shade: float) -> None:
    row, column = np.mgrid[0:8, 0:10]
    texture = (0.1 + 0.03 * column - 0.02 * row).astype(np.float32)
    x, y = np.array(points).T
    found = look_up(texture, samples(np.array(points), shade), exact=False)[0]
    np.testing.assert_allclose(found, shade * (0.1 + 0.03 * x - 0.02 * y), atol=1e-6)


def test_look_up_outside_the_texture_or_in_shadow_is_dark() -> None:
    texture = np.ones((8, 10), np.float32)
    outside = np.array([[-1.0, 3.0], [9.5, 3.0], [3.0, -0.51], [3.0, 7.6], [1e9, 3.0], [-1e9, 3.0]])
    for exact in (False, True):
        assert look_up(texture, samples(outside, 1.0), exact).max() == 0
        assert look_up(texture, samples(np.array([[4.0, 4.0]]), 0.0), exact).max() == 0


def test_exact_look_up_takes_the_nearest_texel_and_the_mean_of_the_samples() -> None:
    texture = np.arange(80, dtype=np.float32).reshape(8, 10)
    places = samples(np.array([[3.4, 2.4], [3.6, 2.6]]), 0.5)
    np.testing.assert_array_equal(look_up(texture, places, exact=True)[0], [0.5 * 23, 0.5 * 34])
    both = np.concatenate([places[:, :, :1], places[:, :, 1:]])
    np.testing.assert_array_equal(look_up(texture, both, exact=True)[0], [(11.5 + 17.0) / 2])
