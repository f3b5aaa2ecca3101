"""The identities that encoding and decoding rest on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.core.conventions import (
    Axis,
    Lattice,
    axis_length,
    full_scale,
    mirror_centres,
    phase_of_coordinate,
    phase_steps,
    raw_dtype,
    raw_per_grey,
)

STRIPES = st.floats(0.1, 500.0)
LENGTHS = st.integers(2, 4000)


@given(STRIPES, LENGTHS)
def test_the_image_spans_its_stripes_from_edge_to_edge(stripes: float, length: int) -> None:
    """Pixel (0, 0) is a centre, so the edges lie half a pixel outside the first and the last."""
    edges = phase_of_coordinate(np.array([-0.5, length - 0.5]), stripes, length)
    np.testing.assert_allclose(edges, [0.0, 2 * np.pi * stripes], rtol=1e-12)


def test_a_period_in_pixels() -> None:
    np.testing.assert_allclose(
        phase_of_coordinate(np.array([3.5, 11.5]), 8, 64), [np.pi, 3 * np.pi], rtol=1e-15
    )


@pytest.mark.parametrize("steps", [3, 4, 12, 37])
def test_steps_share_one_turn_evenly(steps: int) -> None:
    shifts = phase_steps(steps)
    assert shifts.shape == (steps,)
    assert shifts[0] == 0.0
    np.testing.assert_allclose(np.diff(shifts), 2 * np.pi / steps, rtol=1e-12)
    assert abs(np.exp(1j * shifts).sum()) < 1e-13 * steps


@given(st.integers(3, 40), st.floats(0.0, 2 * np.pi, exclude_max=True), st.floats(1.0, 100.0))
def test_the_steps_give_back_the_phase(steps: int, phase: float, amplitude: float) -> None:
    """S = (N/2) B sin φ and C = (N/2) B cos φ for I_n = A + B cos(φ - δ_n)."""
    shifts = phase_steps(steps)
    images = 128.0 + amplitude * np.cos(phase - shifts)
    s, c = images @ np.sin(shifts), images @ np.cos(shifts)
    np.testing.assert_allclose(2 / steps * np.hypot(s, c), amplitude, rtol=1e-9)
    assert abs(np.angle(np.exp(1j * (np.arctan2(s, c) - phase)))) < 1e-9 * (1 + 128 / amplitude)


def test_mirrors_of_a_square_lattice_lie_on_their_indices() -> None:
    u, v = mirror_centres((3, 2), Lattice.SQUARE)
    np.testing.assert_array_equal(u, [[0, 1, 2], [0, 1, 2]])
    np.testing.assert_array_equal(v, [[0, 0, 0], [1, 1, 1]])


def test_odd_rows_of_a_diamond_lattice_are_shifted_by_half_a_column() -> None:
    u, v = mirror_centres((3, 3), Lattice.DIAMOND)
    np.testing.assert_array_equal(u, [[0.0, 1.0, 2.0], [0.5, 1.5, 2.5], [0.0, 1.0, 2.0]])
    np.testing.assert_array_equal(v, [[0, 0, 0], [1, 1, 1], [2, 2, 2]])


@pytest.mark.parametrize(("axis", "length"), [("x", 912), ("y", 1140)])
def test_sizes_are_width_by_height(axis: Axis, length: int) -> None:
    assert axis_length((912, 1140), axis) == length
    u, v = mirror_centres((912, 1140), Lattice.SQUARE)
    assert u.shape == v.shape == (1140, 912)


@pytest.mark.parametrize(("bits", "width"), [(1, 8), (8, 8), (9, 16), (12, 16), (16, 16)])
def test_a_depth_has_its_greatest_integer_and_a_type_that_holds_it(bits: int, width: int) -> None:
    assert np.binary_repr(full_scale(bits)) == bits * "1"
    assert raw_dtype(bits) == np.dtype(f"uint{width}")


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_the_integers_of_any_depth_make_256_greys(bits: int) -> None:
    assert full_scale(bits) // raw_per_grey(bits) == 255
    assert (full_scale(bits) + 1) % raw_per_grey(bits) == 0
