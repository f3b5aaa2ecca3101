"""Rows of a camera under the binary planes of a projector, against numerical integrals over time."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.timing import is_whole, plane_durations, plane_weights

bit_depths = st.integers(1, 10)
periods = st.floats(1e-4, 0.1)
starts = st.floats(-10, 10)
line_times = st.one_of(st.just(0.0), st.floats(1e-6, 1e-3))


def is_lit(bits: int, bit: int, turns: np.ndarray) -> np.ndarray:
    """Whether the plane of `bit` is on at times in periods: the most significant bit has the first half."""
    slot = np.mod(turns, 1) * (2**bits - 1)
    before = sum(2**k for k in range(bit + 1, bits))
    return np.asarray((slot >= before) & (slot < before + 2**bit))


def summed(bits: int, bit: int, begin: Fraction, turns: Fraction) -> Fraction:
    """The weight of a plane by adding up its overlap with every period, in rational numbers."""
    slot = Fraction(1, 2**bits - 1)
    light = Fraction(0)
    for period in range(int(begin // 1), int((begin + turns) // 1) + 1):
        on = period + slot * sum(2**k for k in range(bit + 1, bits))
        light += max(Fraction(0), min(begin + turns, on + slot * 2**bit) - max(begin, on))
    return light / (turns * slot * 2**bit)


@pytest.mark.parametrize(("turns", "start"), [(0.3, 0.0), (1.5, 0.2), (0.05, 0.9), (3.7, -0.45)])
def test_weights_are_integrals_over_time(turns: float, start: float) -> None:
    """Against the middles of many short steps; every edge inside the exposure costs half a step at most."""
    period, bits, steps = 0.01, 3, 1_000_000
    weights = plane_weights(1, bits, period, turns * period, 0.0, start * period)
    times = start + turns * (np.arange(steps) + 0.5) / steps
    for bit in range(bits):
        counted = is_lit(bits, bit, times).mean() / plane_durations(bits)[bit]
        edges = 2 * (np.ceil(turns) + 1)
        assert abs(weights[bit, 0] - counted) < edges * 0.5 / steps / plane_durations(bits)[bit]


@given(bits=bit_depths, start=st.fractions(-30, 30), turns=st.fractions("1/50", 12, max_denominator=1000))
def test_weights_are_exact(bits: int, start: Fraction, turns: Fraction) -> None:
    period = Fraction(1, 120)
    weights = plane_weights(1, bits, float(period), float(turns * period), 0.0, float(start * period))
    expected = [float(summed(bits, bit, start, turns)) for bit in range(bits)]
    np.testing.assert_allclose(weights[:, 0], expected, rtol=0, atol=1e-9)


@given(bits=bit_depths, period=periods, whole=st.integers(1, 50), line=line_times, start=starts)
def test_whole_periods_have_no_bands(bits: int, period: float, whole: int, line: float, start: float) -> None:
    assert is_whole(whole * period, period)
    weights = plane_weights(40, bits, period, whole * period, line, start)
    assert weights.shape == (bits, 40)
    np.testing.assert_allclose(weights, 1, rtol=0, atol=1e-9)


@given(bits=bit_depths, period=periods, turns=st.floats(0.01, 20), line=line_times, start=starts)
def test_white_is_collected_completely_and_light_is_never_negative(
    bits: int, period: float, turns: float, line: float, start: float
) -> None:
    weights = plane_weights(40, bits, period, turns * period, line, start)
    assert weights.min() >= 0
    np.testing.assert_allclose(plane_durations(bits) @ weights, 1, rtol=0, atol=1e-9)


@given(bits=st.integers(1, 8), turns=st.floats(0.05, 5), start=starts)
def test_starts_spread_over_a_period_average_to_one(bits: int, turns: float, start: float) -> None:
    """The weight bends four times in a period, by 1/(turns duration) each: what the rule of equal steps of
    length h misses of each bend is at most h²/8 of it."""
    rows, period = 20_000, 0.01
    weights = plane_weights(rows, bits, period, turns * period, period / rows, start)
    missed = 4 * (2**bits - 1) / turns / 8 / rows**2
    np.testing.assert_allclose(weights.mean(axis=1), 1, rtol=0, atol=missed + 1e-9)


def test_a_rolling_shutter_sees_bands_as_high_as_a_period_has_rows() -> None:
    period_rows, rows = 250, 1000
    weights = plane_weights(rows, 8, 0.01, 0.015, 0.01 / period_rows, 0.0013)
    np.testing.assert_allclose(weights[:, period_rows:], weights[:, :-period_rows], atol=1e-9)
    for plane in weights:
        spectrum = np.abs(np.fft.rfft(plane - plane.mean()))
        assert spectrum.argmax() == rows // period_rows


def test_half_a_period_too_much_catches_the_first_plane_once_or_twice() -> None:
    """Of 1.5 periods, bit 7 (128/255 of each) fills 1 period's share to 1 + 127.5/128 at best."""
    weights = plane_weights(5000, 8, 0.01, 0.015, 0.01 / 5000, 0.0)
    assert weights[7].max() == pytest.approx((1 + 127.5 / 128) / 1.5, abs=1e-9)
    assert weights[7].min() == pytest.approx((1 + 0.5 / 128) / 1.5, abs=1e-3)
    assert weights[0].max() == pytest.approx(2 / 1.5, abs=1e-9)
    assert weights[0].min() == pytest.approx(1 / 1.5, abs=1e-9)


@given(turns=st.floats(0.01, 20), start=starts)
def test_a_global_shutter_has_no_bands_but_may_see_another_grey(turns: float, start: float) -> None:
    weights = plane_weights(16, 8, 0.01, turns * 0.01, 0.0, start)
    np.testing.assert_array_equal(weights, np.repeat(weights[:, :1], 16, axis=1))


def test_an_exposure_within_the_first_plane_sees_that_plane_alone() -> None:
    weights = plane_weights(1, 2, 0.003, 0.001, 0.0, 0.0005)
    np.testing.assert_allclose(weights[:, 0], [0, 1.5], atol=1e-12)


def test_binary_patterns_never_have_bands() -> None:
    np.testing.assert_allclose(plane_weights(100, 1, 0.01, 0.0037, 1e-5, 0.002), 1, atol=1e-12)


@pytest.mark.parametrize(
    ("exposure", "period", "whole"),
    [(0.05, 0.01, True), (3 * 0.1, 0.1, True), (0.1, 1 / 120, True), (0.025, 0.00833, False)]
    + [(0.015, 0.01, False), (0.0, 0.01, False), (1e-12, 0.01, False), (0.01 * (1 + 1e-7), 0.01, False)],
)
def test_is_whole(exposure: float, period: float, whole: bool) -> None:
    assert is_whole(exposure, period) is whole


@given(bits=bit_depths, start=st.floats(0, 1), beyond=st.floats(-1e-9, 1e-9), whole=st.integers(1, 20))
def test_exposures_that_count_as_whole_periods_have_negligible_bands(
    bits: int, start: float, beyond: float, whole: int
) -> None:
    exposure = whole * (1 + beyond)
    weights = plane_weights(20, bits, 1.0, exposure, 0.037, start)
    if is_whole(exposure, 1.0):
        np.testing.assert_allclose(weights, 1, rtol=0, atol=1.01e-9 * 2**bits)
