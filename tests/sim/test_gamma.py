"""The response of the simulated projector is measured correctly and compensated in the patterns."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.acquisition.acquire import expose
from fpplab.core import config
from fpplab.core.conventions import TWO_PI, Floats, Mask
from fpplab.devices.rig import Rig
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns, uniform_patterns
from fpplab.patterns.phase_error import judge_response, phase_error, shown_phase_error
from fpplab.patterns.plan import GreyLevels, Plan
from fpplab.patterns.response import Response
from fpplab.phase import wrapped_phase
from fpplab.pipeline.response import measure_response
from sim.world import World
from tests.sim.conftest import RIG, plain, write_world

EXPOSURE_S = 0.02
STRIPES = 16.0
"""So few that a pixel of this small camera sees 2 of a fringe's 57 mirrors and does not average them away."""
QUIET = {"full_well_e": 1e9, "read_noise_e": 0.0}
BRIGHT = {"green": {"lumens": 1e4, "wavelength_nm": 525}}
"""With 10 000 lumens on such a sensor shot noise is 0.003 % of full scale."""
HIDDEN = {"a": 0.65, "b": 0.056, "g": 1.033}
STRAIGHT = {"a": 1.0, "b": 0.0, "g": 1.0}


def data(response: dict[str, float], quiet: bool) -> dict[str, Any]:
    """A small bench whose projector has that response."""
    small = plain()
    camera = {**small["camera"], **({"sensor": QUIET} if quiet else {})}
    projector = {**small["projector"], "response": response, **({"leds": BRIGHT} if quiet else {})}
    return {**small, "camera": camera, "projector": projector, "mounted": "card"}


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """One open virtual bench that is given one world after another."""
    folder = tmp_path_factory.mktemp("rig")
    write_world(folder, data(STRAIGHT, quiet=False))
    (folder / "rig.yaml").write_text(RIG)
    with Rig.load(folder / "rig.yaml") as bench:
        yield bench


def become(rig: Rig, response: dict[str, float], quiet: bool = False) -> None:
    world = config.validate(data(response, quiet), World, "test world")
    rig.projector._bench.replace_world(world)  # type: ignore[attr-defined]
    rig.need_fixture("the test").mount("card")


def phase(rig: Rig, steps: int, response: Response | None = None) -> tuple[Floats, Mask]:
    """The phase that so many steps give, and where the fringes are strong."""
    curve = None if response is None else response.curve("response")
    fringe = Sinusoid(axis="x", stripes=STRIPES, steps=steps)
    plan = Plan(fringes=(fringe,), response=curve, exposure_s=EXPOSURE_S)
    caps = rig.projector.caps
    patterns = make_patterns(plan, caps.size, caps.lattice)
    with closing(expose(rig, patterns, rig.camera_settings(EXPOSURE_S), plan)) as shots:
        found = wrapped_phase([shot.image for shot in shots], fringe)
    return found.phase.astype(np.float64), found.modulation > 200.0


def rms(error: Floats) -> float:
    return float(np.sqrt(np.mean(((error + np.pi) % TWO_PI - np.pi) ** 2)))


@pytest.mark.whole
def test_precorrection_takes_the_response_out_of_three_steps(rig: Rig) -> None:
    """At g = 2.2, with the response as measured on the virtual bench itself.

    Against thirty steps, which neither the response nor the rounding of greys disturbs noticeably. What is
    left is the rounding to 256 greys, which blur and pixels average a little: it cannot exceed what is
    predicted for single mirrors.
    """
    become(rig, {"a": 1.0, "b": 0.0, "g": 2.2}, quiet=True)
    response, _ = measure_response(rig, EXPOSURE_S, GreyLevels(levels=16, repeats=2))
    assert response.g == pytest.approx(2.2, abs=max(5 * response.sigma[2], 1e-3))
    truth, strong = phase(rig, 30)
    bent, straight = (rms((phase(rig, 3, used)[0] - truth)[strong]) for used in (None, response))
    assert strong.mean() > 0.9
    assert bent == pytest.approx(phase_error(2.2, 3), rel=0.05)
    assert straight < 1.2 * shown_phase_error(Curve(a=1.0, b=0.0, g=2.2), 3, response)
    assert bent / straight >= 10


@pytest.mark.whole
def test_a_hidden_response_is_recovered(rig: Rig) -> None:
    """a and b are the projector's times the camera's gain, plus its black level; both are known otherwise.

    The gain is what the same bench sees of a projector with a = 1, b = 0, g = 1; the black level from the
    frame with the projector off. The normalised response needs neither.
    """
    become(rig, STRAIGHT)
    white = uniform_patterns([255], rig.projector.caps.size)
    with closing(expose(rig, white, rig.camera_settings(EXPOSURE_S))) as shots:
        seen = float(next(shots).image.mean()) / 4095
    become(rig, HIDDEN)
    found, _ = measure_response(rig, EXPOSURE_S, GreyLevels(levels=18, repeats=4))
    assert found.dark is not None
    assert found.dark[0] == pytest.approx(0.01, abs=1e-5)
    gain = seen - found.dark[0]
    recovered = (found.a / gain, (found.b - found.dark[0]) / gain, found.g)
    assert recovered == pytest.approx((0.65, 0.056, 1.033), rel=0.01)
    assert found.residual <= 0.002
    assert found.residual_sum is not None
    assert found.residual_sum <= 0.002
    assert found.normalised is not None
    assert found.normalised["a"] == pytest.approx(0.65 / 0.706, rel=0.01)
    assert found.normalised["b"] == pytest.approx(0.056 / 0.706, rel=0.01)
    assert len(found.regions) == 9
    assert found.region_spread is not None
    assert found.region_sigma is not None
    assert found.region_spread < 2 * found.region_sigma


@pytest.mark.whole
def test_where_white_is_full_scale_the_fit_gives_the_projectors_own_parameters(rig: Rig) -> None:
    """Without black level, and exposed so that irradiance 1 is full scale, a and b are the projector's."""
    become(rig, STRAIGHT)
    white = uniform_patterns([255], rig.projector.caps.size)
    with closing(expose(rig, white, rig.camera_settings(0.01))) as shots:
        gain = float(next(shots).image.mean()) / 4095 - 0.01
    become(rig, HIDDEN)
    found, _ = measure_response(rig, 0.01 * 0.99 / gain, GreyLevels(levels=18, repeats=4))
    # The black level is part of full scale: 0.99 of it are left for light.
    assert found.left_out == ()
    assert (found.a / 0.99, (found.b - 0.01) / 0.99, found.g) == pytest.approx((0.65, 0.056, 1.033), rel=0.01)


@pytest.mark.whole
def test_the_assessment_of_the_response_agrees_with_the_frames(rig: Rig, tmp_path: Path) -> None:
    become(rig, {"a": 1.0, "b": 0.0, "g": 2.2}, quiet=True)
    response, _ = measure_response(rig, EXPOSURE_S)
    response.save(tmp_path / "response.yaml")
    (tmp_path / "plan.yaml").write_text(
        "fringes: [{axis: x, stripes: 16, steps: 4}]\nresponse: response.yaml\n"
    )
    corrected = Plan.load(tmp_path / "plan.yaml")
    as_it_is = corrected.model_copy(update={"response": None})
    truth, strong = phase(rig, 30)
    size = rig.projector.caps.size
    told = judge_response(response, as_it_is, size)
    error = rms((phase(rig, 4)[0] - truth)[strong])
    assert told.phase_rad == pytest.approx(error, rel=0.15)
    assert judge_response(response, corrected, size).good_enough
