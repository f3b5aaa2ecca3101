"""The projector's falloff as a matching finds it, where there is one."""

from dataclasses import replace

import numpy as np

from fpplab.core.conventions import Floats
from sim.effects.falloff import FALLOFF
from sim.matching.samples import sample_pixels
from sim.matching.steps import FIRST_STEPS, MatchingContext, MatchingStep
from sim.parameters import TwinParameters, named_numbers
from tests.sim.matching.test_matching import reference_of, truth
from tests.support.plane_twin import PAIR, PROJECTOR, PlaneTwin

__all__ = ["truth"]  # a fixture

FALLEN_OFF = (0.05, -0.1, -0.3, 0.04, -0.2)


def falloff_step() -> MatchingStep:
    return next(step for step in FIRST_STEPS if step.name == "projector falloff")


def judged_falloff(bench: TwinParameters, start: TwinParameters) -> tuple[TwinParameters, float]:
    """What the step proposes, and by how much its criterion falls."""
    reference, twin = reference_of(bench), PlaneTwin(start)
    samples = sample_pixels(reference, start, range(len(start.poses)), range(2))
    at, step = MatchingContext(reference, twin, samples, "white"), falloff_step()
    assert step.misfit is not None
    before = step.misfit(at)
    proposed = step.propose(at)
    return proposed, before - step.misfit(at.with_parameters(proposed))


def test_falloff_of_the_projector_is_found(truth: TwinParameters) -> None:
    """Where board and light meet: its coefficients are known no better than that part of the image shows."""
    proposed, gained = judged_falloff(replace(truth, projector_falloff=FALLEN_OFF), truth)
    assert gained > 20
    off = (np.array(proposed.projector_falloff) - FALLEN_OFF) / [proposed.sigma[n] for n in FALLOFF]
    assert np.abs(off).max() < 4
    field, true = (
        falloff_over_the_board(one, truth) for one in (proposed, replace(truth, projector_falloff=FALLEN_OFF))
    )
    assert np.ptp(true) > 0.02
    assert np.abs(field / field.mean() / (true / true.mean()) - 1).max() < 0.01  # white takes the rest


def falloff_over_the_board(parameters: TwinParameters, truth: TwinParameters) -> Floats:
    field = PlaneTwin(parameters)._falloff()
    corners = np.array([[x, y, 0.0] for x in (-20, 0, 20) for y in (-12, 0, 12)])
    places = np.concatenate([PROJECTOR.project(pose.apply(corners), PAIR) for pose in truth.poses])
    return np.array([field[int(v), int(u)] for u, v in places])


def test_even_light_has_no_falloff(truth: TwinParameters) -> None:
    """The criterion rises, for five parameters explain nothing; so the step is not accepted."""
    proposed, gained = judged_falloff(truth, truth)
    assert gained < 0
    assert max(np.abs(proposed.projector_falloff)) < 0.1


def test_numbers_of_a_matching_name_each_coefficient(truth: TwinParameters) -> None:
    numbers = named_numbers(replace(truth, projector_falloff=FALLEN_OFF))
    assert tuple(numbers[name] for name in FALLOFF) == FALLEN_OFF
    assert all(value is None or isinstance(value, float) for value in numbers.values()), numbers
