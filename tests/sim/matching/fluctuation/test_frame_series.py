"""Random changes and oscillations in series of known truth."""

import numpy as np
import pytest

from fpplab.core.conventions import Floats
from sim.matching.fluctuation import frame_series
from sim.matching.fluctuation.frame_series import RowProfile, Series, fit_along_rows, fit_fluctuation

FRAMES, SETS = np.arange(8, 32, dtype=np.float64), np.repeat([0, 1, 2], 8)
NOISE = np.array([[4.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 25.0]]) * 1e-8


def series(random: np.random.Generator, values: Floats, noise: Floats = NOISE) -> Series:
    """With noise, and another mean in each fringe set."""
    count, size = values.shape
    noisy = values + random.multivariate_normal(np.zeros(size), noise[:size, :size], count)
    noisy += random.normal(0, 1.0, (3, size))[SETS]
    return Series(FRAMES, SETS, noisy, np.kron(np.eye(count), noise[:size, :size]))


def wave_of(random: np.random.Generator, rms: Floats, cycles: float) -> Floats:
    wave = np.sqrt(2.0) * np.sin(2 * np.pi * (cycles * FRAMES + random.random()))
    return np.outer(wave, rms)


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_is_no_change(seed: int) -> None:
    random = np.random.default_rng(seed)
    found = fit_fluctuation([series(random, np.zeros((24, 3))) for _ in range(6)])
    assert found.size == 0.0
    assert found.gained == 0.0


def test_random_changes_are_told_by_size() -> None:
    random = np.random.default_rng(1)
    found = fit_fluctuation([series(random, random.normal(0, 2e-3, (24, 3))) for _ in range(6)])
    assert not found.random.axis.any()
    assert not found.oscillation.any()
    assert found.random.isotropic == pytest.approx(2e-3, rel=0.15)
    assert abs(found.random.isotropic - 2e-3) < 3 * found.sigma * 2e-3
    assert found.sigma < 0.1


def test_random_changes_along_a_line_are_told_by_direction() -> None:
    random, line = np.random.default_rng(2), np.array([3e-3, -1e-3, 0.5e-3])
    found = fit_fluctuation([series(random, np.outer(random.standard_normal(24), line)) for _ in range(6)])
    assert not found.oscillation.any()
    size = np.linalg.norm(found.random.axis)
    assert size == pytest.approx(np.linalg.norm(line), rel=0.2)
    assert abs(found.random.axis @ line) / size / np.linalg.norm(line) > 0.99
    assert found.random.isotropic < 0.05 * size


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("cycles", [0.07, 0.125, 0.31, 0.44])
def test_a_swing_is_told_from_random_changes(cycles: float) -> None:
    random, rms = np.random.default_rng(3), np.array([0.5e-3, 3e-3, -1e-3])
    seen = [
        series(random, wave_of(random, rms, cycles) + np.outer(random.normal(0, 0.5, 24), rms))
        for _ in range(6)
    ]
    found = fit_fluctuation(seen)
    assert found.cycles_per_frame == pytest.approx(cycles, abs=max(4 * found.cycles_sigma, 1e-4))
    assert found.cycles_sigma < 2e-3
    assert np.linalg.norm(found.oscillation) == pytest.approx(np.linalg.norm(rms), rel=0.15)
    assert abs(found.oscillation @ rms) / np.linalg.norm(found.oscillation) / np.linalg.norm(rms) > 0.99


@pytest.mark.parametrize("cycles", [0.4995, 0.499])
def test_a_swing_of_two_frames_is_not_stated_too_large(cycles: float) -> None:
    """Frames at two places of it alone do not show how far it goes beyond; the scatter between poses does."""
    random = np.random.default_rng(7)
    poses = [series(random, wave_of(random, np.array([2e-3]), cycles)) for _ in range(6)]
    found = fit_fluctuation(poses)
    assert found.cycles_per_frame == pytest.approx(cycles, abs=0.01)
    assert found.size == pytest.approx(2e-3, rel=0.5)


def test_faults_across_the_line_are_no_swing() -> None:
    """They go in step with the phase steps, eight to a fringe set; vibration is along x."""
    random, line, fault = np.random.default_rng(6), np.array([4e-3, 1e-3, 0]), np.array([0, 0, 2e-3])
    seen = [
        series(random, np.outer(random.standard_normal(24), line) + wave_of(random, fault, 0.125))
        for _ in range(6)
    ]
    found = fit_fluctuation(seen)
    assert not found.oscillation.any()
    assert abs(found.random.axis @ line) / np.linalg.norm(found.random.axis) / np.linalg.norm(line) > 0.97
    along = [series(random, wave_of(random, line, 0.31) + wave_of(random, fault, 0.125)) for _ in range(6)]
    both = fit_fluctuation(along)
    assert both.cycles_per_frame == pytest.approx(0.31, abs=2e-3)
    assert np.linalg.norm(both.oscillation) == pytest.approx(np.linalg.norm(line), rel=0.1)


