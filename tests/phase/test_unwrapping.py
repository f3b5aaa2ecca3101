"""Synthetic wavelengths, the projector's edges, and contradictions between sets."""

import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fpplab.core.errors import ConfigError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.phase.consistency import chi2_of_sets, contradiction
from fpplab.phase.demodulation import AxisPhases
from fpplab.phase.unwrapping import wavelength_sequence
from tests.phase.reference_decoder import fuse, unwrap


def make_plan(stripes, unwrapping="hierarchical", steps=4, axis="x", **more):
    fringes = tuple(Sinusoid(axis=axis, stripes=float(s), steps=steps) for s in stripes)
    return Plan(fringes=fringes, unwrapping=unwrapping, **more)


def wrapped(plan, position, noise=0.0, seed=0):
    """Wrapped phases (K, P) in rad of positions 0 … 1, fewest stripes first."""
    generator = np.random.default_rng(seed)
    stripes = [plan.fringes[i].stripes for i in plan.sets_along("x")]
    phase = 2 * np.pi * np.multiply.outer(stripes, position)
    return (phase + generator.normal(0, noise, phase.shape) if noise else phase) % (2 * np.pi)


def test_hierarchical_wavelengths_are_the_sets_by_their_stripes():
    sequence = wavelength_sequence(make_plan([64, 1, 8]), "x", "plan")
    assert sequence.sets == (1, 2, 0)
    assert [r.stripes for r in sequence.wavelengths] == [1, 8, 64]
    assert [r.coefficients for r in sequence.wavelengths] == [(1, 0, 0), (0, 1, 0), (0, 0, 1)]


def test_heterodyne_wavelengths_are_the_beats_and_the_sets():
    sequence = wavelength_sequence(make_plan([64, 49, 56], "heterodyne"), "x", "plan")
    assert [(r.stripes, r.coefficients) for r in sequence.wavelengths] == [
        (1, (1, -2, 1)),
        (7, (-1, 1, 0)),
        (8, (0, -1, 1)),
        (15, (-1, 0, 1)),
        (49, (1, 0, 0)),
        (56, (0, 1, 0)),
        (64, (0, 0, 1)),
    ]


@pytest.mark.parametrize(
    ("stripes", "unwrapping", "message"),
    [
        (
            [8, 64],
            "hierarchical",
            r"f\.yaml: 'fringes' along x .* 8, 64 .*at most 1 stripe, .* is 8; add",
        ),
        ([10, 20, 30], "heterodyne", r"f\.yaml: .* 10, 20, 30 stripes: heterodyne .* they stop at 10; for"),
        ([60, 64], "heterodyne", r"beats of neighbours that reach at most 1 stripe, and they stop at 4"),
        ([5], "heterodyne", r"they stop at 5"),
    ],
)
def test_an_ambiguous_plan_is_refused(stripes, unwrapping, message):
    with pytest.raises(ConfigError, match=message):
        wavelength_sequence(make_plan(stripes, unwrapping), "x", "f.yaml")


@given(
    stripes=st.lists(st.integers(2, 200), min_size=1, max_size=4, unique=True),
    unwrapping=st.sampled_from(["hierarchical", "heterodyne"]),
)
def test_the_stripes_that_a_refusal_names_do(stripes, unwrapping):
    try:
        wavelength_sequence(make_plan(stripes, unwrapping), "x", "plan")
    except ConfigError as error:
        named = re.search(r"for example stripes ([\d., ]*\d)", str(error))
        assert named
        remedy = [float(s) for s in named[1].split(",")]
        assert wavelength_sequence(make_plan(remedy, unwrapping), "x", "plan").wavelengths[0].stripes <= 1
    else:
        assume(False)


@settings(deadline=None)
@given(
    ratios=st.lists(st.floats(1.05, 12), max_size=4),
    base=st.floats(0.5, 1.0),
)
def test_any_number_of_sets_climbs_to_the_truth(ratios, base):
    stripes = base * np.cumprod([1.0, *ratios])
    plan = make_plan(stripes)
    position = np.linspace(0.01, 0.99, 200)
    found = unwrap(wrapped(plan, position), wavelength_sequence(plan, "x", "plan"))
    np.testing.assert_allclose(found.position, position, atol=1e-9)
    assert found.disagreement.max() < 1e-6


