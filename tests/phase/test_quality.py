"""Noise from the frames themselves, the formula of phase noise, and the masks."""

from __future__ import annotations

import numpy as np
import pytest

from fpplab.core.conventions import phase_steps
from fpplab.patterns.fringe_sets import Sinusoid
from fpplab.patterns.plan import MaskRules
from fpplab.phase.quality import (
    QUANTISATION,
    coordinate_uncertainty,
    fit_noise,
    measurable,
    phase_uncertainty,
)

PIXELS = 20_000


def scene(generator, offset=(40, 160), modulation=30.0, harmonics=()):
    """A generator of noise-free samples (N, P): all offsets, random phases, harmonics if wanted."""
    a = generator.uniform(*offset, PIXELS)
    phase = generator.uniform(0, 2 * np.pi, PIXELS)

    def sample(steps):
        theta = phase - phase_steps(steps)[:, None]
        wave = np.cos(theta) + sum(c * np.cos(k * theta) for k, c in harmonics)
        return a + modulation * wave

    return sample


def sets(*steps):
    return [Sinusoid(axis="x", stripes=1, steps=n) for n in steps]


def noisy(generator, level, constant, per_level):
    noise = generator.standard_normal(level.shape) * np.sqrt(constant + per_level * level)
    return np.clip(np.rint(level + noise), 0, 255)


@pytest.mark.parametrize("steps", [(3, 3, 3), (4, 4, 4), (3, 5), (7,), (12, 12, 12)])
def test_noise_is_found_in_the_frames(steps):
    generator = np.random.default_rng(sum(steps))
    sample = scene(generator)
    model = fit_noise([noisy(generator, sample(n), 1.5, 0.05) for n in steps], sets(*steps), 255, 1.0)
    for level in (50, 100, 150):
        expected = 1.5 + 0.05 * level + QUANTISATION
        assert model.variance(level) == pytest.approx(expected, rel=0.1)


def test_a_response_that_is_not_linear_is_no_noise():
    generator = np.random.default_rng(5)
    sample = scene(generator, harmonics=((2, 0.15), (3, 0.05)))
    model = fit_noise([noisy(generator, sample(12), 2.0, 0.0) for _ in range(3)], sets(12, 12, 12), 255, 1.0)
    assert model.variance(100) == pytest.approx(2.0 + QUANTISATION, rel=0.1)


def test_moving_things_and_saturation_do_not_disturb_the_noise():
    generator = np.random.default_rng(6)
    frames = noisy(generator, scene(generator)(8), 4.0, 0.0)
    frames[3, : PIXELS // 20] += 60
    frames[:, -PIXELS // 5 :] = 255
    assert fit_noise([frames], sets(8), 255, 1.0).variance(100) == pytest.approx(4.0 + QUANTISATION, rel=0.1)


def test_grey_levels_are_those_of_eight_bits():
    generator = np.random.default_rng(7)
    level = 16 * scene(generator)(12)
    frames = np.rint(level + generator.normal(0, 16 * 1.5, level.shape))
    assert fit_noise([frames], sets(12), 4095, 1 / 16).variance(100) == pytest.approx(1.5**2, rel=0.1)


@pytest.mark.parametrize("steps", [(3,), (12,)])
def test_without_evidence_rounding_remains(steps):
    generator = np.random.default_rng(8)
    frames = [np.rint(scene(generator)(n))[:, : 50 if n > 3 else None] for n in steps]
    model = fit_noise(frames, sets(*steps), 255, 1.0)
    assert (model.constant, model.per_level) == (QUANTISATION, 0.0)


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
