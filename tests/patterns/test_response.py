"""The response: parameters are recovered with a correct uncertainty, and invalid input is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.patterns.curve import Curve
from fpplab.patterns.response import Response, fit_response

SHOWN = np.linspace(0, 1, 18)


def seen(a: float = 0.7, b: float = 0.03, g: float = 2.2) -> np.ndarray:
    return a * SHOWN**g + b


@given(st.floats(0.1, 0.9), st.floats(0.0, 0.05), st.floats(0.4, 3.5))
def test_without_noise_the_parameters_come_back(a: float, b: float, g: float) -> None:
    found = fit_response(SHOWN, seen(a, b, g), power_only=True)
    assert (found.a, found.b, found.g) == pytest.approx((a, b, g), rel=1e-5, abs=1e-7)
    assert found.residual < 1e-7


@pytest.mark.whole
@pytest.mark.parametrize("known", [True, False])
def test_uncertainties_match_the_scatter_of_repeated_fits(known: bool) -> None:
    random, sigma = np.random.default_rng(4), 0.002
    pulls = []
    for _ in range(120):
        levels, told = seen() + random.normal(0, sigma, 18), np.full(18, sigma) if known else None
        found = fit_response(SHOWN, levels, told, power_only=True)
        off = np.array([found.a, found.b, found.g]) - (0.7, 0.03, 2.2)
        pulls.append(off / found.sigma)
    # 120 fits give a standard deviation to 6.5 %; Student's t is a tenth wider than the normal.
    np.testing.assert_allclose(np.std(pulls, axis=0), 1.0, atol=0.25)
    assert np.abs(np.mean(pulls, axis=0)).max() < 0.35


def test_residual_is_the_rms_misfit() -> None:
    levels = seen() + 0.01 * np.where(np.arange(18) % 2, 1, -1)
    found = fit_response(SHOWN, levels)
    assert found.residual == pytest.approx(np.sqrt(np.mean((levels - found.apply(SHOWN)) ** 2)))
    assert 0.008 < found.residual < 0.0101


def test_uncertain_levels_count_less() -> None:
    levels, sigma = seen(), np.full(18, 0.001)
    levels[14] += 0.05
    sigma[14] = 0.5
    assert fit_response(SHOWN, levels, sigma).g == pytest.approx(2.2, abs=1e-3)
    assert abs(fit_response(SHOWN, levels).g - 2.2) > 0.02


def test_saturated_levels_are_left_out_and_named() -> None:
    levels = np.minimum(seen(a=1.3), 1.0)
    found = fit_response(SHOWN, levels)
    assert (found.a, found.g) == pytest.approx((1.3, 2.2), rel=1e-5)
    assert found.levels == np.sum(levels < 0.99)
    assert len(found.left_out) == np.sum(levels >= 0.99) > 0
    assert "level 1 is seen as 1: saturated" in found.left_out[-1]


@given(st.floats(0.1, 0.9), st.floats(0.0, 0.05), st.floats(0.4, 3.5), st.floats(0.0, 1.0))
def test_invert_undoes_apply(a: float, b: float, g: float, level: float) -> None:
    response = Response(a=a, b=b, g=g, sigma=(0.0, 0.0, 0.0), residual=0.0, levels=9)
    # b swallows what is below its rounding; the inverse is steep there.
    np.testing.assert_allclose(response.invert(response.apply(level)), level, atol=1e-15 ** min(1, 1 / g))


def test_levels_below_the_dark_have_no_inverse() -> None:
    response = Response(a=0.8, b=0.1, g=2.0, sigma=(0.0, 0.0, 0.0), residual=0.0, levels=9)
    assert np.isnan(response.invert(0.05))
    assert response.invert([0.1, 0.9]) == pytest.approx([0, 1])


@pytest.mark.parametrize(
    ("shown", "levels", "sigma", "words"),
    [
        (SHOWN, seen()[:-1], None, "as many"),
        (SHOWN, seen(), np.ones(3), "as many"),
        (SHOWN, seen(), np.zeros(18), "'sigma_out' must be positive"),
        (255 * SHOWN, seen(), None, "'levels_in' must be a row of levels from 0 to 1"),
        (SHOWN, np.full(18, np.nan), None, "'levels_out' must be"),
        (SHOWN[:4], seen()[:4], None, "4 different levels remain .*: show more levels"),
        (np.full(18, 0.5), seen(), None, "1 different levels remain"),
        (SHOWN, np.clip(40 * SHOWN, 0, 1), None, "shorten the exposure"),
        (SHOWN, np.full(18, 0.2), None, "do not rise"),
        (SHOWN, seen()[::-1], None, "do not rise"),
    ],
)
def test_nonsense_is_refused(
    shown: np.ndarray, levels: np.ndarray, sigma: np.ndarray | None, words: str
) -> None:
    with pytest.raises(CalibrationError, match=words):
        fit_response(shown, levels, sigma)


def test_a_response_survives_its_file(tmp_path: Path) -> None:
    found = fit_response(SHOWN, np.minimum(seen(a=1.1), 1.0))
    found.save(tmp_path / "response.yaml")
    assert Response.load(tmp_path / "response.yaml") == found


def test_a_response_file_with_a_wrong_field_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "response.yaml"
    fit_response(SHOWN, seen()).save(path)
    path.write_text(path.read_text().replace("g: 2", "g: -2"))
    with pytest.raises(ConfigError, match="'g' is -2"):
        Response.load(path)


def test_summary_has_the_keys_of_the_command_line() -> None:
    summary = fit_response(SHOWN, seen()).summary()
    assert set(summary) > {"a", "b", "g", "residual", "sigma", "covariance", "residual_sum"}
    assert [level["shown"] for level in summary["levels"]] == pytest.approx(SHOWN)


def test_covariance_is_that_of_the_linearised_fit() -> None:
    """For independent levels of deviation σ it is σ² (JᵀJ)⁻¹, J the slopes of the law."""
    sigma = 0.002
    found = fit_response(SHOWN, seen(), np.full(18, sigma))
    step = 1e-6
    slopes = [
        (seen(0.7 + step) - seen(0.7 - step)) / (2 * step),
        (seen(b=0.03 + step) - seen(b=0.03 - step)) / (2 * step),
        (seen(g=2.2 + step) - seen(g=2.2 - step)) / (2 * step),
    ]
    expected = sigma**2 * np.linalg.inv(np.array(slopes) @ np.array(slopes).T)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-4)
    np.testing.assert_allclose(np.square(found.sigma), np.diag(expected), rtol=1e-4)
    assert found.misfit == 0.0


def test_what_the_law_cannot_follow_widens_the_uncertainty() -> None:
    """Levels known to a millionth that scatter about the law by 0.01 are treated as known to 0.01."""
    random, off = np.random.default_rng(8), 0.01
    levels = seen() + random.normal(0, off, 18)
    found = fit_response(SHOWN, levels, np.full(18, 1e-6))
    assert found.misfit == pytest.approx(found.residual * np.sqrt(18 / 15), rel=1e-3)
    alike = fit_response(SHOWN, levels, np.full(18, found.misfit))
    np.testing.assert_allclose(found.covariance, alike.covariance, rtol=1e-3)


def test_residual_sum_is_of_squares() -> None:
    levels = seen() + 0.01 * np.where(np.arange(18) % 2, 1, -1)
    found = fit_response(SHOWN, levels)
    assert found.residual_sum == pytest.approx(18 * found.residual**2)
    assert [p.residual for p in found.measured] == pytest.approx(levels - found.apply(SHOWN))


def test_a_level_with_clipped_pixels_is_left_out_though_its_mean_is_not_saturated() -> None:
    levels = seen()
    levels[-1] = 0.7  # what clipping left of 0.73
    clipped = SHOWN == 1.0
    found = fit_response(SHOWN, levels, saturated=clipped)
    assert found.g == pytest.approx(2.2, rel=1e-5)
    assert found.left_out == ("level 1 is seen as 0.7: saturated, in some of its pixels",)
    assert abs(fit_response(SHOWN, levels).g - 2.2) > 0.02


@given(st.floats(0.5, 5.0), st.floats(0.1, 0.9), st.floats(0.0, 0.1), st.floats(0.0, 1.0))
def test_corrected_levels_give_light_in_proportion(g: float, a: float, b: float, level: float) -> None:
    curve = Curve(a=a, b=b, g=g)
    assert curve.apply(curve.correct(level)) == pytest.approx(a * level + b, abs=1e-12)


def test_the_normalised_response_is_free_of_gain_and_black_level() -> None:
    """The projector's own 0.65 I^1.033 + 0.056 through gains and black levels of cameras."""
    for gain, black in ((1.0, 0.0), (0.6, 0.04), (1.2, 0.01)):
        through = gain * seen(0.65, 0.056, 1.033) + black
        found = fit_response(SHOWN, through).model_copy(update={"dark": (black, 0.0)})
        assert found.normalised is not None
        assert found.normalised["a"] == pytest.approx(0.65 / 0.706, rel=1e-6)
        assert found.normalised["b"] == pytest.approx(0.056 / 0.706, rel=1e-6)
    assert fit_response(SHOWN, through).normalised is None


