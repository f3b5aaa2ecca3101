"""How far a board moved, against images that were moved by a known distance."""

import numpy as np
import pytest
from numpy.typing import NDArray

from fpplab.characterisation.observation import board_shift_px


def squares(shift_px: tuple[float, float], noise: float, seed: int) -> NDArray[np.uint8]:
    """Draw blurred squares of 24 px, moved, with noise."""
    v, u = np.mgrid[0:360, 0:480].astype(np.float64)
    waves = np.sin(np.pi * (u - shift_px[0]) / 24) * np.sin(np.pi * (v - shift_px[1]) / 24)
    noisy = 125 + 75 * np.tanh(8 * waves) + np.random.default_rng(seed).normal(0.0, noise, u.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


@pytest.mark.parametrize("shift_px", [(0.0, 0.0), (0.3, 0.0), (-0.4, 1.2)])
def test_a_known_motion_is_measured(shift_px: tuple[float, float]) -> None:
    corners = np.stack(np.meshgrid(np.arange(48, 433, 24), np.arange(48, 313, 24)), axis=-1).reshape(-1, 2)
    measured = board_shift_px(squares((0, 0), 1.0, 1), squares(shift_px, 1.0, 2), corners)
    assert measured is not None
    assert abs(measured - np.hypot(*shift_px)) < 0.02


def test_a_board_out_of_sight_has_no_motion() -> None:
    dark = np.zeros((360, 480), np.uint8)
    assert board_shift_px(dark, dark, np.array([[900.0, 900.0]])) is None
