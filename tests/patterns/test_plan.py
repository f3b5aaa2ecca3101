"""Reading plans: values, and refusal of invalid ones."""

from pathlib import Path
from typing import Any

import pytest

from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.patterns.plan import Plan

GOOD = """
fringes:
  - {axis: x, stripes: 1, steps: 12}
  - {axis: x, stripes: 8.5, steps: 6}
  - {axis: y, stripes: 64, steps: 4}
exposure_s: 2e-2
"""


def plan_of(text: str, tmp_path: Path) -> Plan:
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    return Plan.load(path)


def test_a_guided_axis_has_the_last_set_and_no_other() -> None:
    plan = Plan.load("plan_scan")
    assert plan.unwrapped_axes == ("x",)
    assert plan.along("y").unwrapping == "guided"
    assert plan.model_copy(update={"fringes": plan.fringes[::-1]}).guidance_fault()
    with pytest.raises(ConfigError, match="'guided_axis' is 'y': needs the last fringe set"):
        config.validate({**config.plain(Plan.load("plan_board")), "guided_axis": "y"}, Plan, "plan.yaml")


def test_a_plan_lists_its_images_in_order(tmp_path: Path) -> None:
    plan = plan_of(GOOD, tmp_path)
    assert plan.images == 22
    assert plan.axes == ("x", "y")
    assert plan.sets_along("x") == (0, 1)
    assert plan.set_starts == (0, 12, 18, 22)
    assert plan.exposure_s == 0.02
    steps = list(plan.steps())
    assert [(i, n) for i, n, _ in steps] == [
        (i, n) for i, count in enumerate((12, 6, 4)) for n in range(count)
    ]
    assert steps[0][2] == "00-x-1-000of12"
    assert steps[13][2] == "01-x-8.5-001of6"
    assert len({name for _, _, name in steps}) == 22


def test_sets_come_from_few_stripes_to_many(tmp_path: Path) -> None:
    text = "fringes: [{axis: y, stripes: 9, steps: 3}, {axis: y, stripes: 2, steps: 3}]"
    assert plan_of(text, tmp_path).sets_along("y") == (1, 0)
    assert plan_of(text, tmp_path).sets_along("x") == ()


def test_what_is_written_is_read(tmp_path: Path) -> None:
    plan = plan_of(GOOD, tmp_path)
    assert plan_of(config.dump(plan), tmp_path) == plan


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("steps: 12", "steps: 2", r"'fringes\[0\].steps' is 2: should be greater than or equal to 3"),
        ("steps: 12", "steps: 1001", r"'fringes\[0\].steps' is 1001: should be less than or equal to 1000"),
        ("steps: 12", "steps: 12.0", r"'fringes\[0\].steps' is 12.0"),
        ("steps: 12", "steps: yes", r"'fringes\[0\].steps' is True"),
        ("stripes: 8.5", "stripes: 0", r"'fringes\[1\].stripes' is 0: should be greater than 0"),
        ("stripes: 8.5", "stripes: -8", r"'fringes\[1\].stripes' is -8"),
        ("stripes: 8.5", "stripes: .nan", r"'fringes\[1\].stripes' is nan: should be a finite number"),
        ("stripes: 8.5", "stripes: .inf", r"'fringes\[1\].stripes' is inf: should be a finite number"),
        ("axis: y", "axis: z", r"'fringes\[2\].axis' is 'z': should be 'x' or 'y'"),
        ("exposure_s: 2e-2", "exposure_s: 0", "'exposure_s' is 0: should be greater than 0"),
        ("exposure_s: 2e-2", "exposure_s: 61", "'exposure_s' is 61: should be less than or equal to 60"),
        ("exposure_s: 2e-2", "exposure_s: 20 ms", "'exposure_s' is '20 ms': should be a valid number"),
        ("exposure_s: 2e-2", "exposure: 0.02", "unknown key 'exposure'"),
        ("exposure_s: 2e-2", "order_vote: {windows: 5}", "'order_vote.windows"),
        ("exposure_s: 2e-2", "order_vote: {window: 1}", "'order_vote.window' is 1: "),
        (
            "exposure_s: 2e-2",
            "trigger: loose",
            "'trigger' is 'loose': should be 'stepped', 'triggered' or 'followed'",
        ),
        ("stripes: 8.5, steps: 6", "stripes: 8.5", r"'fringes\[1\].steps' is missing"),
        ("steps: 6}", "steps: 6, shift_sign: 0}", r"'fringes\[1\].shift_sign' is 0: should be 1 or -1"),
        (
            "steps: 6}",
            "steps: 6, projector_size: [912, 1140]}",
            "every fringe set must name the same projector_size, or none",
        ),
        ("steps: 6}", "steps: 6, projector_size: [912]}", r"'fringes\[1\].projector_size\[1\]' is missing"),
    ],
)
def test_a_wrong_plan_is_refused(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    assert old in GOOD
    with pytest.raises(ConfigError, match=rf"plan\.yaml: {complaint}"):
        plan_of(GOOD.replace(old, new), tmp_path)


def test_a_plan_without_fringes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="'fringes' is missing"):
        plan_of("exposure_s: 0.02", tmp_path)
    with pytest.raises(ConfigError, match=r"'fringes' is \[\]"):
        plan_of("fringes: []", tmp_path)


