"""Frames of uniform grey-level images: means, uncertainties and regions, on synthetic frames."""

import numpy as np
import pytest
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Image
from fpplab.core.errors import CalibrationError, DataError
from fpplab.patterns.response import Response
from fpplab.patterns.response_fit import (
    GRID,
    MEAN,
    NOISE,
    SPREAD,
    WHITE,
    GreyLevelImages,
    fit_greys,
    mean_levels_of_regions,
    pixels_of_regions,
    rounding_variance,
    statistics,
)
from fpplab.report.response_figures import response_fit

SHAPE = (60, 90)
SHOWN = np.linspace(0, 1, 16)
TRUTH = (0.65, 0.056, 1.033)
ALL = np.ones(GRID**2, bool)


def make(
    seed: int = 1,
    *,
    truth: tuple[float, float, float] = TRUTH,
    gain: float | Floats = 1.0,
    bits: int = 12,
    noise: float = 3.0,
    repeats: int = 4,
    exponent: float | Floats = 0.0,
    lamp: float = 0.0,
) -> GreyLevelImages:
    """Frames of `gain (a I^(g + exponent) + b)`, noise in integers; the lamp varies by a share from frame to
    frame.
    """
    random, full = np.random.default_rng(seed), (1 << bits) - 1
    a, b, g = truth

    def frame(light: float | Floats) -> Image:
        flicker = 1 + lamp * random.normal()
        ideal = full * np.broadcast_to(gain * light * flicker, SHAPE)
        integers = np.rint(np.clip(ideal + random.normal(0, noise, SHAPE), 0, full))
        return integers.astype(np.uint8 if bits == 8 else np.uint16)

    seen = [[statistics(frame(a * i ** (g + exponent) + b), bits) for i in SHOWN] for _ in range(repeats)]
    dark = statistics(frame(0.0), bits)
    return GreyLevelImages(SHOWN, np.array(seen), dark, pixels_of_regions(np.zeros(SHAPE, np.uint8)), bits)


def only(index: int, value: float, others: float) -> Floats:
    """An image with `value` in one region and `others` elsewhere."""
    picture = np.full(SHAPE, others)
    rows, columns = SHAPE[0] // GRID, SHAPE[1] // GRID
    row, column = divmod(index, GRID)
    picture[row * rows : (row + 1) * rows, column * columns : (column + 1) * columns] = value
    return picture


def test_statistics_are_those_of_each_region() -> None:
    image: NDArray[np.uint8] = only(5, 51, 255).astype(np.uint8)
    image[0, :30:2] = 0  # region 0: 15 of its 600 pixels, each with a white neighbour on both sides
    found = statistics(image, 8)
    assert found[MEAN, 5] == pytest.approx(0.2)
    assert found[WHITE].tolist() == pytest.approx([585 / 600, 1, 1, 1, 1, 0, 1, 1, 1])
    assert found[SPREAD, 0] == pytest.approx(585 / 600 * 15 / 600)
    assert found[NOISE, 0] == pytest.approx(0.5 * 29 / (20 * 29))
    assert pixels_of_regions(image).tolist() == [600] * 9


def test_regions_cover_every_pixel_once() -> None:
    assert pixels_of_regions(np.zeros((64, 100), np.uint8)).sum() == 6400


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.25, 0.4])
def test_rounding_of_alike_values_leaves_what_no_mean_lessens(noise: float) -> None:
    random = np.random.default_rng(3)
    errors = []
    for level in np.linspace(10, 11, 41)[:-1]:
        values = level + noise * random.standard_normal(40_000)
        errors.append(np.rint(values).mean() - level)
    # The mean of 40 000 values is itself uncertain by 0.0025.
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(
        np.sqrt(rounding_variance(np.array(noise**2))), rel=0.05, abs=0.003
    )


@pytest.mark.parametrize(("bits", "noise", "lamp"), [(12, 3.0, 0.0), (12, 3.0, 0.002), (8, 0.7, 0.0)])
def test_levels_scatter_as_their_uncertainty_says(bits: int, noise: float, lamp: float) -> None:
    truth = TRUTH[0] * SHOWN ** TRUTH[2] + TRUTH[1]
    pulls = []
    for seed in range(12):
        seen, sigma, clipped = mean_levels_of_regions(make(seed, bits=bits, noise=noise, lamp=lamp), ALL)
        assert not clipped.any()
        pulls.append((seen - truth) / sigma)
    # 192 pulls give their RMS to 5 %; the lamp's part is pooled over bright and dark levels.
    assert 0.8 < np.sqrt(np.mean(np.square(pulls))) < 1.2


