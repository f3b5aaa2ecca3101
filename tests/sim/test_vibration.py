"""Vibration along a line: how much, in which direction, and in step with the frames."""

import numpy as np
import pytest

from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from sim.effects.vibration import vibration_displacement_mm, wave_phase
from sim.world import World
from tests.sim.conftest import world

RMS = (0.03, -0.01, 0.02)


def moves(of: World, frames: int, phase: float = 0.0) -> Floats:
    return np.array(
        [vibration_displacement_mm(of, np.random.default_rng(n), n, phase) for n in range(frames)]
    )


def test_a_swing_is_a_sine_along_its_line() -> None:
    of = world(vibration_line={"rms_mm": RMS, "periodic": 1.0, "cycles_per_frame": 0.05})
    expected = np.sqrt(2.0) * np.sin(2 * np.pi * (0.05 * np.arange(40) + 0.3))
    np.testing.assert_allclose(moves(of, 40, 0.3), np.outer(expected, RMS), atol=1e-12)


def test_the_rest_along_the_line_is_random_and_both_have_the_stated_size() -> None:
    of = world(vibration_line={"rms_mm": RMS, "periodic": 0.4, "cycles_per_frame": 0.137})
    found = moves(of, 4000)
    along = found @ np.array(RMS) / np.dot(RMS, RMS)
    np.testing.assert_allclose(found, np.outer(along, RMS), atol=1e-12)
    assert np.sqrt(np.mean(along**2)) == pytest.approx(1.0, rel=0.05)
    wave = 2 * np.mean(along * np.exp(-2j * np.pi * 0.137 * np.arange(4000)))
    assert abs(wave) == pytest.approx(np.sqrt(2 * 0.4), rel=0.08)


def test_vibration_in_all_directions_comes_beside_it() -> None:
    of = world(vibration_mm=0.05, vibration_line={"rms_mm": RMS})
    found = moves(of, 4000)
    expected = 0.05**2 * np.eye(3) + np.outer(RMS, RMS)
    np.testing.assert_allclose(np.cov(found.T), expected, atol=3e-4)
    assert of.moves_mm == pytest.approx(np.sqrt(0.05**2 + np.dot(RMS, RMS)))
    np.testing.assert_array_equal(
        moves(world(vibration_mm=0.05), 3)[1], 0.05 * np.random.default_rng(1).standard_normal(3)
    )


def test_phases_follow_from_seed_and_numbers() -> None:
    assert wave_phase(world(seed=1), 2) == wave_phase(world(seed=1), 2)
    assert len({wave_phase(world(seed=1), n) for n in range(5)} | {wave_phase(world(seed=2), 0)}) == 6


def test_impossible_vibration_is_refused() -> None:
    with pytest.raises(ConfigError, match="rms_mm"):
        world(vibration_line={"rms_mm": [11.0, 0.0, 0.0]})
    with pytest.raises(ConfigError, match="periodic"):
        world(vibration_line={"rms_mm": RMS, "periodic": 1.5})
