"""A bent response is found before the plan is judged, and taken out of phases and images."""

import numpy as np
import pytest

from fpplab.core.conventions import TWO_PI, Floats, phase_steps
from fpplab.diagnosis.plan.bend import Bend, fitted_bends
from fpplab.diagnosis.plan.limits import PlanCheckLimits

PHASES = TWO_PI * (np.arange(4000) * 0.618034 % 1.0)


def bent_levels(steps: int, gamma: float, phases: Floats = PHASES) -> Floats:
    light = 0.5 + 0.5 * np.cos(phases - phase_steps(steps)[:, None])
    return np.asarray(20.0 + 180.0 * light**gamma)


def error_rad(levels: Floats) -> float:
    phasors = np.sum(np.exp(1j * phase_steps(len(levels)))[:, None] * levels, axis=0)
    return float(np.abs(np.angle(phasors * np.exp(-1j * PHASES))).max())


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
@pytest.mark.parametrize("gamma", [0.6, 1.3, 1.8, 2.2])
def test_a_power_law_is_found_and_taken_out(steps: int, gamma: float) -> None:
    levels = bent_levels(steps, gamma)
    bends = fitted_bends([levels], PlanCheckLimits())
    assert bends is not None
    assert bends[0].exponent == pytest.approx(gamma, abs=0.03)
    assert error_rad(Bend(gamma).straightened_levels(levels)) < 5e-3


def test_a_straight_response_and_few_phases_show_none() -> None:
    assert fitted_bends([bent_levels(3, 1.0), bent_levels(4, 1.0)], PlanCheckLimits()) is None
    assert fitted_bends([bent_levels(3, 2.0, 0.3 * PHASES)], PlanCheckLimits()) is None


def test_a_set_that_shows_no_bend_takes_that_of_the_widest_fringes() -> None:
    sets = [bent_levels(3, 2.0, 0.3 * PHASES), bent_levels(3, 1.8), bent_levels(3, 1.4)]
    bends = fitted_bends(sets, PlanCheckLimits())
    assert bends is not None
    assert [bend.exponent for bend in bends] == pytest.approx([1.8, 1.8, 1.4], abs=0.03)
