"""Synthetic wavelengths, the projector's edges, and the repair of fringe orders."""

import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fpplab.core.errors import ConfigError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import OrderVote, Plan
from fpplab.phase.order_vote import vote_orders
from fpplab.phase.reference import unwrap
from fpplab.phase.unwrapping import wavelength_sequence


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


def test_a_biased_base_shows_as_disagreement():
    plan = make_plan([1, 16])
    phases = wrapped(plan, np.full(1, 0.4))
    phases[0] += 2 * np.pi * 0.3 / 16
    sequence = wavelength_sequence(plan, "x", "plan")
    found = unwrap(phases, sequence)
    assert found.position == pytest.approx(0.4)
    assert found.disagreement == pytest.approx(0.3)
    other = unwrap(phases, sequence, changed_order=found.second_best_order)
    assert other.position == pytest.approx(0.4 + 1 / 16)
    assert other.disagreement == pytest.approx(0.7)


def test_a_majority_repairs_an_order():
    truth = np.add.outer(np.linspace(0, 5, 30), np.linspace(100, 140, 40)).astype(np.float32)
    generator = np.random.default_rng(2)
    wrong = generator.permutation(truth.size)[:200]
    coordinate = truth.copy()
    coordinate.reshape(-1)[wrong] += 20
    backed = vote_orders(coordinate, wrong, truth.ravel()[wrong].astype(float), window=7, period=20.0)
    np.testing.assert_array_equal(coordinate, truth)
    assert backed.all()


def test_a_lonely_pixel_is_neither_changed_nor_backed():
    coordinate = np.full((9, 9), np.nan, np.float32)
    coordinate[4, 4] = 50.0
    backed = vote_orders(coordinate, np.array([40]), np.array([70.0]), window=5, period=20.0)
    assert coordinate[4, 4] == 50.0
    assert not backed.any()


@pytest.mark.parametrize(("agreeing", "backed"), [(1, False), (12, False), (13, True)])
def test_only_a_majority_of_the_measured_neighbours_backs_a_pixel_without_alternative(agreeing, backed):
    coordinate = np.full((5, 5), 100.0, np.float32)
    coordinate.reshape(-1)[:agreeing] = 50.5
    coordinate[2, 2] = 50.0
    if agreeing > 12:  # the pixel itself lies among the first
        coordinate.reshape(-1)[agreeing] = 50.5
    found = vote_orders(coordinate, np.array([12]), np.array([np.nan]), window=5, period=20.0)
    assert found.tolist() == [backed]
    assert coordinate[2, 2] == 50.0


@pytest.mark.parametrize("window", [4, 1, 53])
def test_a_window_without_a_centre_is_refused(window):
    with pytest.raises(ValueError, match="window"):
        OrderVote(window=window)
