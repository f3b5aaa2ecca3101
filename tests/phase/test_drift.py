"""A picture that walks during a scan is measured, stated and named; vibration and flicker are no drift."""

import numpy as np
import pytest

from benchmarks.drift import place_of_scan
from fpplab.patterns.plan import Plan
from fpplab.phase.drift import PointingDrift, can_show_drift, phase_ramp, ramp_error_rad
from fpplab.phase.error_model import error_model_of
from tests.diagnosis.scenes import Bench, plan_of

SEED = 8


def test_the_error_of_a_ramp_is_that_of_its_demodulation() -> None:
    fringe = Plan.load("plan_paper").fringes[2]
    shift, ramp = fringe.phase_shifts(), phase_ramp(PointingDrift(0.05, 0.001, 30.0), fringe, 912)
    np.testing.assert_allclose(ramp, 2 * np.pi * 64 / 912 * 0.05 * (np.arange(12) - 5.5))
    phase = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    images = np.cos(phase[:, None] + ramp - shift)
    off = np.angle((images @ np.exp(1j * shift)) * np.exp(-1j * phase))
    assert ramp_error_rad(ramp, fringe) == pytest.approx(float(np.std(off)), rel=0.02)


def test_a_plan_tells_whether_it_can_show_drift() -> None:
    plans = (Plan.load("plan_scan"), Plan.load("plan_six_images"), plan_of(steps=(4, 4, 4)))
    assert [can_show_drift(plan) for plan in plans] == [True, False, False]
    assert can_show_drift(plan_of(stripes=(64, 8, 64), steps=(3, 3, 3)))


@pytest.mark.whole
@pytest.mark.parametrize("steps", [(6, 6, 12), (8, 8, 8)])
def test_it_is_measured(steps: tuple[int, ...]) -> None:
    bench = Bench(plan_of(steps=steps), seed=SEED, drift_px=-0.3, warms=0.05, gamma=1.3)
    drift = error_model_of(bench.recording()).drifts["x"]
    assert drift.px_per_frame == pytest.approx(-0.3 / (sum(steps) - 1), rel=0.08)
    assert drift.shift_px == pytest.approx(drift.px_per_frame * (sum(steps[:2]) + (steps[2] - 1) / 2))


@pytest.mark.whole
def test_a_repeated_set_shows_it_where_three_steps_do_not() -> None:
    for stripes, steps, found in (((1, 8, 64), (3, 3, 3), 0), ((64, 1, 8, 64), (3, 3, 3, 3), 1)):
        bench = Bench(plan_of(steps=steps, stripes=stripes), seed=SEED, drift_px=0.5)
        drifts = error_model_of(bench.recording()).drifts
        assert len(drifts) == found
    assert drifts["x"].px_per_frame == pytest.approx(0.5 / 11, rel=0.03)
    assert drifts["x"].shift_px == pytest.approx(0.25, rel=0.03)


@pytest.mark.whole
@pytest.mark.parametrize("fault", [{}, {"moves_px": 0.1}, {"flicker": 0.03}, {"gamma": 1.6}, {"warms": 0.05}])
def test_nothing_else_is_drift(fault: dict[str, float]) -> None:
    assert not error_model_of(Bench(seed=SEED, **fault).recording()).drifts


@pytest.mark.whole
def test_it_is_stated_and_named() -> None:
    actual, stated, named = place_of_scan(True, SEED)
    assert named == ["projector_drift"]
    assert 0.4 < stated / actual < 2.5
    at_rest = place_of_scan(False, SEED)
    assert at_rest[2] == []
    assert stated > 2.0 * at_rest[1] > 0.0
