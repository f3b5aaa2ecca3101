"""True error over reported sigma, noise and common errors together: simulated recordings, decoded whole."""

import numpy as np
import pytest

from benchmarks.limit_noise import Bench, ratios_of, simulated
from fpplab.patterns.phase_error import phase_error
from fpplab.phase import decode


@pytest.mark.parametrize("steps", [3, 4, 6, 12])
@pytest.mark.parametrize("g", [1.0, 1.1, 1.3])
@pytest.mark.parametrize(("bits", "ink", "flicker"), [(8, 1.0, 0.0), (8, 0.1, 0.005), (12, 0.1, 0.0)])
def test_the_reported_uncertainty_is_the_error(
    steps: int, g: float, bits: int, ink: float, flicker: float
) -> None:
    known, unknown = ratios_of(Bench(steps, g, bits, ink, flicker), seeds=(5,))
    assert 0.88 < known < 1.12
    assert 0.8 < unknown < 1.25


def test_averaging_lessens_sigma_and_leaves_the_phase_error() -> None:
    """Repeated three times with other noise: the mean keeps the phase error that was reported."""
    bench, decoded = Bench(3, 1.1), []
    for seed in range(3):
        recording, u = simulated(bench, seed)
        maps = decode(recording)
        error = (maps.u - u)[maps.valid]
        phase = 2 * np.pi * 64 / 912 * (u[maps.valid] + 0.5)
        # The harmonic that three steps take for the fringe, found in thousands of pixels.
        decoded.append(
            (2 * np.mean(error * np.sin(3 * phase)), np.median(maps.sigma_phase_error[maps.valid]))
        )
    amplitude, told = np.mean(decoded, axis=0)
    assert abs(amplitude) / np.sqrt(2) == pytest.approx(told, rel=0.05)
    assert told == pytest.approx(phase_error(1.1, 3) * 912 / (2 * np.pi * 64), rel=0.05)


@pytest.mark.parametrize("exposure", [1.3, 1.6])
def test_saturated_pixels_report_their_uncertainty(exposure: float) -> None:
    known, _ = ratios_of(Bench(12, 1.033, exposure=exposure), seeds=(6,))
    assert 0.85 < known < 1.15
