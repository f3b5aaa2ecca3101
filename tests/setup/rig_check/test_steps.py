"""What a single step concludes from the frames that it has taken."""

from typing import cast

import numpy as np
import pytest

from fpplab.devices.rig import Rig
from fpplab.setup.rig_check.steps import LIMITS, _Steps
from tests.support.recorded import PLAN


@pytest.mark.parametrize(("grey", "level"), [(0.4, 0.6), (0.39, 0.8)])
def test_the_level_is_of_pixels_at_least_half_as_bright_as_the_brightest(grey: float, level: float) -> None:
    steps = _Steps(cast(Rig, None), PLAN)
    steps._white = np.repeat([[0.8, grey, 0.1]], [200, 200, 100], axis=1)
    steps._change = steps._white
    found = steps.exposure()
    assert found.values["level"] == pytest.approx(level)
    assert found.ok == (LIMITS.min_level <= level <= LIMITS.max_level)
