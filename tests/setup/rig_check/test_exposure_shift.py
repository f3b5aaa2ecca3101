"""Shifts of triggered exposures, from levels mixed by hand."""

import numpy as np
import pytest

from fpplab.core.conventions import Floats
from fpplab.setup.rig_check.exposure_shift import ExposureShift, find_exposure_shift
from fpplab.setup.rig_check.marker import marker

OWN = 0.05 + 0.8 * (marker() / 255.0) ** 2.2


def mixed(share: float, step: int, dark: float = 0.0, noise: float = 0.0) -> Floats:
    """Exposures of which `share` sees a neighbour and `dark` the darkness between."""
    levels = (1 - share - dark) * OWN + share * np.roll(OWN, -step) + dark * 0.05
    levels[-1 if step > 0 else 0] = (1 - share) * OWN[-1 if step > 0 else 0] + share * 0.05
    return levels + np.random.default_rng(1).normal(0.0, noise, len(levels))


@pytest.mark.parametrize("share", [0.05, 0.25, 0.6])
@pytest.mark.parametrize(("step", "is_late"), [(1, True), (-1, False)])
def test_a_share_of_the_neighbour(share: float, step: int, is_late: bool) -> None:
    found = find_exposure_shift(OWN, mixed(share, step, dark=0.02, noise=0.002))
    assert found is not None
    assert found.is_late is is_late
    assert found.share == pytest.approx(share, abs=0.03)


def test_frames_of_their_own_patterns_are_not_shifted() -> None:
    assert find_exposure_shift(OWN, OWN) is None
    assert find_exposure_shift(OWN, mixed(0.0, 1, noise=0.003)) is None


def test_other_faults_are_no_shift() -> None:
    doubled = np.concatenate([OWN[:5], OWN[4:-1]])
    assert find_exposure_shift(OWN, np.roll(OWN, 1)) is None
    assert find_exposure_shift(OWN, mixed(0.97, 1)) is None, "nearly all of it is the neighbour: a slip"
    assert find_exposure_shift(OWN, doubled) is None
    assert find_exposure_shift(OWN, np.random.default_rng(2).uniform(0, 1, len(OWN))) is None
    assert find_exposure_shift(OWN, np.where(np.arange(len(OWN)) < 6, OWN, np.nan)) is None


def test_a_bare_shift_is_given_as_it_is() -> None:
    assert find_exposure_shift(OWN, mixed(0.5, 1)) == ExposureShift(True, pytest.approx(0.5, abs=1e-9))
