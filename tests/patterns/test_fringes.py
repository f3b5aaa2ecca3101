"""Patterns follow the conventions, on both lattices, at every bit depth."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.acquisition.acquire import acquire
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.core.errors import CapabilityError, ConfigError, DataError
from fpplab.devices import CameraSettings, Frame
from fpplab.devices.rig import Rig
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns, pattern_image, quantise, uniform_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response
from fpplab.sessions.session import Session

SIZE = (48, 20)


@given(
    axis=st.sampled_from(["x", "y"]),
    lattice=st.sampled_from(list(Lattice)),
    stripes=st.floats(0.5, 10.0),
    steps=st.integers(3, 12),
    sign=st.sampled_from([1, -1]),
    origin=st.floats(-10, 10),
    data=st.data(),
)
def test_a_mirror_shows_the_cosine_of_its_own_place(axis, lattice, stripes, steps, sign, origin, data):
    fringe = Sinusoid(axis=axis, stripes=stripes, steps=steps, shift_sign=sign, phase_origin_rad=origin)
    n, i, j = (data.draw(st.integers(0, limit - 1)) for limit in (steps, SIZE[0], SIZE[1]))
    u = i + 0.5 * (j % 2) if lattice is Lattice.DIAMOND else i
    place, length = (u, SIZE[0]) if axis == "x" else (j, SIZE[1])
    phase = 2 * np.pi * stripes * (place + 0.5) / length + origin - sign * 2 * np.pi * n / steps
    level = fringe.level(n, SIZE, lattice)
    assert level.shape == (SIZE[1], SIZE[0])
    assert level[j, i] == pytest.approx(0.5 + 0.5 * np.cos(phase), abs=1e-9)


@pytest.mark.parametrize("depth", range(1, 9))
def test_quantising_rounds_to_the_greys_of_the_depth(depth):
    level = np.linspace(0, 1, 1001)
    shown = quantise(level, depth)
    assert shown.dtype == np.uint8
    assert len(np.unique(shown)) == 2**depth
    assert {shown[0], shown[-1]} == {0, 255}
    half_a_grey = 0.5 * 255 / (2**depth - 1)
    assert np.abs(shown - 255 * level).max() <= half_a_grey + 0.5


def test_patterns_come_in_the_plans_order_under_telling_names():
    plan = Plan(fringes=(Sinusoid(axis="y", stripes=8, steps=4), Sinusoid(axis="x", stripes=1.5, steps=3)))
    patterns = make_patterns(plan, SIZE, Lattice.SQUARE)
    assert [p.id for p in patterns] == [
        *(f"00-y-8-{n:03d}of4" for n in range(4)),
        *(f"01-x-1.5-{n:03d}of3" for n in range(3)),
    ]
    for (index, step, _), pattern in zip(plan.steps(), patterns, strict=True):
        level = plan.fringes[index].level(step, SIZE, Lattice.SQUARE)
        np.testing.assert_array_equal(pattern.image, np.rint(255 * level))


@pytest.mark.parametrize("lattice", Lattice)
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize(("few", "many"), [(6, 12), (3, 9), (5, 15), (7, 21)])
def test_every_so_manyth_pattern_is_that_of_fewer_steps_to_the_last_grey(axis, lattice, few, many):
    some, all_of_them = (
        make_patterns(Plan(fringes=(Sinusoid(axis=axis, stripes=4, steps=n),)), SIZE, lattice)
        for n in (few, many)
    )
    for one, same in zip(some, all_of_them[:: many // few], strict=True):
        np.testing.assert_array_equal(one.image, same.image)


@pytest.mark.parametrize("lattice", Lattice)
@pytest.mark.parametrize("size", [(24, 20), (23, 19), (24, 1)])
def test_a_pattern_is_drawn_in_part_and_repeated(lattice, size):
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=3.7, steps=3), Sinusoid(axis="y", stripes=0.4, steps=3)))
    for index, step, _ in plan.steps():
        whole = quantise(plan.fringes[index].level(step, size, lattice))
        np.testing.assert_array_equal(pattern_image(plan, index, step, size, lattice), whole)


def test_stripes_finer_than_two_pixels_are_refused():
    plan = Plan(fringes=(Sinusoid(axis="y", stripes=11, steps=4),))
    with pytest.raises(
        ConfigError, match=r"'fringes\[0\].stripes' is 11: more than half .* 20 pixels along y"
    ):
        make_patterns(plan, SIZE, Lattice.SQUARE)


def test_uniform_images_are_uniform():
    patterns = uniform_patterns([0, 7, 255], SIZE)
    assert [p.id for p in patterns] == ["grey-000", "grey-007", "grey-255"]
    for pattern, grey in zip(patterns, (0, 7, 255), strict=True):
        np.testing.assert_array_equal(pattern.image, np.full((SIZE[1], SIZE[0]), grey))


FRINGES = (Sinusoid(axis="x", stripes=4, steps=3),)
CURVE = Curve(a=0.8, b=0.1, g=2.2)


def test_corrected_patterns_give_the_nearest_light_to_a_sinusoid():
    for pattern, (index, step, _) in zip(
        make_patterns(Plan(fringes=FRINGES, response=CURVE), SIZE, Lattice.DIAMOND),
        Plan(fringes=FRINGES).steps(),
        strict=True,
    ):
        wanted = FRINGES[index].level(step, SIZE, Lattice.DIAMOND)
        light = (CURVE.apply(pattern.image / 255.0) - CURVE.b) / CURVE.a
        # One grey is at most g/255 of light; rounding is off by half of it.
        assert np.abs(light - wanted).max() <= 0.5 * CURVE.g / 255 + 1e-12
        for other in (-1, 1):
            beside = np.clip(pattern.image.astype(int) + other, 0, 255)
            # The nearest grey, by the grey that would be exact.
            exact = 255 * wanted ** (1 / CURVE.g)
            assert np.all(np.abs(pattern.image - exact) <= np.abs(beside - exact) + 1e-9)


def test_black_and_white_stay_what_they_are():
    assert quantise(CURVE.correct([0.0, 1.0])).tolist() == [0, 255]


def test_patterns_of_another_response_are_other_patterns():
    plain, bent = Plan(fringes=FRINGES), Plan(fringes=FRINGES, response=CURVE)
    first, second = (make_patterns(plan, SIZE, Lattice.SQUARE) for plan in (plain, bent))
    assert [p.id for p in first] == [p.id for p in second]
    assert not np.array_equal(first[0].image, second[0].image)
    assert make_patterns(plain, SIZE, Lattice.SQUARE)[0] is first[0]
    again = bent.model_copy(update={"response": Curve(a=0.8, b=0.1, g=1.8)})
    assert not np.array_equal(make_patterns(again, SIZE, Lattice.SQUARE)[0].image, second[0].image)
    np.testing.assert_array_equal(pattern_image(bent, 0, 1, SIZE, Lattice.SQUARE), second[1].image)


def response_file(folder: Path, **changes: float) -> Path:
    values = {"a": 0.8, "b": 0.1, "g": 2.2, **changes}
    Response(**values, sigma=(0.001, 0.001, 0.002), residual=0.001, levels=16).save(folder / "response.yaml")
    return folder / "response.yaml"


def plan_file(folder: Path, response: str) -> Path:
    path = folder / "plan.yaml"
    path.write_text("fringes: [{axis: x, stripes: 4, steps: 3}]\nresponse: " + response)
    return path


def test_a_plan_names_a_response_file_beside_it_and_holds_its_values(tmp_path):
    response_file(tmp_path)
    plan = Plan.load(plan_file(tmp_path, "response.yaml"))
    assert plan.response == CURVE
    assert Plan.load(plan_file(tmp_path, str(tmp_path / "response.yaml"))) == plan
    assert Plan.load(plan_file(tmp_path, "{a: 0.8, b: 0.1, g: 2.2}")) == plan
    assert "response.yaml" not in config.dump(plan)


@pytest.mark.parametrize(
    ("named", "words"),
    [
        ("elsewhere.yaml", "plan.yaml: 'response' must name a file .* elsewhere.yaml: there is no such file"),
        (
            "plan.yaml",
            "'response' must name a file written by `fpplab gamma`: .*is a plan; expected a response file",
        ),
        ("{a: 1.0, b: 0.0, g: 9.0}", "'g' is 9: patterns can be corrected for an exponent of 0.5 to 5"),
        ("{a: 1.0, b: 0.0}", "'response.g' is missing"),
        ("{a: -1.0, b: 0.0, g: 2.0}", "'response.a' is -1.0: should be greater than 0"),
        ("3", "'response' is 3"),
    ],
)
def test_a_response_that_is_none_is_refused(tmp_path, named, words):
    with pytest.raises(ConfigError, match=words):
        Plan.load(plan_file(tmp_path, named))


def test_a_response_file_that_cannot_be_inverted_is_refused(tmp_path):
    response_file(tmp_path, g=0.2)
    with pytest.raises(ConfigError, match=r"response.yaml: 'g' is 0.2: patterns can be corrected"):
        Plan.load(plan_file(tmp_path, "response.yaml"))


def test_levels_and_repeats_of_the_response_are_the_plans(tmp_path):
    greys = Plan.load(plan_file(tmp_path, "{a: 0.8, b: 0.1, g: 2.2}\ngreys: {levels: 24, repeats: 5}")).greys
    assert (greys.levels, greys.repeats) == (24, 5)


@pytest.mark.parametrize("wrong", ["levels: 4", "levels: 257", "repeats: 0"])
def test_too_few_levels_or_repeats_are_refused(tmp_path, wrong):
    name, value = wrong.split(": ")
    with pytest.raises(ConfigError, match=f"'greys.{name}' is {value}: should be"):
        Plan.load(plan_file(tmp_path, "{a: 0.8, b: 0.1, g: 2.2}\ngreys: {" + wrong + "}"))


def recorded(path: Path, plan: Plan) -> Session:
    session = Session.create(path, plan, None)
    (path / "rig.yaml").write_text(
        "resolved: {projector: {model: none, size: [48, 20], lattice: square}}\n", encoding="utf-8"
    )
    for _, _, name in plan.steps():
        frame = Frame(np.full((6, 8), 7, np.uint8), len(session.records), CameraSettings(0.02), 0.0)
        session.write(frame.showing(name, len(session.records)))
    return session


def test_a_session_keeps_the_correction_and_its_replay_agrees(tmp_path):
    bent = Plan(fringes=FRINGES, response=CURVE)
    recorded(tmp_path / "recorded", bent)
    assert Session.open(tmp_path / "recorded").plan == bent
    (tmp_path / "rig.yaml").write_text(
        'name: replay\nbench: {backend: "fpplab.sessions.replay:RecordedSession", session: recorded}\n'
        'camera: {backend: "fpplab.sessions.replay:ReplayCamera"}\n'
        'projector: {backend: "fpplab.sessions.replay:ReplayProjector"}\n'
    )
    with Rig.load(tmp_path / "rig.yaml") as rig:
        acquire(rig, bent, Session.create(tmp_path / "again", bent, rig.described()))
        plain = Plan(fringes=FRINGES)
        with pytest.raises(CapabilityError, match="was not recorded"):
            acquire(rig, plain, Session.create(tmp_path / "other", plain, rig.described()))


def test_a_scan_is_not_resumed_with_another_correction(tmp_path):
    recorded(tmp_path / "recorded", Plan(fringes=FRINGES, response=CURVE))
    with pytest.raises(DataError, match="begun with another plan"):
        Session.resume(tmp_path / "recorded", Plan(fringes=FRINGES), complete_too=True)
