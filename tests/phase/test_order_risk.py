"""The risk of a wrong order that noise alone brings bounds how often it comes, and not much too widely."""

import numpy as np
import pytest

from fpplab.phase import decode
from fpplab.phase.bounds import widest_interval_share
from fpplab.phase.order_risk import order_risk
from tests.phase.test_fusion import WIDTH
from tests.phase.test_wrong_order import HEIGHT, case, limited, noisy, wrong


@case
def test_the_risk_bounds_the_frequency(stripes, steps, unwrapping, ratio) -> None:
    recording, truth, bounds = noisy(stripes, steps, unwrapping, ratio, seed=43)
    decoded = decode(limited(recording, 1.0), bounds=bounds)
    size = (WIDTH, HEIGHT)
    risk = order_risk(
        decoded, recording.plan, size, {"x": widest_interval_share(bounds, "x", size)} if bounds else None
    )
    assert np.array_equal(np.isfinite(risk), decoded.valid)
    assert np.nanmax(risk) <= 1.0
    expected, seen = float(np.nansum(risk)), (wrong(decoded.u, truth, recording.plan) & decoded.valid).sum()
    spread = 4 * np.sqrt(expected)
    assert seen - spread < expected < 3.5 * seen + spread


def test_pixels_of_more_noise_risk_more() -> None:
    quiet, loud = (noisy((1.0, 8.0, 64.0), (4, 4, 4), "hierarchical", ratio, 44)[0] for ratio in (40.0, 8.0))
    risks = [order_risk(decode(one), one.plan, (WIDTH, HEIGHT)) for one in (quiet, loud)]
    assert np.nanmedian(risks[0]) < 1e-12
    assert np.nanmedian(risks[1]) > 1e-6
    assert np.nanmax(risks[0]) == pytest.approx(0.0, abs=1e-9)
