"""A lens whose scale differs between poses is told from noise and from a board that moved."""

import numpy as np
import pytest

from fpplab.characterisation.bundle import _residual_to_expected_ratio
from fpplab.characterisation.lens import has_focus_breathing
from fpplab.characterisation.parameters import BundleSettings
from tests.support.breathing_lens import breathing, fitted, scales


@pytest.mark.whole
def test_a_lens_that_breathes_is_named_and_a_locked_one_is_not() -> None:
    grown = 5e-4 * np.random.default_rng(21).standard_normal(9)
    found, sigmas = scales(fitted(breathing(5e-4, 21)))
    assert has_focus_breathing(found, sigmas)
    assert np.corrcoef(found, grown)[0, 1] > 0.5, "larger images are told as larger"
    still, sigmas = scales(fitted(breathing(0.0, 22)))
    assert not has_focus_breathing(still, sigmas)
    assert np.abs(still / sigmas).max() < 4.0


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [1002, 1006])
def test_much_breathing_is_named_although_it_looks_like_motion_of_the_poses(seed: int) -> None:
    """What the points of a pose share is so great here that the own noise was taken for nothing."""
    assert has_focus_breathing(*scales(fitted(breathing(8.5e-4, seed))))


def test_noise_that_was_taken_too_small_grows_again() -> None:
    """Residuals beyond the clip tell of it even where motion of the poses could explain all of them."""
    residuals = np.random.default_rng(3).normal(0.0, 50.0, 900)
    assert _residual_to_expected_ratio(residuals, 800.0, leaked=1e9, settings=BundleSettings()) > 3.0


def test_one_pose_alone_is_no_lens() -> None:
    off = np.zeros(9)
    off[4] = 1e-3
    assert not has_focus_breathing(off, np.full(9, 3e-5))