def test_stripes_finer_than_the_projector_are_refused(tmp_path: Path) -> None:
    plan = plan_of(GOOD, tmp_path)
    plan.check_projector((18, 128), "rig.yaml")
    with pytest.raises(
        ConfigError, match=r"rig.yaml: 'fringes\[2\].stripes' is 64: more than half .* 127 .* 63.5"
    ):
        plan.check_projector((18, 127), "rig.yaml")
    with pytest.raises(
        ConfigError, match=r"'fringes\[1\].stripes' is 8.5: more than half .* 16 pixels along x"
    ):
        plan.check_projector((16, 128), "rig.yaml")


def test_fringes_of_another_projector_are_refused(tmp_path: Path) -> None:
    plan = plan_of("fringes: [{axis: x, stripes: 4, steps: 3, projector_size: [64, 48]}]", tmp_path)
    assert plan.projector_size == (64, 48)
    plan.check_projector((64, 48), "s")
    with pytest.raises(
        ConfigError, match=r"s: 'projector_size' is \[64, 48\] but the projector has \[48, 64\]"
    ):
        plan.check_projector((48, 64), "s")


def test_exposures_are_several_for_every_image(tmp_path: Path) -> None:
    plan = plan_of(GOOD, tmp_path)
    assert (plan.exposures, plan.frames) == ((0.02,), 22)
    assert "exposures_s" not in config.dump(plan)
    several = plan_of(GOOD.replace("exposure_s: 2e-2", "exposures_s: [0.08, 0.005, 0.02]"), tmp_path)
    assert (several.exposures, several.images, several.frames) == ((0.08, 0.005, 0.02), 22, 66)
    assert several.exposure_s == 0.02  # that of single pictures: in the middle
    assert plan_of(config.dump(several), tmp_path) == several
    with pytest.raises(ConfigError, match="plan: 'exposures_s' has 3 exposures, but this takes one"):
        several.refuse_exposures("this")


SETS = {
    "twice": ([0.02, 0.02], None, "names an exposure twice"),
    "unlike finest": ([0.02], [0.08], "of the finest sets along x and y must be the same"),
}


@pytest.mark.parametrize(("first", "second", "complaint"), SETS.values(), ids=SETS.keys())
def test_exposures_of_sets_that_do_not_fit_are_refused(first: Any, second: Any, complaint: str) -> None:
    sets = [
        {"axis": axis, "stripes": 1, "steps": 4, "exposures_s": own}
        for axis, own in (("x", first), ("y", second))
    ]
    with pytest.raises(ConfigError, match=complaint):
        config.validate({"fringes": sets}, Plan, "plan")
    mixed = {"fringes": [{"kind": "even", "levels": [1]}, {**sets[0], "exposures_s": [0.02]}]}
    with pytest.raises(ConfigError, match="needs a plan of fringes alone"):
        config.validate(mixed, Plan, "plan")


def test_exposures_of_sets_are_passes_over_some_images() -> None:
    sets = [
        {"axis": "x", "stripes": 1, "steps": 3, "exposures_s": [0.08]},
        {"axis": "x", "stripes": 8, "steps": 4},
    ]
    plan = config.validate({"fringes": sets, "exposures_s": [0.02, 0.08]}, Plan, "plan")
    assert plan.exposures == (0.08, 0.02)
    assert plan.passes == (tuple(range(7)), (3, 4, 5, 6))
    assert (plan.pass_starts, plan.frames) == ((0, 7, 11), 11)
    assert plan.part_at(0.08) is plan
    assert plan.part_at(0.02).sets == plan.sets[1:]
    with pytest.raises(ConfigError, match="set has its own 'exposures_s', but a search takes those of the"):
        plan.refuse_set_exposures("a search")


@pytest.mark.parametrize("wrong", ["[0.02]", "[0.02, 0.02]", "[0.02, 0]", "0.02", "[0.02, long]"])
def test_wrong_exposures_are_refused(tmp_path: Path, wrong: str) -> None:
    with pytest.raises(ConfigError, match="exposures_s"):
        plan_of(GOOD.replace("exposure_s: 2e-2", f"exposures_s: {wrong}"), tmp_path)