def test_without_noise_the_floor_of_rounding_remains() -> None:
    seen, sigma, _ = mean_levels_of_regions(make(bits=8, noise=0.0), ALL)
    truth = TRUTH[0] * SHOWN ** TRUTH[2] + TRUTH[1]
    assert sigma == pytest.approx(1 / 255 / np.sqrt(12), rel=0.02)
    assert np.abs(seen - truth).max() <= 0.5001 / 255


@pytest.mark.parametrize(("bits", "noise"), [(12, 3.0), (8, 0.7)])
def test_a_hidden_response_is_recovered(bits: int, noise: float) -> None:
    found = fit_greys(make(bits=bits, noise=noise))
    assert (found.a, found.b, found.g) == pytest.approx(TRUTH, rel=0.01)
    assert np.all(np.abs(np.array([found.a, found.b, found.g]) - TRUTH) < 4 * np.array(found.sigma))
    assert found.residual <= 0.002
    assert found.residual_sum is not None
    assert found.residual_sum <= 0.002
    assert len(found.regions) == 9
    assert found.region_spread == pytest.approx(found.region_sigma, rel=0.6)  # nine give it to 25 %
    assert found.dark is not None
    assert found.left_out == ()


def test_uneven_light_leaves_the_exponent_alone() -> None:
    uneven = np.linspace(0.3, 1.2, SHAPE[1])[None] * np.ones(SHAPE)
    found = fit_greys(make(gain=uneven))
    assert found.g == pytest.approx(TRUTH[2], abs=4 * found.sigma[2])
    assert found.regions[2].a > 2 * found.regions[0].a
    assert np.ptp([r.g for r in found.regions]) < 0.01


def test_a_dark_region_is_left_out_and_named() -> None:
    found = fit_greys(make(gain=only(0, 0.01, 1.0)))
    assert [reason[:49] for reason in found.left_out] == ["region 1, 1 (row, column) of 3 x 3 is dark: it ri"]
    assert (found.regions[0].row, found.regions[0].column, len(found.regions)) == (0, 1, 8)
    assert (found.a, found.b) == pytest.approx(TRUTH[:2], rel=0.01)


def test_a_saturated_region_is_left_out_and_named() -> None:
    found = fit_greys(make(gain=only(7, 1.6, 1.0)))
    assert found.left_out == ("region 3, 2 (row, column) of 3 x 3 is saturated",)
    assert len(found.regions) == 8
    assert found.levels == 16
    assert (found.a, found.b, found.g) == pytest.approx(TRUTH, rel=0.01)


def test_where_all_regions_saturate_the_levels_are_left_out() -> None:
    found = fit_greys(make(gain=1.7))
    assert found.levels == 13
    assert len(found.left_out) == 3
    assert all("saturated" in reason for reason in found.left_out)
    assert (found.a, found.b, found.g) == pytest.approx((1.7 * 0.65, 1.7 * 0.056, 1.033), rel=0.01)


def test_a_level_that_noise_clips_is_left_out_though_its_mean_is_not_saturated() -> None:
    found = fit_greys(make(gain=0.985 / 0.706, noise=40.0))
    assert len(found.left_out) == 1
    assert found.left_out[0].endswith("saturated, in some of its pixels")


def test_without_light_there_is_no_response() -> None:
    with pytest.raises(CalibrationError, match=r"do not rise .* by 0\.01.* check that the camera looks"):
        fit_greys(make(gain=0.02))


def test_with_too_much_light_there_is_none_either() -> None:
    with pytest.raises(CalibrationError, match="saturated from the darkest level on: shorten the exposure"):
        fit_greys(make(gain=30.0))


def test_regions_that_disagree_are_refused_by_name() -> None:
    with pytest.raises(CalibrationError, match=r"do not agree .* region 2, 2 .* evenly white card"):
        fit_greys(make(exponent=only(4, 0.4, 0.0)))


@pytest.mark.whole
def test_the_picture_shows_the_regions_that_were_fitted() -> None:
    whole, fewer = (response_fit(fit_greys(make(gain=g))) for g in (1.0, only(0, 0.01, 1.0)))
    assert whole.startswith(b"\x89PNG")
    assert whole != fewer


def test_a_bare_response_is_not_drawn() -> None:
    bare = Response(a=0.9, b=0.0, g=1.0, sigma=(0.0, 0.0, 0.0), residual=0.0, levels=9)
    with pytest.raises(DataError, match="no levels and regions to draw"):
        response_fit(bare)
