"""The depth of grey levels, by the levels that occur."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from fpplab.core.conventions import full_scale
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import ignore
from fpplab.sessions.grey_depth import StoredLevels, check_bits

Stored = Callable[[NDArray[np.int64], int], NDArray[np.int64]]

WAYS: dict[str, Stored] = {
    "shifted": lambda own, bits: own << 16 - bits,
    "repeated": lambda own, bits: (own << 16 - bits) | (own >> max(2 * bits - 16, 0)),
    "scaled": lambda own, bits: np.rint(own * 65535 / full_scale(bits)).astype(np.int64),
}


def noisy(bits: int, brightest: float, seed: int) -> NDArray[np.int64]:
    """Fringes with noise, in a camera's own grey levels."""
    random = np.random.default_rng([3, seed, bits])
    level = full_scale(bits) * brightest * (0.5 + 0.45 * np.cos(np.arange(20000) / 9.0))
    return np.clip(np.rint(random.normal(level, full_scale(bits) / 300)), 0, full_scale(bits)).astype(
        np.int64
    )


def of(*stored: NDArray[np.int64]) -> StoredLevels:
    found = StoredLevels()
    for k, one in enumerate(stored):
        found.add(one.astype(np.uint16).reshape(100, -1), f"image {k}")
    return found


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("seed", range(3))
def test_levels_in_the_upper_bits_are_found_and_moved(bits: int, way: str, seed: int) -> None:
    own = noisy(bits, 0.9, seed)
    stored = WAYS[way](own, bits)
    said: list[str] = []
    depth, shift = of(stored).depth(None, ignore, said.append)
    assert (depth, shift) == (bits, 16 - bits)
    np.testing.assert_array_equal(stored >> shift, own)
    assert said == [
        f"the images hold {bits} bits, in the upper bits of 16; they were moved to the lower ones"
    ]
    assert of(stored).depth(bits, ignore, ignore) == (bits, 16 - bits)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
@pytest.mark.parametrize("seed", range(3))
def test_levels_in_the_lower_bits_are_confirmed_or_asked_for(bits: int, seed: int) -> None:
    own = noisy(bits, 0.7, seed)
    warned: list[str] = []
    assert of(own).depth(bits, warned.append, ignore) == (bits, 0)
    assert warned == []
    if bits < 16:
        with pytest.raises(ConfigError, match=rf"--bits is missing: .* \(image 0\), .* has {bits}\b"):
            of(own).depth(None, ignore, ignore)
        with pytest.raises(DataError, match=r"image 0: has a grey level of \d+, more than 8 bits hold"):
            of(own).depth(8, ignore, ignore)
    else:
        assert of(own).depth(None, ignore, ignore) == (16, 0)


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_saturated_levels_tell_the_depth(bits: int) -> None:
    said: list[str] = []
    assert of(noisy(bits, 1.3, 0)).depth(None, ignore, said.append) == (bits, 0)
    assert said == [f"the grey levels reach {full_scale(bits)}: {bits} bits"]
    warned: list[str] = []
    of(noisy(bits, 1.3, 0)).depth(16, warned.append, ignore)
    assert len(warned) == 1
    assert f"with --bits {bits} saturated pixels are recognised" in warned[0]


def test_few_levels_tell_nothing() -> None:
    few = np.repeat(np.arange(20) * 256, 100)
    with pytest.raises(ConfigError, match=r"reach 4864 \(image 1\), so that the camera has 14 or 16 bits"):
        of(few // 2, few).depth(None, ignore, ignore)


@pytest.mark.parametrize("bits", [0, 7, 9, 17, 32])
def test_depths_that_no_images_have(bits: int) -> None:
    with pytest.raises(ConfigError, match=f"--bits is {bits}: one of 8, 10, 12, 14, 16"):
        check_bits(bits)
