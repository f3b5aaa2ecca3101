"""The formula of phase noise."""

import numpy as np
import pytest

from fpplab.core.conventions import phase_steps
from fpplab.phase.precision import coordinate_uncertainty, phase_uncertainty

PIXELS = 20_000


@pytest.mark.parametrize("steps", [3, 4, 5, 12])
def test_the_law_of_phase_noise(steps):
    generator = np.random.default_rng(steps)
    phase, shift = generator.uniform(0, 2 * np.pi, PIXELS), phase_steps(steps)[:, None]
    frames = 100 + 40 * np.cos(phase - shift) + generator.normal(0, 2, (steps, PIXELS))
    measured = np.angle(np.sum(frames * np.exp(1j * shift), axis=0) * np.exp(-1j * phase))
    assert measured.std() == pytest.approx(float(phase_uncertainty(2.0, 40.0, steps)), rel=0.03)


def test_repeats_and_stripes_lower_the_uncertainty():
    assert phase_uncertainty(2.0, 40.0, 4, repeats=9) == pytest.approx(phase_uncertainty(2.0, 40.0, 4) / 3)
    assert coordinate_uncertainty(np.pi, 10, 200) == pytest.approx(10.0)
