"""A lamp of the room as a matching finds it, where there is one."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.core.conventions import Floats
from fpplab.patterns.fringes import uniform_patterns
from sim.effects.room_lamp import ROOM_LAMP
from sim.matching.samples import sample_pixels
from sim.matching.steps import FIRST_STEPS, MatchingContext, MatchingStep
from sim.parameters import ADJUSTABLE, TwinParameters
from tests.sim.matching.test_matching import reference_of
from tests.support.plane_twin import SETTINGS, PlaneTwin, nominal, tilted

LAMP = {
    "lamp_irradiance": 0.06,
    "lamp_angle_deg": 58.0,
    "lamp_azimuth_deg": -110.0,
    "lamp_distance_mm": 900.0,
}


@pytest.fixture(scope="module")
def truth() -> TwinParameters:
    return replace(nominal(tilted(6, seed=4)), white=0.9, ink=0.08, ambient=0.02)


def lamp_step() -> MatchingStep:
    return next(step for step in FIRST_STEPS if step.name == "room lamp")


def judged_lamp(bench: TwinParameters, start: TwinParameters) -> tuple[TwinParameters, float]:
    """What the step proposes, and by how much its criterion falls."""
    reference, twin = reference_of(bench), PlaneTwin(start)
    samples = sample_pixels(reference, start, range(len(start.poses)), range(2))
    at, step = MatchingContext(reference, twin, samples, "white"), lamp_step()
    assert step.misfit is not None
    before = step.misfit(at)
    proposed = step.propose(at)
    return proposed, before - step.misfit(at.with_parameters(proposed))


def room_light(parameters: TwinParameters) -> Floats:
    """Levels of the room's light over the poses, without the black level."""
    twin = PlaneTwin(parameters)
    black = 255 * parameters.black_level
    dark = replace(parameters, response=parameters.response.model_copy(update={"a": 1e-9, "b": 0.0}))
    twin = twin.with_parameters(dark)
    pattern = uniform_patterns([0], parameters.calibration.projector.size)
    return np.stack([twin.expected(n, pattern, SETTINGS)[0] - black for n in range(len(parameters.poses))])


@pytest.mark.whole
def test_lamp_is_found(truth: TwinParameters) -> None:
    """From a twin that has taken its light for ambient light."""
    bench = replace(truth, **LAMP)
    proposed, gained = judged_lamp(bench, replace(truth, ambient=0.05))
    assert gained > 20
    errors = {
        name: (ADJUSTABLE[name].read(proposed) - ADJUSTABLE[name].read(bench)) / proposed.sigma[name]
        for name in ROOM_LAMP
    }
    assert max(map(abs, errors.values())) < 4, errors
    found, true = room_light(proposed), room_light(bench)
    board = true > 1
    assert np.ptp(true[board]) > 3
    # An even part of it can be light from closed mirrors as well.
    assert np.std((found - true)[board]) < 0.1 * np.std(true[board])


@pytest.mark.whole
def test_even_room_has_no_lamp(truth: TwinParameters) -> None:
    """Four parameters more explain nothing."""
    proposed, _ = judged_lamp(truth, truth)
    assert proposed.lamp_irradiance == 0.0
    assert "lamp_angle_deg" not in proposed.sigma
