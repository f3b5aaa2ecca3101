"""Exposures chosen for a scene: what is foretold of them, and plans that are taken with them."""

import math
from pathlib import Path

import numpy as np
import pytest

from fpplab.acquisition.acquire import acquire
from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.patterns.plan import Plan
from fpplab.phase import decode
from fpplab.phase.coded_axes import coded_coordinate
from fpplab.phase.exposures import ExposureModel
from fpplab.phase.noise import NoiseModel
from fpplab.sessions.session import Session
from fpplab.setup.exposures import SceneLight, choose_exposures, measure_light
from fpplab.setup.live.exposure import ExposureLimits
from tests.support.faulty_rig import formula_rig

SIZE = 912, 1140
SETS = [{"axis": "x", "stripes": stripes, "steps": 4} for stripes in (1, 8, 60)]
PLAN = config.validate({"fringes": SETS}, Plan, "plan")
LIMITS = ExposureLimits((1e-4, 1.0), (0.0, 0.0))


def light_of(*offsets: float) -> SceneLight:
    """Parts of a scene by their raw levels per second."""
    offset = np.repeat(offsets, 100)
    model = ExposureModel(5.0, np.ones(1), NoiseModel(0.2, 0.025), 255.0)
    return SceneLight(offset, 0.9 * offset, 1.0, model, 8, len(offset))


def test_one_exposure_suits_an_even_scene_and_several_a_scene_of_dark_and_bright_parts() -> None:
    even = choose_exposures(light_of(1000.0), PLAN, SIZE, LIMITS, 3.0, most=1)
    assert even.completeness == 1.0
    assert even.exposures_s[0] == pytest.approx(0.13, rel=0.4)  # whose crests are just not saturated
    mixed = light_of(200.0, 30_000.0)
    single = choose_exposures(mixed, PLAN, SIZE, LIMITS, 12.0, most=1)
    several = choose_exposures(mixed, PLAN, SIZE, LIMITS, 12.0)
    assert single.completeness == 0.5
    assert several.completeness == 1.0
    assert several.seconds <= 12.0 * 1.001
    assert len(several.exposures_s) > 1


def test_time_that_is_too_short_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"--seconds is 0\.001: the plan's 12 images need at least 0\.0012"):
        choose_exposures(light_of(1000.0), PLAN, SIZE, LIMITS, 0.001)


def test_noise_is_foretold_as_it_falls_with_light() -> None:
    light = light_of(1000.0)
    (once, _), (twice, _) = (light.expected(PLAN, SIZE, (t,)) for t in (0.05, 0.1))
    assert once.all()
    assert twice.all()
    sigma = [float(light.expected(PLAN, SIZE, (t,))[1].mean()) for t in (0.05, 0.1)]
    variance = 0.2 + 0.025 * 100.0
    expected = 912 / (2 * math.pi * 60) * math.sqrt(2 / 4 * variance) / 90.0
    assert sigma[1] == pytest.approx(expected, rel=0.03)
    assert 1.4 < sigma[0] / sigma[1] < 2.0


GRAY = [{"kind": "gray", "axis": "x", "bits": 10}, {"kind": "even", "levels": [1, 0]}]
GRAY_ORDERS = [*SETS[2:], {"kind": "gray", "axis": "x", "bits": 6, "cell_px": 15.2}]


@pytest.mark.whole
@pytest.mark.parametrize("sets", [GRAY, GRAY_ORDERS])
def test_codes_need_several_exposures_for_dark_and_bright_parts_too(sets: list[dict[str, object]]) -> None:
    plan = config.validate({"fringes": sets}, Plan, "plan")
    mixed = light_of(200.0, 30_000.0)
    assert choose_exposures(mixed, plan, SIZE, LIMITS, 12.0, most=1).completeness == 0.5
    assert choose_exposures(mixed, plan, SIZE, LIMITS, 12.0, most=2).completeness == 1.0


def test_noise_of_a_code_is_foretold_as_its_plan_states_it() -> None:
    plan = config.validate({"fringes": GRAY}, Plan, "plan")
    measured, sigma = light_of(1000.0).expected(plan, SIZE, (0.1,))
    assert measured.all()
    noise = math.sqrt(0.2 + 0.025 * 100.0) / 90.0
    assert sigma.mean() == pytest.approx(coded_coordinate(plan, "x", SIZE, noise)[0], rel=0.05)


def test_a_rig_is_looked_at_and_measured_as_foretold(tmp_path: Path) -> None:
    with formula_rig(None, 3) as rig:
        light, limits, other_s = measure_light(rig, PLAN, 2.0)
        choice = choose_exposures(light, PLAN, rig.projector.caps.size, limits, 2.0, other_s)
        exposures_s = choice.exposures_s if len(choice.exposures_s) > 1 else (*choice.exposures_s, 0.0081)
        plan = PLAN.model_copy(update={"exposures_s": exposures_s})
        session = Session.create(tmp_path / "session", plan, rig.described())
        acquire(rig, plan, session)
    np.testing.assert_allclose([record.exposure_s for record in session.records], np.repeat(exposures_s, 12))
    decoded = decode(session.recording())
    assert decoded.valid.sum() == pytest.approx(choice.completeness * light.pixels, rel=0.1)
    assert np.sqrt(np.nanmean(decoded.sigma**2)) == pytest.approx(choice.sigma_px, rel=0.1)
