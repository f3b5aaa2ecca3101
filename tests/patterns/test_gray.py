"""Gray code: words of neighbouring cells, orders of images, and limits."""

import numpy as np
import pytest

from fpplab.patterns.fringe_sets.gray import Gray


def words(code: Gray, length: int) -> np.ndarray:  # type: ignore[type-arg]
    return np.array([code.light(k, np.arange(length, dtype=np.float64), length) for k in range(code.images)])


def test_neighbouring_cells_differ_in_one_bit_and_no_two_are_equal() -> None:
    bits = words(Gray(axis="x", bits=5), 32)
    assert (np.abs(np.diff(bits, axis=1)).sum(axis=0) == 1).all()
    assert len(np.unique(bits, axis=1).T) == 32
    np.testing.assert_array_equal(bits[0], np.arange(32) >= 16)  # the coarsest first
    wide = words(Gray(axis="x", bits=5, cell_px=3.0), 96)
    np.testing.assert_array_equal(wide, np.repeat(bits, 3, axis=1))
    late = words(Gray(axis="x", bits=5, first_cell=4), 20)
    np.testing.assert_array_equal(late, bits[:, 4:24])
    reverse = words(Gray(axis="x", bits=5, least_first=True), 32)
    np.testing.assert_array_equal(reverse, bits[::-1])


@pytest.mark.parametrize(
    ("inverses", "own", "inverted"),
    [("each", slice(0, None, 2), slice(1, None, 2)), ("after", slice(0, 5), slice(5, None))],
)
def test_inverses_show_the_opposite_of_their_own_image(inverses: str, own: slice, inverted: slice) -> None:
    code = Gray.model_validate({"axis": "x", "bits": 5, "inverses": inverses})
    bits = words(code, 32)
    np.testing.assert_array_equal(bits[own], words(Gray(axis="x", bits=5), 32))
    np.testing.assert_array_equal(bits[inverted], 1 - bits[own])
    waves = code.waves(1)
    np.testing.assert_array_equal(waves[inverted], -waves[own])


def test_cells_that_the_bits_cannot_number_are_refused() -> None:
    assert Gray(axis="x", bits=10).fault(1024) is None
    assert "1025 cells of 1 px need at least 11" in str(Gray(axis="x", bits=10).fault(1025))
    assert "needs" not in str(Gray(axis="x", bits=10, cell_px=2.0).fault(1824))
    assert "at least one pixel" in str(Gray(axis="x", bits=10, cell_px=0.5).fault(100))


@pytest.mark.parametrize("inverses", ["none", "each", "after"])
def test_the_other_order_is_that_of_the_finest_bit_first(inverses: str) -> None:
    code, other = (
        Gray.model_validate({"axis": "x", "bits": 5, "inverses": inverses, "least_first": first})
        for first in (False, True)
    )
    ((meaning, order),) = code.other_orders()
    assert "least_first: true" in meaning
    np.testing.assert_array_equal(words(other, 32), words(code, 32)[order])
