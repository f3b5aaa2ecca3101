"""Patterns of few bits: what they keep of the light that is wanted."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from fpplab.core.conventions import Floats, Lattice
from fpplab.patterns.dither import diffuse
from fpplab.patterns.fringe_sets.gray import Gray
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode

SIZE = 256, 192
LATTICES = pytest.mark.parametrize("lattice", list(Lattice))


def plan(bits: int | None, steps: int = 3) -> Plan:
    sets = (Sinusoid(axis="x", stripes=s, steps=steps, pattern_bits=bits) for s in (1, 6, 24))
    return Plan(fringes=tuple(sets))


def light(of: Plan, lattice: Lattice) -> Floats:
    return np.array([p.image / 255.0 for p in make_patterns(of, SIZE, lattice)])


@LATTICES
@pytest.mark.parametrize("greys", [1, 7])
def test_a_neighbourhood_keeps_its_mean(lattice: Lattice, greys: int) -> None:
    wanted = np.random.default_rng(5).uniform(0.05, 0.95)
    shown = diffuse(np.full((64, 64), wanted), greys, lattice, 0)
    assert set(np.unique(np.rint(shown * greys))) <= {np.floor(wanted * greys), np.ceil(wanted * greys)}
    tiles = shown.reshape(8, 8, 8, 8).mean(axis=(1, 3))
    # Means of 64 independent mirrors would scatter by up to 0.06 levels; here only edges leave an error.
    assert np.sqrt(np.mean((tiles - wanted) ** 2)) < 0.03 / greys


@LATTICES
def test_blur_takes_the_error_off(lattice: Lattice) -> None:
    exact, few = light(plan(None), lattice), light(plan(3), lattice)
    assert set(np.unique(np.rint(few * 7))) == set(range(8))
    rounded = np.rint(exact * 7) / 7
    dithered, plain = (
        np.std([gaussian_filter(e, 1.0)[8:-8, 8:-8] for e in of - exact]) for of in (few, rounded)
    )
    assert dithered < 0.4 * plain


def test_errors_of_opposite_images_are_independent() -> None:
    exact, few = light(plan(None, 4), Lattice.SQUARE), light(plan(2, 4), Lattice.SQUARE)
    error = (few - exact)[:, 8:]  # the first rows differ by how they begin
    for a, b in ((0, 2), (1, 3), (4, 6), (8, 10)):
        assert abs(np.corrcoef(error[a].ravel(), error[b].ravel())[0, 1]) < 0.5  # -1 with errors alike


def test_code_of_black_and_white_needs_one_bit() -> None:
    sets = [Plan(fringes=(Gray(kind="gray", axis="x", bits=8, pattern_bits=b),)) for b in (None, 1)]
    np.testing.assert_array_equal(*(light(each, Lattice.DIAMOND) for each in sets))
    assert {p.bit_depth for p in make_patterns(sets[1], SIZE, Lattice.DIAMOND)} == {1}


@pytest.mark.parametrize("steps", [3, 4])
def test_nine_images_of_four_bits_are_hardly_noisier_and_say_so(steps: int) -> None:
    column, row = np.meshgrid(np.arange(200), np.arange(160))
    u, v = 20.3 + 1.02 * column + 0.07 * row, 8.6 + 1.04 * row - 0.03 * column
    spread, stated = [], []
    for bits in (None, 4):
        random, frames, shown = np.random.default_rng(11), [], plan(bits, steps)
        for image in light(shown, Lattice.SQUARE):
            seen = 20 + 200 * map_coordinates(gaussian_filter(image, 0.6), [v, u], order=1)
            noisy = seen + 5.0 * random.standard_normal(seen.shape)  # 0.05 of the modulation
            frames.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
        decoded = decode(Recording(tuple(frames), shown, SIZE, 8, "frames"))
        valid = np.isfinite(decoded.u)
        assert valid.mean() > 0.98
        spread.append(np.std((decoded.u - u)[valid]))
        stated.append(np.sqrt(np.mean(decoded.sigma[valid] ** 2)))
    assert spread[1] / spread[0] < 1.1
    assert spread[1] / stated[1] == pytest.approx(1.0, abs=0.05)
