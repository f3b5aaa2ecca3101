"""Low-dimensional pattern sets, and the look-up, without Blender."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Lattice
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.light.basis import smallest_basis
from sim.light.table import LightTable
from sim.mirror_spread import STEPS, TAPS
from sim.texture import PatternTextures

SIZE = (57, 64)
ROUNDING = 1 / np.sqrt(12) / 255


def stack(plan: Plan, response: float = 1.0) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    images = [p.image for p in make_patterns(plan, SIZE, Lattice.DIAMOND)]
    return ((np.stack(images) / 255) ** response).astype(np.float32)


@pytest.mark.parametrize(
    ("stripes", "channels"), [((4,), 3), ((1, 8), 5), ((0.9, 4, 20), 7), ((0.9, 7.5, 13, 20), 9)]
)
def test_fringe_sets_need_one_channel_and_two_each(stripes: tuple[float, ...], channels: int) -> None:
    plan = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=8) for s in stripes))
    levels = stack(plan)
    basis = smallest_basis(levels, ROUNDING)
    assert len(basis.channels) == channels
    assert basis.channels.min() >= -1e-6
    assert basis.channels.max() <= 1 + 1e-6
    error = np.einsum("nc,cvu->nvu", basis.weights, basis.channels) - levels
    assert np.sqrt((error**2).mean(axis=(1, 2))).max() <= ROUNDING * 1.001


def test_nonlinear_response_needs_its_harmonics_and_is_represented() -> None:
    plan = Plan(fringes=(Sinusoid(axis="y", stripes=3, steps=8),))
    levels = stack(plan, 2.2)
    basis = smallest_basis(levels, 2.2 * ROUNDING)
    assert len(basis.channels) > 3
    error = np.einsum("nc,cvu->nvu", basis.weights, basis.channels) - levels
    assert np.sqrt((error**2).mean(axis=(1, 2))).max() <= 2.2 * ROUNDING * 1.001


def test_uniform_patterns_need_white_alone() -> None:
    levels = np.stack([p.image for p in uniform_patterns([0, 77, 255], SIZE)]).astype(np.float32) / 255
    basis = smallest_basis(levels, ROUNDING)
    assert len(basis.channels) == 1
    np.testing.assert_allclose(basis.weights[:, 0], np.array([0, 77, 255]) / 255, atol=1e-6)


def test_unrelated_patterns_are_represented_exactly() -> None:
    levels = (np.random.default_rng(3).random((5, *SIZE[::-1])) > 0.5).astype(np.float32)
    basis = smallest_basis(levels, ROUNDING)
    assert len(basis.channels) == 6
    np.testing.assert_allclose(np.einsum("nc,cvu->nvu", basis.weights, basis.channels), levels, atol=1e-4)


def table(points: Floats, shade: float, circle: float = 0.0, views: int = 1) -> LightTable:
    """Pixels (1, n / views) that see the projector at points (n, 2), column and row."""
    samples = np.full((views, 1, len(points) // views, 4), shade, np.float32)
    samples[..., :2] = points.reshape(views, 1, -1, 2)
    samples[..., 2] = circle
    return LightTable(samples, np.zeros(samples.shape[1:3], np.float32))


def linear() -> NDArray[np.float32]:
    """Weights (STEPS + 1, TAPS) of linear interpolation."""
    away = np.linspace(-0.5, 0.5, STEPS + 1)[:, None] - (np.arange(TAPS) - TAPS // 2)
    return np.maximum(1 - np.abs(away), 0).astype(np.float32)


def textured(
    stacked: NDArray[Any], fill: float | None = None, origin: tuple[int, int] = (0, 0)
) -> PatternTextures:
    """Textures (circles, rows, columns, patterns), of sharp mirrors where they have a side `fill`."""
    texels = np.ascontiguousarray(stacked, np.float32)
    weights = None if fill else np.stack([linear()] * len(texels))
    return PatternTextures(texels, weights, fill or 1.0, origin)


def seen(of: LightTable, *textures: NDArray[Any], fill: float | None = None) -> NDArray[np.float32]:
    """One row of pixels under one texture for each circle."""
    row: NDArray[np.float32] = of.look_up(textured(np.stack(textures)[..., None], fill))[0, 0]
    return row


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(st.floats(3, 10.99), st.floats(3, 8.99)), min_size=1, max_size=20),
    st.floats(0.015625, 1),
)
def test_look_up_interpolates_a_plane_exactly(points: list[tuple[float, float]], shade: float) -> None:
    row, column = np.mgrid[0:13, 0:15]
    texture = 0.1 + 0.03 * column - 0.02 * row
    x, y = np.array(points).T
    found = seen(table(np.array(points), shade), texture)
    np.testing.assert_allclose(found, shade * (0.1 + 0.03 * x - 0.02 * y), atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 4, 9]), st.floats(0, 6))
def test_samples_of_a_pixel_are_averaged_wherever_they_lie(seed: int, views: int, apart: float) -> None:
    """Near each other, between other mirrors, or at other circles of confusion."""
    random = np.random.default_rng(seed)
    textures = random.random((3, 24, 26, 2), np.float32)
    weights = random.random((3, STEPS + 1, TAPS), np.float32)
    middle = random.uniform(9, 14, (1, 7, 2)) + random.uniform(-apart, apart, (views, 7, 2))
    samples = np.zeros((views, 1, 7, 4), np.float32)
    samples[:, 0, :, :2] = middle
    samples[..., 2] = random.choice([0, 0.3, 1, 1.9, 2], (views, 1, 7))
    samples[..., 3] = random.choice([0, 0.4, 1], (views, 1, 7))
    of = LightTable(samples, np.zeros((1, 7), np.float32))
    expected = np.zeros((2, 7))
    for k in range(views):
        for n, (x, y, circle, shade) in enumerate(samples[k, 0].astype(np.float64)):
            i, j, lower = int(np.floor(x + 0.5)), int(np.floor(y + 0.5)), int(circle)
            for level, share in ((lower, 1 - circle + lower), (min(lower + 1, 2), circle - lower)):
                across, down = (
                    [np.interp(o, np.linspace(-0.5, 0.5, STEPS + 1), tap) for tap in weights[level].T]
                    for o in (x - i, y - j)
                )
                around = textures[level, j - 2 : j + 3, i - 2 : i + 3]
                expected[:, n] += shade * share * np.einsum("r,rcn,c->n", down, around, across) / views
    found = of.look_up(PatternTextures(textures, weights))[:, 0]
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-5)


@pytest.mark.parametrize(
    ("circle", "expected"), [(0.0, 1.0), (0.25, 1.25), (1.0, 2.0), (1.5, 3.5), (2.0, 5.0)]
)
def test_look_up_mixes_neighbouring_circles(circle: float, expected: float) -> None:
    textures = [np.full((8, 10), value) for value in (1.0, 2.0, 5.0)]
    assert seen(table(np.array([[4.3, 3.2]]), 1.0, circle), *textures)[0] == pytest.approx(expected)


def test_many_patterns_are_looked_up_as_one_is() -> None:
    random = np.random.default_rng(5)
    textures = random.random((2, 15, 17, 13), np.float32)
    of = table(random.uniform(3, 11, (40, 2)), 0.7, 0.4, views=4)
    together = of.look_up(textured(textures))
    alone = [of.look_up(textured(textures[..., k : k + 1]))[0] for k in range(13)]
    np.testing.assert_allclose(together, alone, rtol=1e-6)


@pytest.mark.whole
@pytest.mark.parametrize("fill", [None, 1.0, 0.8])
def test_look_up_outside_the_texture_or_in_shadow_is_dark(fill: float | None) -> None:
    texture = np.ones((8, 10))
    outside = np.array([[-1.0, 3.0], [9.5, 3.0], [3.0, -0.51], [3.0, 7.6], [1e9, 3.0], [-1e9, 3.0]])
    assert seen(table(outside, 1.0), texture, fill=fill).max() == 0
    assert seen(table(np.array([[4.0, 4.0]]), 0.0), texture, fill=fill).max() == 0


def test_sharp_mirrors_are_looked_up_whole_and_samples_averaged() -> None:
    texture = np.arange(80).reshape(8, 10)
    places = np.array([[3.4, 2.4], [3.6, 2.6]])
    np.testing.assert_array_equal(seen(table(places, 0.5), texture, fill=1.0), [0.5 * 23, 0.5 * 34])
    both = table(places, 0.5, views=2)
    np.testing.assert_array_equal(seen(both, texture, fill=1.0), [(11.5 + 17.0) / 2])


def test_gaps_between_sharp_mirrors_are_dark_and_the_mirrors_brighter() -> None:
    places = np.array([[3.0, 2.0], [3.39, 2.39], [3.41, 2.0], [3.0, 2.41]])
    found = seen(table(places, 0.5), np.ones((8, 10)), fill=0.8)
    np.testing.assert_allclose(found, [0.5 / 0.64, 0.5 / 0.64, 0, 0], rtol=1e-6)


def test_the_light_of_a_white_pattern_is_divided_out_of_a_table() -> None:
    _, column = np.mgrid[0:8, 0:10]
    white = (0.5 + 0.02 * column)[None, ..., None]
    found = table(np.array([[4.0, 3.0], [20.0, 3.0]]), 0.58).divided_by(textured(white)).samples[0, 0, :, 3]
    np.testing.assert_allclose(found, [1.0, 0.0], rtol=1e-6)


def test_sharp_mirrors_are_divided_out_alike() -> None:
    places = np.array([[3.0, 2.0], [3.45, 2.0]])
    of_white = table(places, 0.5 / 0.64)  # Blender makes mirrors brighter for the dark between them
    of_white.samples[0, 0, 1, 3] = 0.0
    found = of_white.divided_by(textured(np.ones((1, 8, 10, 1)), 0.8)).samples[0, 0, :, 3]
    np.testing.assert_allclose(found, [0.5, 0.0], rtol=1e-6)


@pytest.mark.parametrize("fill", [None, 1.0, 0.8])
def test_a_table_of_a_window_is_the_whole_one_cut_out(fill: float | None) -> None:
    """A part of the texture gives the same; outside the window it is dark."""
    random = np.random.default_rng(7)
    samples = np.zeros((2, 12, 15, 4), np.float32)
    samples[:, 3:9, 4:11, :2] = random.uniform(8, 20, (2, 6, 7, 2))
    samples[:, 3:9, 4:11, 2] = random.uniform(0, 1, (2, 6, 7))
    samples[:, 3:9, 4:11, 3] = random.uniform(0.1, 1, (2, 6, 7))
    samples[0, 5, 5, :2] = 1e9, -1e9
    albedo = np.zeros((12, 15), np.float32)
    whole = LightTable(samples, albedo)
    window = LightTable(np.ascontiguousarray(samples[:, 3:9, 4:11]), albedo, (4, 3))
    textures = random.random((2, 40, 30, 5), np.float32)
    for of in (whole, window):
        left, top, right, bottom = of.part((40, 30))
        cut = textured(textures[:, top:bottom, left:right], fill, (left, top))
        np.testing.assert_allclose(of.look_up(cut), whole.look_up(textured(textures, fill)), atol=2e-5)
    assert whole.look_up(textured(textures, fill))[:, 3:9, 4:11].max() > 0.3


def test_a_table_that_sees_nothing_lit_is_dark() -> None:
    dark = LightTable(np.zeros((1, 3, 0, 4), np.float32), np.zeros((3, 5), np.float32), (5, 0))
    left, top, right, bottom = dark.part((40, 30))
    cut = textured(np.ones((1, bottom - top, right - left, 2)), origin=(left, top))
    np.testing.assert_array_equal(dark.look_up(cut), np.zeros((2, 3, 5)))
