"""What is said of light from outside of the possible positions."""

import numpy as np
import pytest

from fpplab.phase import decode
from fpplab.phase.bounds import PossibleCoordinates
from tests.phase.test_fusion import WIDTH
from tests.phase.test_wrong_order import limited, noisy


def moved(bounds: dict, px: float, pixels: np.ndarray) -> dict:
    """Intervals that lie elsewhere at some pixels."""
    ends = (bounds["x"].lower, bounds["x"].upper)
    return {
        "x": PossibleCoordinates(*(np.where(pixels, np.clip(e + px, -0.5, WIDTH - 0.5), e) for e in ends))
    }


@pytest.mark.parametrize("stripes", [(12.0, 45.0, 167.0), (59.0, 64.0, 70.0)])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_share_outside_is_found(stripes: tuple[float, ...], share: float) -> None:
    recording, truth, bounds = noisy(stripes, (4, 4, 4), "guided", 40.0, seed=51)
    assert bounds is not None
    outside = np.random.default_rng(52).random(truth.shape) < share
    # Where the interval would leave the projector, it stays as it is.
    outside &= truth < WIDTH - 150
    found = decode(limited(recording, 1e-4), bounds=moved(bounds, 80.0, outside)).outside
    assert found is not None
    # 1000 pixels are examined: four standard deviations, and orders that fit by chance.
    assert found.share_outside_depth_range == pytest.approx(outside.mean(), abs=0.06)
    assert any("probably lies outside" in one for one in found.warnings()) == (share > 0)


def test_sets_that_repeat_themselves_cannot_tell() -> None:
    recording, _, bounds = noisy((10.0, 100.0), (4, 4), "guided", 40.0, seed=53)
    found = decode(limited(recording, 1e-4), bounds=bounds).outside
    assert found is not None
    assert found.share_on_both_sides > 0.95
    assert found.share_outside_depth_range < 0.01
    assert any("decoded wrongly, unnoticed" in one for one in found.warnings())


def test_nothing_is_said_without_intervals_or_without_fringes() -> None:
    recording, _, _ = noisy((1.0, 8.0, 64.0), (3, 3, 3), "hierarchical", 20.0, seed=54)
    assert decode(recording).outside is None
    dim, _, bounds = noisy((12.0, 45.0, 167.0), (3, 3, 3), "guided", 1.0, seed=55)
    assert decode(dim, bounds=bounds).outside is None
