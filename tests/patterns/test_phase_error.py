"""Phase errors of a distorted sinusoid, against closed forms and against decoded fringes."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import gammaln

from fpplab.core.conventions import TWO_PI, phase_steps
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.limits import PATTERN_LIMITS
from fpplab.patterns.phase_error import (
    harmonics,
    judge_response,
    least_steps,
    phase_error,
    relative_harmonics,
    shown_phase_error,
)
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response
from fpplab.phase import wrapped_phase

SIZE = (912, 1140)
GREYS = np.arange(256) / 255
"""Grey levels that can be shown."""


def law(g: float) -> Curve:
    return Curve(a=0.7, b=0.05, g=g)


def response(g: float, sigma: float = 0.001) -> Response:
    return Response(a=0.7, b=0.05, g=g, sigma=(0.001, 0.001, sigma), residual=0.0, levels=16)


def plan(steps: int = 3, **fields: Any) -> Plan:
    return Plan(fringes=(Sinusoid(axis="x", stripes=64, steps=steps),), **fields)


@given(st.floats(0.5, 5.0))
def test_harmonics_are_binomial_coefficients(g: float) -> None:
    """`((1 + cos φ)/2)^g = cos^2g(φ/2)`, whose coefficients are `4^-g C(2g, g + k)`."""

    def expected(k: int) -> float:
        return float(np.exp(gammaln(2 * g + 1) - gammaln(g + 1 + k) - gammaln(g + 1 - k) - g * np.log(4)))

    assert harmonics(g, 1) == pytest.approx([expected(0), expected(1)], rel=1e-6)
    found = harmonics(g, 6)
    for k in range(1, 6):
        assert found[k + 1] * (g + k + 1) == pytest.approx(found[k] * (g - k), abs=1e-6)


def test_a_square_law_is_seen_by_three_steps_alone() -> None:
    """cos^4 has no harmonic beyond the second: c_2/c_1 = 1/4, and `arg(1 + r e^iψ)` has mean square
    `½ Li₂(r²)`.
    """
    expected = np.sqrt(0.5 * sum(0.25 ** (2 * k) / k**2 for k in range(1, 30)))
    assert phase_error(2.0, 3) == pytest.approx(expected, rel=1e-6)
    assert phase_error(2.0, 4) < 1e-9
    assert phase_error(1.0, 3) < 1e-9


@pytest.mark.parametrize("g", [0.5, 1.033, 2.2, 4.0])
@pytest.mark.parametrize("steps", [3, 4, 5, 8])
def test_the_error_is_that_of_decoded_fringes(g: float, steps: int) -> None:
    phase = TWO_PI * (np.arange(3000) + 0.5) / 3000
    light = (0.5 + 0.5 * np.cos(phase - phase_steps(steps)[:, None])) ** g
    frames = [np.rint(60000 * row + 1000)[None].astype(np.uint16) for row in light]
    found = wrapped_phase(frames, Sinusoid(axis="x", stripes=1, steps=steps)).phase[0]
    error = (found - phase + np.pi) % TWO_PI - np.pi
    # Frames of 60 000 levels and phases in float32.
    assert phase_error(g, steps) == pytest.approx(np.sqrt(np.mean(error**2)), abs=2e-5)


def test_correction_leaves_what_rounding_leaves() -> None:
    coarse = shown_phase_error(law(2.2), 3, law(2.2))
    assert coarse < phase_error(2.2, 3) / 50
    # With 16 times the greys a sixteenth of it.
    assert shown_phase_error(law(2.2), 3, law(2.2), greys=4096) == pytest.approx(coarse / 16, rel=0.25)
    # Without rounding a correction by too little leaves the error of the quotient.
    left = shown_phase_error(law(2.2), 3, law(2.0), greys=1 << 24)
    assert left == pytest.approx(phase_error(1.1, 3), rel=1e-4)


@pytest.mark.parametrize("g", [0.7, 1.3, 2.2])
def test_harmonics_of_any_curve_are_those_of_the_power_law(g: float) -> None:
    exact = harmonics(g, 6)
    assert relative_harmonics(law(g), highest=6) == pytest.approx(exact / exact[1], abs=1e-6)
    assert relative_harmonics(law(g), law(g), highest=6) == pytest.approx([2, 1, 0, 0, 0, 0, 0], abs=1e-9)


def test_least_steps_are_the_first_that_do() -> None:
    assert least_steps(law(1.0)) == 3
    for g in (0.5, 2.2, 4.0):
        steps = least_steps(law(g))
        assert steps is not None
        assert phase_error(g, steps) <= PATTERN_LIMITS.max_phase_error_rad < phase_error(g, steps - 1)


def test_a_straight_response_is_good_enough() -> None:
    found = judge_response(response(1.002), plan(), SIZE)
    assert found.good_enough
    assert found.sentence.startswith("3 steps of 64 stripes, patterns as they are: RMS phase error")
    assert "good enough, at most 0.01 rad" in found.sentence
    assert found.phase_px == pytest.approx(found.phase_rad / TWO_PI * 912 / 64)


def test_a_bent_response_is_not_and_the_sentence_says_what_is() -> None:
    found = judge_response(response(2.2), plan(), SIZE)
    assert not found.good_enough
    assert found.phase_rad == pytest.approx(0.205, abs=1e-3)
    assert "pre-correct the patterns ('response' in the plan), which leaves 0.0027 rad" in found.sentence
    assert "or take 4 steps or more" in found.sentence
    assert judge_response(response(2.2), plan(steps=12), SIZE).good_enough


def test_a_plan_that_corrects_is_judged_with_its_correction() -> None:
    corrected = judge_response(response(2.2), plan(response=Curve(a=1.0, b=0.0, g=2.2)), SIZE)
    assert corrected.good_enough
    assert "corrected patterns" in corrected.sentence
    wrong = judge_response(response(2.2), plan(response=Curve(a=1.0, b=0.0, g=1.5)), SIZE)
    assert not wrong.good_enough


def test_an_uncertain_exponent_is_judged_at_its_worse_end() -> None:
    found = judge_response(response(1.0, sigma=0.05), plan(), SIZE)
    assert found.phase_rad == pytest.approx(found.rounding_by_steps["3"])
    assert found.worst_rad == pytest.approx(phase_error(1.1, 3), rel=0.2)
    assert not found.good_enough
    assert "take" in found.sentence
    assert "pre-correct" not in found.sentence


def test_the_finest_set_that_suffers_most_is_judged() -> None:
    sets = (
        Sinusoid(axis="x", stripes=1, steps=3),
        Sinusoid(axis="x", stripes=64, steps=12),
        Sinusoid(axis="y", stripes=32, steps=4),
    )
    found = judge_response(response(2.2), Plan(fringes=sets), SIZE)
    assert (found.axis, found.stripes, found.steps) == ("y", 32, 4)
    assert found.phase_px == pytest.approx(found.phase_rad / TWO_PI * 1140 / 32)
