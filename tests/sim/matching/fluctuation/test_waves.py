"""Random changes and swings in series of known truth."""

from __future__ import annotations

import numpy as np
import pytest

from fpplab.core.conventions import Floats
from sim.matching.fluctuation.waves import Series, change_of

FRAMES, SETS = np.arange(8, 32, dtype=np.float64), np.repeat([0, 1, 2], 8)
NOISE = np.array([[4.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 25.0]]) * 1e-8


def series(random: np.random.Generator, values: Floats, noise: Floats = NOISE) -> Series:
    """With noise, and another mean in each fringe set."""
    count, size = values.shape
    noisy = values + random.multivariate_normal(np.zeros(size), noise[:size, :size], count)
    noisy += random.normal(0, 1.0, (3, size))[SETS]
    return Series(FRAMES, SETS, noisy, np.broadcast_to(noise[:size, :size], (count, size, size)))


def swing(random: np.random.Generator, rms: Floats, cycles: float) -> Floats:
    wave = np.sqrt(2.0) * np.sin(2 * np.pi * (cycles * FRAMES + random.random()))
    return np.outer(wave, rms)


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_is_no_change(seed: int) -> None:
    random = np.random.default_rng(seed)
    found = change_of([series(random, np.zeros((24, 3))) for _ in range(6)])
    assert found.size == 0.0
    assert found.gained == 0.0


def test_random_changes_are_told_by_size() -> None:
    random = np.random.default_rng(1)
    found = change_of([series(random, random.normal(0, 2e-3, (24, 3))) for _ in range(6)])
    assert not found.random.line.any()
    assert not found.swing.any()
    assert found.random.alike == pytest.approx(2e-3, rel=0.15)
    assert abs(found.random.alike - 2e-3) < 3 * found.sigma * 2e-3
    assert found.sigma < 0.1


def test_random_changes_along_a_line_are_told_by_direction() -> None:
    random, line = np.random.default_rng(2), np.array([3e-3, -1e-3, 0.5e-3])
    found = change_of([series(random, np.outer(random.standard_normal(24), line)) for _ in range(6)])
    assert not found.swing.any()
    size = np.linalg.norm(found.random.line)
    assert size == pytest.approx(np.linalg.norm(line), rel=0.2)
    assert abs(found.random.line @ line) / size / np.linalg.norm(line) > 0.99
    assert found.random.alike < 0.05 * size


@pytest.mark.parametrize("cycles", [0.07, 0.125, 0.31, 0.44])
def test_a_swing_is_told_from_random_changes(cycles: float) -> None:
    random, rms = np.random.default_rng(3), np.array([0.5e-3, 3e-3, -1e-3])
    seen = [
        series(random, swing(random, rms, cycles) + np.outer(random.normal(0, 0.5, 24), rms))
        for _ in range(6)
    ]
    found = change_of(seen)
    assert found.cycles_per_frame == pytest.approx(cycles, abs=max(4 * found.cycles_sigma, 1e-4))
    assert found.cycles_sigma < 2e-3
    assert np.linalg.norm(found.swing) == pytest.approx(np.linalg.norm(rms), rel=0.15)
    assert abs(found.swing @ rms) / np.linalg.norm(found.swing) / np.linalg.norm(rms) > 0.99


def test_faults_across_the_line_are_no_swing() -> None:
    """They go in step with the phase steps, eight to a fringe set; vibration is along x."""
    random, line, fault = np.random.default_rng(6), np.array([4e-3, 1e-3, 0]), np.array([0, 0, 2e-3])
    seen = [
        series(random, np.outer(random.standard_normal(24), line) + swing(random, fault, 0.125))
        for _ in range(6)
    ]
    found = change_of(seen)
    assert not found.swing.any()
    assert abs(found.random.line @ line) / np.linalg.norm(found.random.line) / np.linalg.norm(line) > 0.97
    along = [series(random, swing(random, line, 0.31) + swing(random, fault, 0.125)) for _ in range(6)]
    both = change_of(along)
    assert both.cycles_per_frame == pytest.approx(0.31, abs=2e-3)
    assert np.linalg.norm(both.swing) == pytest.approx(np.linalg.norm(line), rel=0.1)


@pytest.mark.nightly
def test_frequencies_lie_as_near_as_their_uncertainty_says() -> None:
    """Errors of many swings over their standard uncertainties."""
    errors = []
    for seed in range(30):
        random = np.random.default_rng([seed, 9])
        cycles = float(random.uniform(0.06, 0.44))
        values = [swing(random, np.array([1e-3]), cycles) + random.normal(0, 1e-3, (24, 1)) for _ in range(4)]
        found = change_of([series(random, one) for one in values])
        if found.swing.any():
            errors.append((found.cycles_per_frame - cycles) / found.cycles_sigma)
    assert len(errors) > 20
    assert np.mean(np.abs(errors) < 2) > 0.85


def test_few_frames_tell_no_frequency() -> None:
    random = np.random.default_rng(4)
    whole = series(random, swing(random, np.array([3e-3]), 0.2))
    some = [Series(whole.frames[:8], SETS[:8], whole.values[:8], whole.covariance[:8])] * 3
    assert not change_of(some).swing.any()
