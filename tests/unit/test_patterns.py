"""Patterns show what the conventions say, on both lattices, at every bit depth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.conventions import Lattice
from fpplab.errors import ConfigError
from fpplab.patterns import fringe_level, make_patterns, quantise, uniform_patterns
from fpplab.plan import FringeSet, Plan

SIZE = (48, 20)


@given(
    axis=st.sampled_from(["x", "y"]),
    lattice=st.sampled_from(list(Lattice)),
    stripes=st.floats(0.5, 10.0),
    steps=st.integers(3, 12),
    sign=st.sampled_from([1, -1]),
    origin=st.floats(-10, 10),
    data=st.data(),
)
def test_a_mirror_shows_the_cosine_of_its_own_place(axis, lattice, stripes, steps, sign, origin, data):
    fringe = FringeSet(axis=axis, stripes=stripes, steps=steps, shift_sign=sign, phase_origin_rad=origin)
    n, i, j = (data.draw(st.integers(0, limit - 1)) for limit in (steps, SIZE[0], SIZE[1]))
    u = i + 0.5 * (j % 2) if lattice is Lattice.DIAMOND else i
    place, length = (u, SIZE[0]) if axis == "x" else (j, SIZE[1])
    phase = 2 * np.pi * stripes * (place + 0.5) / length + origin - sign * 2 * np.pi * n / steps
    level = fringe_level(fringe, n, SIZE, lattice)
    assert level.shape == (SIZE[1], SIZE[0])
    assert level[j, i] == pytest.approx(0.5 + 0.5 * np.cos(phase), abs=1e-9)


@pytest.mark.parametrize("depth", range(1, 9))
def test_quantising_rounds_to_the_greys_of_the_depth(depth):
    level = np.linspace(0, 1, 1001)
    shown = quantise(level, depth)
    assert shown.dtype == np.uint8
    assert len(np.unique(shown)) == 2**depth
    assert {shown[0], shown[-1]} == {0, 255}
    half_a_grey = 0.5 * 255 / (2**depth - 1)
    assert np.abs(shown - 255 * level).max() <= half_a_grey + 0.5


def test_patterns_come_in_the_plans_order_under_telling_names():
    plan = Plan(fringes=(FringeSet(axis="y", stripes=8, steps=4), FringeSet(axis="x", stripes=1.5, steps=3)))
    patterns = make_patterns(plan, SIZE, Lattice.SQUARE)
    assert [p.id for p in patterns] == [
        *(f"00-y-8-{n:03d}of4" for n in range(4)),
        *(f"01-x-1.5-{n:03d}of3" for n in range(3)),
    ]
    for (index, step, _), pattern in zip(plan.steps(), patterns, strict=True):
        level = fringe_level(plan.fringes[index], step, SIZE, Lattice.SQUARE)
        np.testing.assert_array_equal(pattern.image, np.rint(255 * level))


def test_stripes_finer_than_two_pixels_are_refused():
    plan = Plan(fringes=(FringeSet(axis="y", stripes=11, steps=4),))
    with pytest.raises(
        ConfigError, match=r"'fringes\[0\].stripes' is 11: more than half .* 20 pixels along y"
    ):
        make_patterns(plan, SIZE, Lattice.SQUARE)


def test_uniform_images_are_uniform():
    patterns = uniform_patterns([0, 7, 255], SIZE)
    assert [p.id for p in patterns] == ["grey-000", "grey-007", "grey-255"]
    for pattern, grey in zip(patterns, (0, 7, 255), strict=True):
        np.testing.assert_array_equal(pattern.image, np.full((SIZE[1], SIZE[0]), grey))
