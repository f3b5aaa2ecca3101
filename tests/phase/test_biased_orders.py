"""Orders that an object's own light changes are not kept, though each such pixel looks perfect by itself."""

import numpy as np
import pytest

from fpplab.phase import decode
from fpplab.phase.biased_orders import mark_biased_orders
from tests.phase.test_bent_phases import SIZE, WIDTH, bent

V, U = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
CENTRE = np.hypot(V - 80, U - 120)
BIASES = {  # of the widest set, in periods of the next one
    "blob": 1.3 * np.exp(-((CENTRE / 40) ** 2)),
    "band": 1.1 * np.exp(-(((V - 80) / 12) ** 2)),
    "disc": 0.94 * (CENTRE < 40),
    "ramp": np.where((abs(V - 80) < 50) & (abs(U - 120) < 60), (U - 60) / 75, 0.0),
    "everywhere": (U - 120) / 100,
}


@pytest.mark.parametrize("kind", BIASES)
@pytest.mark.parametrize("stripes", [(1, 64), (1, 8, 64)])
def test_orders_that_a_biased_set_changes_are_left_out(stripes: tuple[float, ...], kind: str) -> None:
    bias_rad = 2 * np.pi / stripes[1] * BIASES[kind]
    recording, truth = bent([(s, 12) for s in stripes], 1.0, seed=len(kind), bias_rad=bias_rad)
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
    bias_rad = 0.1 * 2 * np.pi / (stripes[1] / stripes[0]) * BIASES["blob"]
    recording, truth = bent([(s, 12) for s in stripes], 1.0, seed=3, bias_rad=bias_rad)
    decoded = decode(recording)
    assert decoded.valid.mean() > 0.999
    assert np.nanmax(np.abs(decoded.u - truth)) < 1.0


@pytest.mark.parametrize(("shift_px", "is_whole"), [(11, False), (35, True)])
def test_edges_in_depth_cost_nothing(shift_px: int, is_whole: bool) -> None:
    """A jump of orders is whole, and changes how the sets contradict each other."""
    bias_rad = 0.0 if is_whole else 2 * np.pi / 64 * 0.15 * (U > 120)
    recording, truth = bent([(1, 12), (64, 12)], 1.0, seed=4, bias_rad=bias_rad)
    for frame in recording.frames:
        frame[50:110, 80:160] = frame[50:110, 80 + shift_px : 160 + shift_px].copy()
    jumps = (truth[80, 80 + shift_px] - truth[80, 80]) * 64 / WIDTH
    assert (abs(jumps - round(jumps)) < 0.1) == is_whole
    assert decode(recording).valid.mean() > 0.999


@pytest.mark.parametrize(
    ("gap", "change", "is_one_of_orders"),
    [(0.0, 0.06, True), (0.0, 0.02, False), (0.02, 0.06, False), (0.02, 0.9, True), (0.05, 0.9, False)],
)
def test_a_border_is_one_of_orders_where_only_contradictions_change(gap, change, is_one_of_orders) -> None:
    """Both in periods, which are 10 px here."""
    inside = (abs(V - 40) < 20) & (abs(U - 120) < 20)
    coordinate = (U + 0.1 * V + 10.0 * (1.0 + gap) * inside).astype(np.float32)
    sigma, cause = np.zeros(SIZE, np.float32), np.zeros(SIZE, np.uint8)
    mark_biased_orders(
        coordinate, sigma, cause, max_sigma=1.0, mark=3, period=10.0, widest=640.0,
        contradiction=lambda pixels: change * inside.ravel()[pixels],
    )  # fmt: skip
    np.testing.assert_array_equal(cause, 3 * inside if is_one_of_orders else 0)
