"""A response that is no power law: a spline is chosen by evidence, and tells its fringes' phase error."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.core.conventions import TWO_PI, Floats, Lattice, phase_steps
from fpplab.core.errors import ConfigError
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.phase_error import judge_response, shown_phase_error
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response, fit_response
from fpplab.patterns.response_spline import fit_spline

SHOWN = np.linspace(0, 255, 18).round() / 255
SIGMA = 3e-4


def s_shaped(levels: Floats, strength: float = 0.09) -> Floats:
    return np.asarray(levels - strength * np.sin(TWO_PI * levels))


def measured(seed: int, strength: float = 0.09) -> Response:
    random = np.random.default_rng(seed)
    seen = 0.7 * s_shaped(SHOWN, strength) + 0.03 + random.normal(0, SIGMA, len(SHOWN))
    return fit_response(SHOWN, seen, np.full(len(SHOWN), SIGMA))


def true_error(steps: int, correction: Curve | None = None) -> float:
    """RMS phase error of 8-bit patterns through the S, decoded here and nowhere else."""
    phase = TWO_PI * (np.arange(20_000) + 0.5) / 20_000
    shift = phase_steps(steps)[:, None]
    wanted = 0.5 + 0.5 * np.cos(phase - shift)
    shown = np.rint(255 * (wanted if correction is None else correction.correct(wanted))) / 255
    light = s_shaped(shown)
    off = np.angle(np.sum(light * np.exp(1j * shift), axis=0) * np.exp(-1j * phase))
    return float(np.std(off))


@pytest.mark.whole_after(3)
@pytest.mark.parametrize("steps", [12, *range(3, 12)])
def test_the_phase_error_of_an_s_is_told(steps: int) -> None:
    for seed in range(3):
        assert shown_phase_error(measured(seed), steps) == pytest.approx(true_error(steps), rel=0.25)


@pytest.mark.whole_after(3)
@pytest.mark.parametrize("steps", [12, *range(3, 12)])
def test_correction_takes_the_s_away(steps: int) -> None:
    """To the rounding of patterns to 256 grey levels; where the S makes more than that, mostly."""
    floor = shown_phase_error(Curve(a=1.0, b=0.0, g=1.0), steps)
    for seed in range(3):
        left = true_error(steps, measured(seed))
        assert left < 2.0 * floor
        own = np.sqrt(max(true_error(steps) ** 2 - floor**2, 0.0))
        if own > 20 * floor:
            assert left < true_error(steps) / 10


def test_the_s_is_chosen_and_a_power_law_is_kept() -> None:
    for seed in range(5):
        assert measured(seed).spline
        random = np.random.default_rng(seed)
        for g in (1.0, 1.033, 1.8, 2.2):
            seen = 0.7 * SHOWN**g + 0.03 + random.normal(0, SIGMA, len(SHOWN))
            assert not fit_response(SHOWN, seen, np.full(len(SHOWN), SIGMA)).spline
            assert not fit_response(SHOWN, seen).spline
    assert not measured(0).model_copy(update={"spline": ()}).spline


def test_levels_are_predicted_as_by_a_fit_without_them() -> None:
    random = np.random.default_rng(3)
    seen = 0.7 * s_shaped(SHOWN) + 0.03 + random.normal(0, 0.002, len(SHOWN))
    whole = fit_spline(SHOWN, seen, None)
    assert whole is not None
    for index in range(3, 15):
        kept = np.arange(len(SHOWN)) != index
        count = len(whole.coefficients)
        from fpplab.patterns.response_spline import _fit

        other = _fit(SHOWN[kept], seen[kept], np.ones(kept.sum()), count)
        assert other is not None
        curve = Curve(a=other.a, b=other.b, g=1.0, spline=other.coefficients)
        off = seen[index] - float(curve.apply(SHOWN[index]))
        assert whole.left_out[index] == pytest.approx(off, abs=0.15 * np.abs(whole.left_out).max())


def test_levels_that_end_before_white_have_no_spline() -> None:
    seen = 0.7 * s_shaped(SHOWN) + 0.03
    assert not fit_response(SHOWN[:-2], seen[:-2]).spline
    assert not fit_response(SHOWN, seen, power_only=True).spline


S_SHAPED = Curve(a=0.7, b=0.03, g=1.0, spline=measured(1).spline)


@given(st.floats(0, 1))
def test_a_spline_is_inverted(level: float) -> None:
    curve = S_SHAPED
    assert curve.apply(curve.correct(level)) == pytest.approx(0.7 * level + 0.03, abs=2e-5)
    assert curve.invert(0.7 * level + 0.03) == pytest.approx(curve.correct(level), abs=1e-9)
    assert np.isnan(curve.invert(0.02))
    assert np.isnan(curve.invert(0.74))


@pytest.mark.parametrize(
    "bad", [(0.0, 0.5, 1.0), (0.1, 0.2, 0.5, 1.0), (0.0, 0.6, 0.5, 1.0), (0.0, 0.1, 0.2, 0.9)]
)
def test_a_spline_that_does_not_rise_from_0_to_1_is_refused(bad: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="'spline' has"):
        Curve(a=1.0, b=0.0, g=1.0, spline=bad)


def test_a_response_too_steep_for_256_greys_is_refused() -> None:
    steep = Response(
        a=1.0, b=0.0, g=1.0, sigma=(0.0, 0.0, 0.0), residual=0.0, levels=9,
        spline=(*[0.0] * 30, *[1.0] * 30),
    )  # fmt: skip
    with pytest.raises(ConfigError, match=r"r.yaml: 'spline' rises by .* of white from one grey level"):
        steep.curve("r.yaml")


def test_a_spline_survives_its_file_and_corrects_a_plan(tmp_path: Path) -> None:
    found = measured(2)
    found.save(tmp_path / "response.yaml")
    assert Response.load(tmp_path / "response.yaml") == found
    sets = "fringes: [{axis: x, stripes: 8, steps: 4}]\nexposure_s: 0.01\nunwrapping: hierarchical\n"
    (tmp_path / "plan.yaml").write_text(sets + "response: response.yaml\n")
    plan = Plan.load(tmp_path / "plan.yaml")
    assert plan.response is not None
    assert plan.response.spline == found.spline
    row = make_patterns(plan, (912, 10), Lattice.SQUARE)[0].image[0] / 255
    wanted = 0.5 + 0.5 * np.cos(TWO_PI * 8 * (np.arange(912) + 0.5) / 912)
    assert s_shaped(row) == pytest.approx(wanted, abs=0.006)


def test_what_is_called_good_enough_is() -> None:
    """A power law calls the S good enough for four steps; the error is nine times what is allowed."""
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=64, steps=4),))
    found = judge_response(measured(0), plan, (912, 1140))
    assert not found.good_enough
    assert found.phase_rad == pytest.approx(true_error(4), rel=0.25)
    law = measured(0).model_copy(update={"spline": (), "misfit": 0.0, "residual": 0.0})
    assert judge_response(law, plan, (912, 1140)).good_enough
    # Where a power law is kept although levels scatter about it, what they leave counts.
    unsure = law.model_copy(update={"misfit": 0.03})
    assert not judge_response(unsure, plan, (912, 1140)).good_enough
