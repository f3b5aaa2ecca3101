"""Frames of a Bayer camera: decoded raw, compared without a mosaic, and the colours of points."""

from dataclasses import replace
from typing import get_args

import cv2
import numpy as np
import pytest

from fpplab.core import config
from fpplab.core.conventions import Floats, Map
from fpplab.patterns.mosaic import Bayer, colour_factors, colours_at, white_levels, without_mosaic
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import MergedLevels, Recording
from fpplab.phase import Decoded, decode

SHAPE, SIZE = (160, 256), (912, 1140)
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
COORDINATE = 60.0 + 1.3 * U + 1.5 * np.sin(V / 30.0) * np.sin(U / 30.0)
CHECKS = np.where((V // 37 + U // 41) % 2, 1.0, 0.3)
PIXELS = 0.5, 0.8, 0.35
"""Light of red, green and blue pixels."""
SETS = [
    {"axis": "x", "stripes": 1, "steps": 4},
    {"axis": "x", "stripes": 8, "steps": 4},
    {"axis": "x", "stripes": 64, "steps": 8},
]
PLAN = config.validate({"fringes": [{"kind": "even", "levels": [1, 0]}, *SETS]}, Plan, "test")
PATTERNS: tuple[Bayer, ...] = get_args(Bayer)


def recording(seed: int, factors: Floats | Map, bayer: Bayer | None) -> Recording:
    """Blurred checks under fringes, as a sensor of 12 bits with shot noise sees them."""
    random, frames = np.random.default_rng(seed), []
    for each in PLAN.sets:
        for step in range(each.images):
            light = CHECKS * (0.02 + 0.9 * each.light(step, COORDINATE, SIZE[0]))
            mean = 15_000.0 * factors * cv2.GaussianBlur(light, (0, 0), 0.8)
            charge = random.poisson(mean) + 5.0 * random.standard_normal(SHAPE)
            frames.append(np.rint(4095.0 * np.clip(0.02 + 0.98 * charge / 15_000.0, 0, 1)).astype(np.uint16))
    return Recording(frames, PLAN, SIZE, 12, bayer=bayer)


def over_stated(decoded: Decoded) -> float:
    assert decoded.sigma_phase_error is not None
    stated = np.hypot(decoded.sigma, decoded.sigma_phase_error)
    return float(np.sqrt(np.mean(((decoded.u - COORDINATE) / stated)[decoded.valid] ** 2)))


def test_a_mosaic_is_no_texture() -> None:
    """Errors at edges of the checks are stated as without a filter; taken for texture, colours hide them."""
    factors = colour_factors(SHAPE, "RGGB", PIXELS)
    coloured = recording(1, factors, "RGGB")
    decoded, grey = decode(coloured), decode(recording(1, np.full(SHAPE, 0.55), None))
    assert decoded.valid.mean() > 0.99
    assert over_stated(decoded) < 1.1 * over_stated(grey)
    assert over_stated(decode(replace(coloured, bayer=None))) > 1.3 * over_stated(grey)
    inside = cv2.erode((CHECKS == 1.0).astype(np.uint8), np.ones((9, 9))) > 0
    for levels in (decoded.modulation, coloured.mean_image().astype(np.float32)):
        assert np.std(levels[inside]) < 0.03 * np.mean(levels[inside])


@pytest.mark.parametrize("bayer", PATTERNS)
def test_each_colour_has_the_noise_of_its_own_light(bayer: Bayer) -> None:
    """The error of a colour is that which as much light gives a camera without a filter."""
    decoded = decode(recording(2, colour_factors(SHAPE, bayer, PIXELS), bayer))
    calm = cv2.erode((CHECKS == 1.0).astype(np.uint8), np.ones((9, 9))) > 0
    for k, share in enumerate(PIXELS):
        own = colour_factors(SHAPE, bayer, (float(k == 0), float(k == 1), float(k == 2))) > 0
        alone = decode(recording(3, np.full(SHAPE, share), None))
        errors = [np.std((d.u - COORDINATE)[calm & own & d.valid]) for d in (decoded, alone)]
        assert errors[0] == pytest.approx(errors[1], rel=0.1)


@pytest.mark.parametrize("bayer", PATTERNS)
def test_points_have_the_colours_of_the_part(bayer: Bayer) -> None:
    seen = recording(4, colour_factors(SHAPE, bayer, PIXELS), bayer)
    pixels = np.stack([U[CHECKS == 1.0], V[CHECKS == 1.0]], axis=1).astype(np.int32)
    colours = seen.colours(pixels)
    assert colours is not None
    expected = 0.98 * 255.0 * 0.9 * np.array(PIXELS)  # without black level and ambient light
    np.testing.assert_allclose(np.median(colours, axis=0), expected, rtol=0.02)
    np.testing.assert_allclose(white_levels(colours), np.array(PIXELS) / 0.6125, rtol=0.02)
    assert replace(seen, bayer=None).colours(pixels) is None


def test_single_leds_colour_points_of_a_camera_without_a_filter() -> None:
    """White less black under one LED after the other; merged exposures give the same."""
    leds = {"red": 0.7, "green": 0.5, "blue": 0.2}
    whites = [{"kind": "even", "levels": [1, 0], "led": led} for led in leds]
    plan = config.validate({"fringes": [*SETS, *whites]}, Plan, "test")
    frames = [np.full(SHAPE, 500, np.uint16)] * 16
    for k, share in enumerate(leds.values()):
        black = 100 + 10 * k  # closed mirrors leak light of the LED that is on
        frames += [np.full(SHAPE, black + 4000 * share, np.uint16), np.full(SHAPE, black, np.uint16)]
    pixels = np.array([[3, 5], [8, 1]], np.int32)
    colours = Recording(frames, plan, SIZE, 12).colours(pixels)
    assert colours is not None
    np.testing.assert_allclose(colours, [[4000.0 / 16.0 * share for share in leds.values()]] * 2)
    scales = (np.full(SHAPE, 2.0, np.float32),) * len(plan.sets)
    merged = MergedLevels(2.0, scales, (1.0, 0.01))
    again = Recording(frames, plan, SIZE, 12, merged=merged).colours(pixels)
    np.testing.assert_allclose(again, colours)
    two = plan.model_copy(update={"fringes": plan.sets[:5]})
    assert Recording(frames[:20], two, SIZE, 12).colours(pixels) is None


def test_odd_sizes_unknown_pixels_and_darkness() -> None:
    levels = colour_factors((101, 67), "GBRG", PIXELS) * np.float32(100.0)
    levels[40:60, 20:30] = np.nan
    even = without_mosaic(levels)
    assert np.array_equal(np.isnan(even), np.isnan(levels))
    np.testing.assert_allclose(even[np.isfinite(even)], 61.25, rtol=1e-4)
    assert not without_mosaic(np.zeros((9, 9))).any()
    corner = np.array([[0, 0], [66, 100]], np.int32)
    np.testing.assert_allclose(
        colours_at(np.nan_to_num(levels), "GBRG", corner), 100.0 * np.array([PIXELS] * 2)
    )
