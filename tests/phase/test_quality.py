"""The formula of phase noise, and the masks."""

from __future__ import annotations

import numpy as np
import pytest

from fpplab.core.conventions import phase_steps
from fpplab.patterns.plan import MaskRules
from fpplab.phase.quality import (
    coordinate_uncertainty,
    measurable,
    phase_uncertainty,
)

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


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({}, True),
        ({"modulation": 3.9, "offset": 30.0, "misfit": 0.5}, False),
        ({"modulation": 4.0, "offset": 30.0, "misfit": 0.5}, True),
        ({"offset": 401.0}, False),
        ({"misfit": 10.1}, False),
        ({"misfit": 10.0}, True),
        ({"peak": 255.0}, False),
        ({"peak": 254.0}, True),
    ],
)
def test_each_rule_rejects_by_itself(change, kept):
    pixel = {"modulation": 40.0, "offset": 100.0, "misfit": 1.0, "peak": 200.0} | change
    maps = {name: np.array([value]) for name, value in pixel.items()}
    assert measurable(**maps, rules=MaskRules(), full_scale=255) == [kept]


def test_darkness_is_not_measured_whatever_the_rules():
    rules = MaskRules(modulation_min=0.0, contrast_min=0.0)
    zero = np.zeros(1)
    assert not measurable(zero, zero, zero, zero, rules, 255).any()
