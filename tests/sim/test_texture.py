"""Mirrors as a texture."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.special import erf, j1

from fpplab.core.conventions import Floats, Lattice, mirror_centres
from sim.mirror_spread import STEPS, TAPS, MirrorPointSpread
from sim.texture import MirrorTexture, Texels


@pytest.mark.parametrize("lattice", list(Lattice))
@pytest.mark.parametrize("size", [(8, 9), (9, 8), (16, 11)])
def test_every_mirror_has_its_texel_at_its_centre(lattice: Lattice, size: tuple[int, int]) -> None:
    texture = MirrorTexture(size, lattice, 0.0)
    light = np.arange(1, size[0] * size[1] + 1, dtype=np.float32).reshape(size[::-1])
    texels = texture.filtered(light)[0]
    u, v = mirror_centres(size, lattice)
    column, row = np.einsum("ij,jvu->ivu", texture.affine, np.stack([u, v, np.ones_like(u)]))
    np.testing.assert_allclose(column, np.rint(column), atol=1e-12)
    np.testing.assert_allclose(row, np.rint(row), atol=1e-12)
    np.testing.assert_array_equal(texels[row.astype(int), column.astype(int)], light)
    assert texels.sum() == light.sum()
    edge = np.concatenate([texels[0], texels[-1], texels[:, 0], texels[:, -1]])
    assert edge.max() == 0


def one_mirror(texture: MirrorTexture) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Light of one mirror in the middle, and the texel (row, column) of it."""
    columns, rows = texture.size
    light = np.zeros((rows, columns), np.float32)
    light[rows // 2, columns // 2] = 1
    sharp = MirrorTexture(texture.size, texture.lattice, 0.0).filtered(light)[0]
    margin = (texture.shape[0] - sharp.shape[0]) // 2
    row, column = np.unravel_index(np.argmax(sharp), sharp.shape)
    return light, (int(row) + margin, int(column) + margin)


def profile(texture: MirrorTexture, circle: float) -> Floats:
    """A mirror's light at STEPS places per texel, summed over the other axis."""
    light, (_, column) = one_mirror(texture)
    weights = texture.weights((circle,))
    assert weights is not None
    filtered = texture.filtered(light, (circle,))[0].astype(np.float64).sum(axis=0)
    reach = min(column, len(filtered) - column) - TAPS
    found = []
    for near in range(column - reach, column + reach + 1):
        around = filtered[near - TAPS // 2 : near + TAPS // 2 + 1]
        found.append(weights[0, :STEPS] @ around)
    return np.concatenate(found)


@pytest.mark.parametrize("lattice", list(Lattice))
@pytest.mark.parametrize("blur", [0.25, 0.4, 0.6, 1.5])
@pytest.mark.parametrize("circle", [0.0, 0.4, 1.0, 2.5, 4.0, 7.3])
def test_a_mirror_s_light_weakens_fringes_as_lens_mirror_and_disc_do(
    lattice: Lattice, blur: float, circle: float
) -> None:
    """Modulation along an axis: Gaussian times square times disc; and the flux is kept."""
    light = profile(MirrorTexture((61, 91), lattice, blur, 0.9, widest=7.3), circle) / STEPS
    place = np.arange(len(light)) / STEPS
    assert light.sum() == pytest.approx(1, abs=1e-4)
    for frequency in (0.02, 0.09, 0.18, 0.25):
        found = np.abs(light @ np.exp(2j * np.pi * frequency * place))
        disc = 2 * j1(np.pi * circle * frequency) / (np.pi * circle * frequency) if circle else 1.0
        lens = np.exp(-2 * (np.pi * blur * frequency) ** 2)
        expected = np.sinc(math.sqrt(0.9) * frequency) * lens * disc
        assert found == pytest.approx(abs(expected), abs=2e-3)


@pytest.mark.parametrize("blur", [0.25, 0.3, 0.4])
@pytest.mark.parametrize("fill", [0.7, 1.0])
def test_a_sharp_lens_shows_the_mirror_s_edges(blur: float, fill: float) -> None:
    texture = MirrorTexture((41, 41), Lattice.SQUARE, blur, fill)
    light = profile(texture, 0.0)
    place = (np.arange(len(light)) - np.argmax(light)) / STEPS
    edges = (place[:, None] + [texture.fill / 2, -texture.fill / 2]) / (np.sqrt(2) * blur)
    expected = (erf(edges[:, 0]) - erf(edges[:, 1])) / (2 * texture.fill)
    np.testing.assert_allclose(light, expected, atol=2e-4)


def light_at(places: Floats, light: Floats, spread: MirrorPointSpread) -> Floats:
    """Light at places (n, 2) by the plain sum over square mirrors at whole places, discs by many points."""
    turns = np.arange(500 if spread.circle else 1) + 0.5
    radius, angle = spread.circle / 2 * np.sqrt(turns / len(turns)), turns * np.pi * (3 - np.sqrt(5))
    total = np.zeros(len(places))
    for dx, dy in np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1):
        across, down = (
            erf((offset + spread.fill / 2) / (np.sqrt(2) * spread.blur))
            - erf((offset - spread.fill / 2) / (np.sqrt(2) * spread.blur))
            for offset in (
                places[:, :1] + dx - np.arange(light.shape[1]),
                places[:, 1:] + dy - np.arange(light.shape[0]),
            )
        )
        total += np.einsum("nr,rc,nc->n", down, light, across) / (2 * spread.fill) ** 2
    return total / len(turns)


def interpolated(texels: Texels, weights: Texels, places: Floats) -> Floats:
    """Light at places (n, 2), by the definition of the weights."""
    found = np.empty(len(places))
    for n, (x, y) in enumerate(places):
        i, j = round(x), round(y)
        across, down = (
            np.array([np.interp(o, np.linspace(-0.5, 0.5, STEPS + 1), tap) for tap in weights.T])
            for o in (x - i, y - j)
        )
        around = texels[j - TAPS // 2 : j + TAPS // 2 + 1, i - TAPS // 2 : i + TAPS // 2 + 1]
        found[n] = down @ around @ across
    return found


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(
    "direction",
    [
        (0.183, 0.0),
        (0.125, -0.125),
        pytest.param((0.0917, 0.0917), marks=pytest.mark.nightly),
        pytest.param((0.05, 0.02), marks=pytest.mark.nightly),
    ],
)
@pytest.mark.parametrize(
    ("blur", "fill", "circle"),
    [
        *((blur, 1.0, 0.0) for blur in (0.25, 0.5, 1.0)),
        (0.3, 0.9, 0.0),
        (0.4, 1.0, 0.75),
        (0.69, 0.92, 1.5),
        *(pytest.param(blur, 1.0, 0.0, marks=pytest.mark.nightly) for blur in (0.3, 0.4, 0.6, 0.69, 2.0)),
        pytest.param(0.69, 1.0, 3.0, marks=pytest.mark.nightly),
    ],
)
def test_the_light_of_fringes_is_that_of_blurred_squares(
    direction: tuple[float, float], blur: float, fill: float, circle: float
) -> None:
    """Between the mirrors too, for fringes along an axis (square lattice) and across both (diamond).

    A thousandth of the amplitude is 4e-4 px of the phase of the finest fringes.
    """
    texture = MirrorTexture((80, 80), Lattice.SQUARE, blur, fill, widest=circle)
    column, row = np.meshgrid(np.arange(80), np.arange(80))
    light = 0.5 + 0.5 * np.cos(2 * np.pi * (direction[0] * column + direction[1] * row) + 1)
    places = np.random.default_rng(4).uniform(30, 50, (150, 2))
    weights = texture.weights((circle,))
    assert weights is not None
    offset = texture.affine[:, 2]
    texels = texture.filtered(light.astype(np.float32), (circle,))[0]
    expected = light_at(places, light, MirrorPointSpread(blur, texture.fill, circle))
    np.testing.assert_allclose(interpolated(texels, weights[0], places + offset), expected, atol=1e-3)
    fine = map_coordinates(
        texture.fine(light.astype(np.float32), circle).astype(np.float64),
        (places + offset)[:, ::-1].T * texture.places_per_mirror,
        order=3,
        prefilter=False,
    )
    np.testing.assert_allclose(fine, expected, atol=2e-3 if blur >= 0.4 else 6e-3)


def test_white_mirrors_give_even_light() -> None:
    texture = MirrorTexture((40, 40), Lattice.SQUARE, 0.6, widest=4.0)
    weights = texture.weights((0.0, 4.0))
    assert weights is not None
    np.testing.assert_allclose(weights.sum(axis=-1), 1, atol=1e-6)
    for texels in texture.filtered(np.ones((40, 40), np.float32), (0.0, 4.0)):
        middle = np.array(texels.shape) // 2
        np.testing.assert_allclose(texels[middle[0] - 5 : middle[0] + 5, middle[1]], 1, atol=1e-6)


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
    whole = texture.filtered(light, (circle,))[0]
    (x, y), (width, height) = corner, size
    right, bottom = min(x + width, whole.shape[1]), min(y + height, whole.shape[0])
    for circles in ((circle,), (7.0, circle, 0.0)):
        part = texture.filtered(light, circles, (x, y, right, bottom))[circles.index(circle)]
        np.testing.assert_allclose(part, whole[y:bottom, x:right], atol=1e-6)