@pytest.mark.nightly
def test_frequencies_lie_as_near_as_their_uncertainty_says() -> None:
    """Errors of many oscillates over their standard uncertainties."""
    errors = []
    for seed in range(30):
        random = np.random.default_rng([seed, 9])
        cycles = float(random.uniform(0.06, 0.44))
        values = [
            wave_of(random, np.array([1e-3]), cycles) + random.normal(0, 1e-3, (24, 1)) for _ in range(4)
        ]
        found = fit_fluctuation([series(random, one) for one in values])
        if found.oscillation.any():
            errors.append((found.cycles_per_frame - cycles) / found.cycles_sigma)
    assert len(errors) > 20
    assert np.mean(np.abs(errors) < 2) > 0.85


def test_few_frames_tell_no_frequency() -> None:
    random = np.random.default_rng(4)
    whole = series(random, wave_of(random, np.array([3e-3]), 0.2))
    some = [Series(whole.frames[:8], SETS[:8], whole.values[:8], whole.covariance[:8, :8])] * 3
    assert not fit_fluctuation(some).oscillation.any()


def test_sets_of_one_image_show_no_changes() -> None:
    frames = np.arange(2.0)
    alone = Series(frames, np.array([0, 1]), np.array([[1e-3], [5e-3]]), 1e-8 * np.eye(2))
    assert fit_fluctuation([alone] * 3).size == 0.0


def test_an_oscillation_is_fitted_where_no_random_changes_were() -> None:
    random = np.random.default_rng(8)
    poses = [series(random, wave_of(random, np.array([3e-3]), 0.21)) for _ in range(4)]
    found = frame_series._with_oscillation(poses, 0.0, 0.0)
    assert found.cycles_per_frame == pytest.approx(0.21, abs=1e-3)
    assert found.oscillation[0] == pytest.approx(3e-3, rel=0.1)


ROWS = RowProfile(np.linspace(100.5, 249.5, 150), np.ones(150))


def light_of_rows(random: np.random.Generator, rms: float, cycles: float, turn_per_px: float) -> Series:
    """Level and gradient of light that oscillates, with noise."""
    turns = np.exp(2j * np.pi * (cycles * FRAMES + random.random()))
    level, gradient = ROWS.of_wave(turn_per_px)
    values = np.sqrt(2.0) * rms * np.column_stack([(turns * level).imag, (turns * gradient).imag])
    noisy = values + random.multivariate_normal(np.zeros(2), NOISE[:2, :2], len(FRAMES))
    return Series(FRAMES, SETS, noisy, np.kron(np.eye(len(FRAMES)), NOISE[:2, :2]), ROWS)


def test_level_and_gradient_of_a_wave_are_those_of_its_integrals() -> None:
    x = 0.008 * 74.5  # rad from the middle row to the last
    level, gradient = ROWS.of_wave(0.008)
    assert level == pytest.approx(np.sin(x) / x, rel=3e-3)
    assert gradient == pytest.approx(3j * (np.sin(x) - x * np.cos(x)) / x**2, rel=0.02)
    np.testing.assert_allclose(ROWS.gradient(np.array([100.5, 175.0, 249.5])), [-1, 0, 1], atol=1e-12)


def test_light_of_rows_is_weighted_by_its_square() -> None:
    profile = RowProfile.of(np.repeat([10, 20, 73], [1, 2, 1]), np.array([1.0, 2.0, 2.0, 3.0]))
    assert profile.weights.sum() == 18.0
    assert profile.weights[[0, -1]].tolist() == [1.0, 9.0]


@pytest.mark.parametrize("turn_per_px", [2 * np.pi / 500, -2 * np.pi / 500, 2 * np.pi / 160])
def test_a_wave_along_the_rows_is_found_where_one_frame_shows_a_part_of_it(turn_per_px: float) -> None:
    random = np.random.default_rng(5)
    seen = [light_of_rows(random, 3e-3, 0.11, turn_per_px) for _ in range(4)]
    levels = [Series(one.frames, one.sets, one.values[:, :1], one.covariance[::2, ::2]) for one in seen]
    in_step = fit_fluctuation(levels)
    found = fit_along_rows(seen, in_step)
    assert found.fluctuation.gained > in_step.gained + 20
    assert abs(found.turn_per_px - turn_per_px) < 4 * found.turn_sigma
    assert found.turn_sigma < 0.05 * abs(turn_per_px)
    assert found.fluctuation.oscillation[0] == pytest.approx(3e-3, rel=0.03)
    assert found.fluctuation.cycles_per_frame == pytest.approx(0.11, abs=1e-3)


def test_light_that_is_equal_in_all_rows_has_no_wave() -> None:
    random = np.random.default_rng(7)
    seen = [light_of_rows(random, 3e-3, 0.11, 0.0) for _ in range(4)]
    levels = [Series(one.frames, one.sets, one.values[:, :1], one.covariance[::2, ::2]) for one in seen]
    in_step = fit_fluctuation(levels)
    found = fit_along_rows(seen, in_step)
    assert found.fluctuation.gained < in_step.gained
    assert abs(found.turn_per_px) < 4 * found.turn_sigma