@settings(deadline=None)
@given(fine=st.integers(20, 200), step=st.integers(3, 14))
def test_heterodyne_climbs_to_the_truth(fine, step):
    assume(fine > 2 * step)
    plan = make_plan([fine, fine - step, fine - 2 * step + 1], "heterodyne")
    position = np.linspace(0.01, 0.99, 200)
    found = unwrap(wrapped(plan, position), wavelength_sequence(plan, "x", "plan"))
    np.testing.assert_allclose(found.position, position, atol=1e-9)
    assert found.is_unambiguous.all()


@pytest.mark.parametrize("stripes", [(1, 8, 64), (1, 9.43, 142.05), (0.9, 7, 50), (0.9, 9, 90)])
def test_the_base_may_wrap_at_the_edges(stripes):
    plan = make_plan(stripes)
    sequence, width = wavelength_sequence(plan, "x", "plan"), 912
    position = np.repeat((np.array([0, 1, width - 2, width - 1]) + 0.5) / width, 5000)
    sigma = 0.03 / (2 * np.pi * stripes[-1])
    found = unwrap(wrapped(plan, position, noise=0.03, seed=3), sequence, sigma, edge_margin=0.05 / width)
    off = np.abs(found.position - position)[found.is_unambiguous]
    assert off.max() < 6 * sigma
    assert found.is_unambiguous.mean() > 0.999


def test_what_lies_at_the_edge_of_repeating_stripes_is_not_certain():
    plan = make_plan([1, 8, 64])
    sequence = wavelength_sequence(plan, "x", "plan")
    found = unwrap(wrapped(plan, np.array([0.0, 1e-5, 0.01, 1 - 1e-5])), sequence, sigma=1e-5)
    np.testing.assert_array_equal(found.is_unambiguous, [False, False, True, False])


def test_light_from_beyond_the_projector_is_not_certain():
    plan = make_plan([0.5, 5.3, 40.7])
    found = unwrap(wrapped(plan, np.array([-0.2, 0.5, 1.3])), wavelength_sequence(plan, "x", "plan"))
    np.testing.assert_array_equal(found.is_unambiguous, [False, True, False])


@pytest.mark.parametrize("bias", [0.3, -0.3])
def test_a_biased_base_shows_as_a_contradiction_with_its_sign(bias):
    plan = make_plan([1, 16])
    phases = wrapped(plan, np.full(1, 0.4))
    phases[0] += 2 * np.pi * bias / 16
    sequence = wavelength_sequence(plan, "x", "plan")
    found = unwrap(phases, sequence)
    assert found.position == pytest.approx(0.4)
    assert found.disagreement == pytest.approx(0.3)
    assert contradiction(seen(plan, phases), sequence, (0.0, 1.0)) == pytest.approx(bias)


def seen(plan, phases, sigma=1e-3):
    stripes = np.array([plan.fringes[i].stripes for i in plan.sets_along("x")])
    variance = np.full(phases.shape, sigma**2)
    return AxisPhases(phases, variance, np.zeros_like(variance), stripes, counted_share=1.0)


@pytest.mark.parametrize(
    ("stripes", "unwrapping"), [((1, 5.5, 40), "hierarchical"), ((49, 56, 64), "heterodyne")]
)
@pytest.mark.parametrize("interval", [(0.0, 1.0), (0.2, 0.5), (-1.0, 2.0)])  # the last holds both of the base
def test_few_pixels_agree_as_the_reference_has_it(stripes, unwrapping, interval):
    plan = make_plan(stripes, unwrapping)
    sequence = wavelength_sequence(plan, "x", "plan")
    phases = np.random.default_rng(5).uniform(0, 2 * np.pi, (3, 400))  # of any disagreement
    measured = seen(plan, phases)
    known = unwrap(phases, sequence, measured.position_sigma[-1], interval=interval)
    signed = np.sign(known.second_best_order) * known.disagreement
    np.testing.assert_allclose(contradiction(measured, sequence, interval), signed, atol=1e-12)
    chi2 = chi2_of_sets(measured, known.position)
    np.testing.assert_allclose(chi2, fuse(measured, known.position).chi2, rtol=1e-9)
