"""Orders that an object's own light changes are not kept, though each such pixel looks perfect by itself."""

from __future__ import annotations

import numpy as np
import pytest

from fpplab.phase import decode
from tests.phase.test_bent_phases import SIZE, WIDTH, bent

PERIOD_RAD = 2 * np.pi / 64
"""Bias of a set of one stripe by one period of 64."""
V, U = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
CENTRE = np.hypot(V - 80, U - 120)
BIASES = {
    "blob": 1.3 * np.exp(-((CENTRE / 40) ** 2)),
    "disc": 0.94 * (CENTRE < 40),
    "ramp": np.where((abs(V - 80) < 50) & (abs(U - 120) < 60), (U - 60) / 75, 0.0),
    "everywhere": (U - 120) / 100,
}


@pytest.mark.parametrize("kind", BIASES)
def test_orders_that_a_biased_set_changes_are_left_out(kind: str) -> None:
    recording, truth = bent([(1, 12), (64, 12)], 1.0, seed=len(kind), bias_rad=PERIOD_RAD * BIASES[kind])
    decoded = decode(recording)
    wrong = np.abs(decoded.u - truth) > 0.5 * WIDTH / 64
    assert wrong.sum() <= 1e-4 * wrong.size
    assert decoded.uncertain_order is not None
    assert not decoded.valid[decoded.uncertain_order > 0].any()
    assert (decoded.uncertain_order > 0).mean() > 0.05
    if kind != "everywhere":
        assert decoded.valid[:6].all()


@pytest.mark.parametrize("stripes", [(1, 64), (1, 7.3, 50)])
def test_a_bias_that_changes_no_order_costs_nothing(stripes: tuple[float, ...]) -> None:
    bias = 0.1 * 2 * np.pi / (stripes[1] / stripes[0]) * BIASES["blob"]
    recording, truth = bent([(s, 12) for s in stripes], 1.0, seed=3, bias_rad=bias)
    decoded = decode(recording)
    assert decoded.valid.mean() > 0.999
    assert np.nanmax(np.abs(decoded.u - truth)) < 1.0


@pytest.mark.parametrize(("shift_px", "is_whole"), [(11, False), (35, True)])
def test_edges_in_depth_cost_nothing(shift_px: int, is_whole: bool) -> None:
    """Jumps of the coordinate are no orders where the sets agree, not even those by whole periods."""
    recording, truth = bent([(1, 12), (64, 12)], 1.0, seed=4)
    for frame in recording.frames:
        frame[50:110, 80:160] = frame[50:110, 80 + shift_px : 160 + shift_px].copy()
    jumps = (truth[80, 80 + shift_px] - truth[80, 80]) * 64 / WIDTH
    assert (abs(jumps - round(jumps)) < 0.1) == is_whole
    assert decode(recording).valid.mean() > 0.999
