"""What a single step concludes from the frames that it has taken."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fpplab.devices.rig import Rig
from fpplab.setup.rig_check.marker import marker
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


def test_rows_that_begin_long_after_the_pattern_do_not_count() -> None:
    """Under a rolling shutter rows that begin later see the next pattern."""
    camera = SimpleNamespace(caps=SimpleNamespace(readout_s=0.01))
    steps = _Steps(cast(Rig, SimpleNamespace(camera=camera)), PLAN)
    rows, greys = 200, marker() / marker().max()
    steps._change = np.full((rows, 3), 0.5)
    steps._change[:20] = 0.0  # no light falls there
    frames = np.repeat(greys[:, None, None], rows, axis=1) * np.full((1, 1, 3), 0.5)
    noise = np.random.default_rng(1).normal(0, 0.02, len(greys))[:, None]
    frames[:, 20] += noise  # which all rows that count lessen together
    frames[:, 21] -= noise
    frames[:, 20 + round(LIMITS.max_unseen * rows) + 1 :] = 0.5 * np.roll(greys, 1)[:, None, None]
    np.testing.assert_allclose(steps._greys(frames), greys, atol=1e-12)


@pytest.mark.parametrize(("short", "long", "ok"), [(0.5, 1.0, True), (1.0, 1.0, False), (0.05, 0.2, False)])
def test_of_several_exposures_the_shortest_must_not_saturate_and_the_longest_not_be_dark(
    monkeypatch: pytest.MonkeyPatch, short: float, long: float, ok: bool
) -> None:
    plan = PLAN.model_copy(update={"exposures_s": (0.08, 0.002, 0.02)})
    steps, levels = _Steps(cast(Rig, None), plan), {0.002: short, 0.08: long}
    steps._white = steps._change = np.full((1, 100), 0.8)

    def taken(_: _Steps, patterns: Any, trigger: str, *, exposure_s: float) -> Any:
        return np.full((1, 1, 100), levels[exposure_s])

    monkeypatch.setattr(_Steps, "_take_samples", taken)
    monkeypatch.setattr(_Steps, "_uniform", lambda *_: [])
    assert steps.exposure().ok is ok