@pytest.mark.whole
def test_the_normalised_response_knows_its_uncertainty() -> None:
    random, sigma, dark, values, told = np.random.default_rng(2), 0.002, 0.02, [], []
    for _ in range(200):
        levels = seen() + random.normal(0, sigma, 18)
        found = fit_response(SHOWN, levels, np.full(18, sigma), power_only=True)
        found = found.model_copy(update={"dark": (dark + random.normal(0, 0.003), 0.003)})
        assert found.normalised is not None
        values.append(found.normalised["b"])
        told.append(found.normalised["sigma"])
    # 200 values give a standard deviation to 5 %.
    assert np.std(values) == pytest.approx(np.mean(told), rel=0.2)


@pytest.mark.parametrize("g", [0.3, 7.0])
def test_an_exponent_that_no_projector_can_invert_is_refused(g: float) -> None:
    response = Response(a=1.0, b=0.0, g=g, sigma=(0.0, 0.0, 0.0), residual=0.0, levels=9)
    with pytest.raises(
        ConfigError, match=f"^r.yaml: 'g' is {g:g}: patterns can be corrected for .* 0.5 to 5"
    ):
        response.curve("r.yaml")


def test_an_exponent_that_is_hardly_known_is_refused() -> None:
    response = Response(a=1.0, b=0.0, g=2.0, sigma=(0.0, 0.0, 0.2), residual=0.0, levels=9)
    with pytest.raises(ConfigError, match=r"uncertainty of 0.2: at most 5 % .* measure it again"):
        response.curve("r.yaml")
