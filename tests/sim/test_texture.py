"""Mirrors as a texture."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fpplab.core.conventions import Lattice, mirror_centres
from sim.texture import MirrorTexture, least_blur


@pytest.mark.parametrize("lattice", list(Lattice))
@pytest.mark.parametrize("size", [(8, 9), (9, 8), (16, 11)])
def test_every_mirror_has_its_texel_at_its_centre(lattice: Lattice, size: tuple[int, int]) -> None:
    texture = MirrorTexture(size, lattice, 0.0)
    light = np.arange(1, size[0] * size[1] + 1, dtype=np.float32).reshape(size[::-1])
    texels = texture.spread(light)
    u, v = mirror_centres(size, lattice)
    column, row = np.einsum("ij,jvu->ivu", texture.affine, np.stack([u, v, np.ones_like(u)]))
    np.testing.assert_allclose(column, np.rint(column), atol=1e-12)
    np.testing.assert_allclose(row, np.rint(row), atol=1e-12)
    np.testing.assert_array_equal(texels[row.astype(int), column.astype(int)], light)
    assert texels.sum() == light.sum()
    edge = np.concatenate([texels[0], texels[-1], texels[:, 0], texels[:, -1]])
    assert edge.max() == 0


@pytest.mark.parametrize("lattice", list(Lattice))
@pytest.mark.parametrize("blur", [0.45, 0.6, 1.5])
def test_a_mirror_s_light_has_the_stated_width_and_keeps_its_flux(lattice: Lattice, blur: float) -> None:
    """Texels and their linear interpolation together: variance blur² of the lens and 1/12 of the mirror."""
    texture = MirrorTexture((41, 61), lattice, blur)
    light = np.zeros((61, 41), np.float32)
    light[30, 20] = 1
    texels = texture.spread(light).astype(np.float64)
    assert texels.sum() == pytest.approx(1, abs=1e-6)
    for axis in (0, 1):
        profile = texels.sum(axis=axis)
        place = np.arange(len(profile))
        mean = profile @ place
        variance = profile @ (place - mean) ** 2 + 1 / 6
        assert math.sqrt(variance) == pytest.approx(math.sqrt(blur**2 + 1 / 12), rel=1e-3)


@pytest.mark.parametrize("fill", [0.6, 1.0])
def test_least_blur_is_linear_interpolation_alone(fill: float) -> None:
    texture = MirrorTexture((9, 9), Lattice.SQUARE, least_blur(fill), fill)
    light = np.zeros((9, 9), np.float32)
    light[4, 4] = 1
    assert np.count_nonzero(texture.spread(light) > 1e-6) == 1


@pytest.mark.parametrize("lattice", list(Lattice))
@pytest.mark.parametrize("circle", [0.4, 1.0, 1.89, 1.9, 2.5, 4.0, 7.3, 15.0])
def test_out_of_focus_a_disc_s_variance_comes_on_top(lattice: Lattice, circle: float) -> None:
    """D²/16 along each side, for every diameter, also where a Gaussian stands for the disc."""
    texture = MirrorTexture((61, 91), lattice, 0.6, 0.9, widest=15.0)
    light = np.zeros((91, 61), np.float32)
    light[45, 30] = 1
    texels = texture.spread(light, circle).astype(np.float64)
    assert texels.sum() == pytest.approx(1, abs=1e-6)
    for axis in (0, 1):
        profile = texels.sum(axis=axis)
        place = np.arange(len(profile))
        variance = profile @ (place - profile @ place) ** 2 + 1 / 6
        assert variance == pytest.approx(0.6**2 + 0.9 / 12 + circle**2 / 16, rel=0.01)


def test_a_wide_circle_is_a_disc_and_not_a_gaussian() -> None:
    """Uniform light within the radius, none beyond."""
    texture = MirrorTexture((81, 81), Lattice.SQUARE, least_blur(1.0), widest=30.0)
    light = np.zeros((81, 81), np.float32)
    light[40, 40] = 1
    texels = texture.spread(light, 30.0)
    row, column = np.mgrid[: texels.shape[0], : texels.shape[1]]
    middle = np.array(np.unravel_index(np.argmax(cv2.GaussianBlur(texels, None, 5)), texels.shape))
    radius = np.hypot(row - middle[0], column - middle[1])
    np.testing.assert_allclose(texels[radius < 13.5], 1 / (np.pi * 15**2), rtol=0.02)
    assert np.abs(texels[radius > 16.5]).max() < 1e-9


@settings(max_examples=40, deadline=None)
@given(
    lattice=st.sampled_from(Lattice),
    blur=st.sampled_from([0.0, 0.4, 1.3]),
    circle=st.sampled_from([0.0, 1.2, 3.4, 7.0]),
    corner=st.tuples(st.integers(0, 30), st.integers(0, 30)),
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
)
def test_a_part_of_a_texture_is_cut_out_of_the_whole(
    lattice: Lattice, blur: float, circle: float, corner: tuple[int, int], size: tuple[int, int]
) -> None:
    texture = MirrorTexture((23, 30), lattice, blur, widest=7.0)
    light = np.random.default_rng(3).random((30, 23), np.float32)
    whole = texture.spread(light, circle)
    (x, y), (width, height) = corner, size
    right, bottom = min(x + width, whole.shape[1]), min(y + height, whole.shape[0])
    for circles in ((circle,), (7.0, circle, 0.0)):
        part = texture.spreads(light, circles, (x, y, right, bottom))[circles.index(circle)]
        np.testing.assert_allclose(part, whole[y:bottom, x:right], atol=1e-6)
