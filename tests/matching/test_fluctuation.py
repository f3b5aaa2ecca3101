"""Flicker and rolling bands of a bench, as a matching finds them where there are some."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fpplab.matching import light
from fpplab.matching.fluctuation import Variances, changes_of_set
from fpplab.matching.steps import FIRST_STEPS, MatchingContext
from fpplab.patterns.fringe_sets import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.simulation.matchable import TwinParameters
from tests.matching.test_matching import reference_of, truth
from tests.support.plane_twin import PlaneTwin

__all__ = ["truth"]  # a fixture

PLAN = Plan(fringes=tuple(Sinusoid(axis=axis, stripes=24, steps=8) for axis in ("x", "y")))
SHAKEN_MM = 0.01


def judged(name: str, bench: TwinParameters, start: TwinParameters) -> tuple[TwinParameters, float]:
    """What a step proposes, and by how much its criterion falls."""
    reference, twin = reference_of(bench, plan=PLAN), PlaneTwin(start)
    samples = light.sample_pixels(reference, start, [0], [0])
    at = MatchingContext(reference, twin, samples, "white")
    step = next(one for one in FIRST_STEPS if one.name == name)
    assert step.misfit is not None
    before = step.misfit(at)
    proposed = step.propose(at)
    assert twin.parameters is start
    twin.become(proposed)
    return proposed, before - step.misfit(at)


@pytest.mark.slow
@pytest.mark.parametrize("flicker", [0.002, 0.01])
def test_flicker_of_a_shaking_bench_is_found(truth: TwinParameters, flicker: float) -> None:
    bench = replace(truth, projector_flicker=flicker, vibration_mm=SHAKEN_MM)
    proposed, gained = judged("flicker", bench, truth)
    assert gained > 20
    assert proposed.projector_flicker == pytest.approx(flicker, rel=0.25)
    assert abs(proposed.projector_flicker - flicker) < 3 * proposed.sigma["projector_flicker"]
    assert proposed.sigma["projector_flicker"] < 0.2 * flicker


@pytest.mark.slow
def test_steady_light_of_a_shaking_bench_has_no_flicker(truth: TwinParameters) -> None:
    proposed, gained = judged("flicker", replace(truth, vibration_mm=SHAKEN_MM), truth)
    assert gained <= 0
    assert proposed.projector_flicker < 3e-4


@pytest.mark.slow
def test_rolling_bands_are_found(truth: TwinParameters) -> None:
    lit = replace(truth, ambient=0.05)
    bench = replace(lit, ambient_ripple=0.3, band_period_px=37.0, vibration_mm=SHAKEN_MM)
    proposed, gained = judged("rolling bands", bench, lit)
    assert gained > 20
    assert proposed.ambient_ripple == pytest.approx(0.3, rel=0.3)
    assert abs(proposed.ambient_ripple - 0.3) < 3 * proposed.sigma["ambient_ripple"]
    assert proposed.band_period_px == pytest.approx(37.0, rel=0.05)
    assert abs(proposed.band_period_px - 37.0) < 4 * proposed.sigma["band_period_px"]


@pytest.mark.slow
def test_steady_light_of_a_shaking_bench_has_no_bands(truth: TwinParameters) -> None:
    bench = replace(truth, vibration_mm=SHAKEN_MM, projector_flicker=0.005)
    _, gained = judged("rolling bands", bench, truth)
    assert gained <= 0


def test_motion_of_fringes_is_no_flicker() -> None:
    """Every frame is shifted by a hundredth of a radian, and by a gain of a thousandth."""
    random, fringe = np.random.default_rng(3), Sinusoid(axis="x", stripes=24, steps=12)
    phase, pixels = random.uniform(0, 2 * np.pi, 5000), random.integers(0, 300, (2, 5000))
    shifted = phase - fringe.phase_shifts()[:, None] + random.normal(0, 0.01, (12, 1))
    gains = random.normal(0, 0.001, (12, 1))
    slopes = random.normal(0, 5, (2, 5000))
    moved = random.normal(0, 0.01, (12, 2)) @ slopes / 100
    levels = (1 + gains + moved) * (100 + 80 * np.cos(shifted)) + random.normal(0, 1, shifted.shape)
    places = (pixels[0], pixels[1])
    told = changes_of_set(levels, slopes, places, fringe)
    found = np.sqrt(told.gain_square - told.gain_noise)
    assert found == pytest.approx(0.001, rel=0.4)
    alone = changes_of_set(levels / (1 + gains), slopes, places, fringe)
    assert alone.gain_square < 3 * alone.gain_noise


def test_a_further_variance_is_found_beside_noise() -> None:
    random, count = np.random.default_rng(2), 400
    noise = np.full(count, 2.0)
    values = random.normal(0, np.sqrt(2.0 + 3.0), count)
    told = Variances(values**2, noise, np.ones(count))
    assert told.further == pytest.approx(3.0, rel=0.2)
    assert told.criterion(told.further, 1) < told.criterion(0.0, 0) - 20
    alone = Variances(random.normal(0, np.sqrt(2.0), count) ** 2, noise, np.ones(count))
    assert alone.criterion(alone.further, 1) > alone.criterion(0.0, 0)
