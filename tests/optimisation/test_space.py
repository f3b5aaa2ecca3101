"""What a study may search: its parameters, the plans of its candidates, and what is refused."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.optimisation.candidate import Candidate
from fpplab.optimisation.space import Parameter, SearchSpace
from fpplab.optimisation.storage import Journal
from fpplab.optimisation.study import Study
from fpplab.patterns.fringe_sets import stepped_fringes
from fpplab.patterns.plan import Plan
from tests.support.searching import (
    FRINGES,
    FRONT,
    GRAY,
    PLAIN,
    runner_of,
    study,
    with_stage,
)


def test_plan_of_a_candidate_keeps_the_rest_of_the_template() -> None:
    like = Plan.load("plan_paper.yaml").model_copy(update={"settle_s": 0.1})
    candidate = Candidate((stepped_fringes("y", 1.0, 3), stepped_fringes("y", 9.5, 4)), 0.04, stage_mm=-3.0)
    plan = candidate.plan(like)
    assert [(f.axis, f.stripes, f.steps) for f in plan.fringes] == [("y", 1.0, 3), ("y", 9.5, 4)]
    assert (plan.exposure_s, plan.stage_mm, plan.settle_s) == (0.04, -3.0, 0.1)
    assert plan.masks == like.masks
    assert plan.images == candidate.images == 7


@given(
    share=st.floats(0, 1),
    bounds=st.tuples(st.floats(0.01, 10), st.floats(10.1, 1000)),
    ratio=st.booleans(),
)
def test_parameter_fraction_and_value_are_inverse(
    share: float, bounds: tuple[float, float], ratio: bool
) -> None:
    parameter = Parameter("stripes[1]", "stripes", *bounds, is_logarithmic=ratio)
    value = parameter.value_at(share)
    assert parameter.contains(value)
    slack = 0.0005 * (
        1 / bounds[0] / math.log(bounds[1] / bounds[0]) if ratio else 1 / (bounds[1] - bounds[0])
    )
    assert parameter.fraction(value) == pytest.approx(share, abs=slack + 1e-9)


@given(share=st.floats(0, 1))
def test_stage_parameter_is_rounded_to_its_grid(share: float) -> None:
    parameter = Parameter("stage_mm", "geometry", -60, 50, grid_step=25)
    assert parameter.value_at(share) in {-60, -35, -10, 15, 40, 50}
    assert abs(parameter.value_at(share) - (-60 + 110 * share)) <= 12.5


def test_start_point_stands_for_the_plan_of_the_start(tmp_path: Path) -> None:
    space = runner_of(tmp_path, **FRONT).space
    begin = space.candidate(space.start)
    assert begin == Candidate(tuple(stepped_fringes("x", float(s), 7) for s in (1, 8, 64)), 0.02, 0.0)


def test_a_code_is_searched_beside_sinusoids(tmp_path: Path) -> None:
    runner = runner_of(
        tmp_path, space={"steps": [[3, 12], None, None], "alternatives": [GRAY]}, objectives=["images"]
    )
    space = runner.space
    assert [p.name for p in space.parameters] == [
        "steps[0]",
        "alternative",
        "alternatives[0].bits[0]",
        "alternatives[0].cell_px[0]",
        "alternatives[0].steps[1]",
    ]
    assert space.candidate(space.start).images == 36
    coded = space.candidate((12, 1, 7, 9.5, 3))
    assert coded.images == 10
    code = coded.plan(space.problem.start).model_dump(mode="json", exclude_defaults=True)["fringes"][0]
    assert code == {"kind": "gray", "axis": "x", "bits": 7, "cell_px": 9.5}
    assert space.refusal(coded) is None
    assert "cells of 9.5 px need at least 7" in str(space.refusal(space.candidate((12, 1, 6, 9.5, 3))))
    journal = Journal(tmp_path / "study.jsonl", space.problem, {})
    journal.add(coded, 1, "no light")
    assert Journal(journal.path, space.problem, {}).get(coded, 1) == "no light"


def test_plan_of_fewer_sets_has_the_base_and_the_last_sets(tmp_path: Path) -> None:
    space = runner_of(
        tmp_path,
        space={
            "sets": [2, 4],
            "steps": [None, [3, 9], None, None],
            "stripes": [None, [2, 6], None, [12, 228]],
        },
    ).space
    names = [p.name for p in space.parameters]
    assert names == ["sets", "steps[1]", "stripes[1]", "stripes[3]"]
    assert [f.stripes for f in space.candidate(space.start).fringes] == [1, 8, 64]
    assert [f.stripes for f in space.candidate((2, 5, 3.0, 100.0)).fringes] == [1, 100]
    four = space.candidate((4, 5, 3.0, 100.0)).fringes
    assert [(f.stripes, f.steps) for f in four] == [(1, 12), (3, 5), (8, 12), (100, 12)]


def test_axis_exposure_and_geometry_are_parameters(tmp_path: Path) -> None:
    space = runner_of(
        tmp_path,
        space={"axis": ["x", "y"], "exposure_s": [0.01, 0.1], "convergence_deg": [-5, 5]},
    ).space
    assert [p.name for p in space.parameters] == ["axis", "exposure_s", "convergence_deg"]
    moved = space.candidate((1, 0.05, 2.0))
    assert {f.axis for f in moved.fringes} == {"y"}
    assert (moved.exposure_s, moved.convergence_deg, moved.stage_mm) == (0.05, 2.0, 0.0)


def test_fewer_bits_allow_shorter_exposures(tmp_path: Path) -> None:
    space = runner_of(tmp_path, space={"exposure_s": [0.0017, 0.1], "pattern_bits": [4, 8]}).space
    plans = [space.candidate((0.002, bits)) for bits in (4.0, 8.0, 5.0)]
    assert [{f.pattern_bits for f in c.fringes} for c in plans] == [{4}, {None}, {5}]
    assert [s.bit_depth for s in plans[0].plan(space.problem.start).sets] == [4, 4, 4]
    refusals = [space.refusal(candidate) for candidate in plans]
    assert refusals[0] is None
    assert "with 8 bits from 0.008333 s" in str(refusals[1])
    assert "'pattern_bits' is 5: its projector shows [1, 4, 8]" in str(refusals[2])


def test_infeasible_point_is_refused_with_its_reason(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, constraints={"images": 36})
    crossed, shown = runner.measure([(30.0, 20.0), (5.0, 40.0)])
    assert crossed.refused == "stripes along x do not increase from set to set"
    assert shown.measured
    assert runner.refused == {crossed.refused: 1}
    assert crossed.candidate not in [t.candidate for t in runner.trials]


BAD_SPACES: dict[str, tuple[dict[str, Any], str]] = {
    "empty": ({"space": {}}, "'space' leaves nothing to search"),
    "of one point": ({"space": {"stage_mm": [0, 0]}}, "'space' leaves nothing to search"),
    "upside down": ({"space": {"stage_mm": [5, -5]}}, "'stage_mm' is [5.0, -5.0]"),
    "without the start": ({"space": {"stage_mm": [5, 20]}}, "does not hold the start's 0"),
    "base searched": ({"space": {"stripes": [[0.9, 1.1], None, None]}}, "'space.stripes[0]' is the base"),
    "base not written": ({"space": {"stripes": [[2, 32], [12, 228]]}}, "has 2 bounds for 3 sets"),
    "beyond the projector": (
        {"space": {"stripes": [None, None, [12, 400]]}},
        "reaches 400, beyond rig 'Formula': 'fringes[2].stripes' is 400: at 4 projector pixels per period "
        "at most 228 along x",
    ),
    "beyond the stage": (
        {"space": {"stage_mm": [-60, 90]}},
        "'stage_mm' is 90: the stage travels from -60 to 60 mm",
    ),
    "beyond the bit depth": (
        {"space": {"exposure_s": [0.001, 0.1]}},
        "with 8 bits from 0.008333 s, which is 120 images per second",
    ),
    "stripes that cannot grow": (
        {"start": {"fringes": FRINGES[:2]}, "space": {"stripes": [None, [0.5, 0.9]]}},
        "does not hold the start's 8",
    ),
    "too many images": (
        {"space": {"steps": [[3, 12], [9, 12], [9, 12]]}, "constraints": {"images": 20}},
        "'constraints.images' is 20, and 'space' has no plan of fewer than 21",
    ),
    "two objectives, one method": (
        {"objectives": ["surface_smcd_um", "images"]},
        "'method.kind' is 'coordinate'",
    ),
    "objective unknown": ({"objectives": ["beauty"]}, "'objectives[0]' is 'beauty'"),
    "seed twice": ({"seeds": [1, 1]}, "names one twice"),
    "places without a stage": ({"space": {"stage_every_mm": 5}}, "is given without 'stage_mm'"),
    "no stage at the start": (
        {"start": {"fringes": FRINGES}, "space": {"stage_mm": [-5, 5]}},
        "'start' has no stage_mm to begin with",
    ),
    "an exposure beside several": (
        {"start": {"fringes": FRINGES, "exposures_s": [0.01, 0.05]}, "space": {"exposure_s": [0.01, 0.1]}},
        "'space' searches exposure_s, and 'start' has 'exposures_s'",
    ),
    "no number of the set": (
        {"space": {"alternatives": [{**GRAY, "ranges": [{"inverses": [1, 2]}, None]}]}},
        "'space.alternatives[0].inverses[0]' is no number of the set gray6; it has bits, cell_px, first_cell",
    ),
    "bound of a code": (
        {"space": {"alternatives": [{**GRAY, "ranges": [{"bits": [6, 20]}, None]}]}},
        "'space.alternatives[0].bits[0]'",
    ),
    "cannot be unwrapped": ({"start": {"fringes": FRINGES[1:]}}, "hierarchical unwrapping needs"),
}


@pytest.mark.parametrize(("changes", "words"), BAD_SPACES.values(), ids=BAD_SPACES.keys())
def test_contradictory_studies_are_refused(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        runner_of(tmp_path, **changes)
    assert str(refused.value).startswith("study.yaml")
    assert words in str(refused.value)


def test_the_base_of_guided_sets_is_searched(tmp_path: Path) -> None:
    start = {"fringes": FRINGES[1:], "unwrapping": "guided", "depth_mm": [400, 500]}
    space = runner_of(tmp_path, start=start, space={"stripes": [[5, 20], [30, 228]]}).space
    assert [p.name for p in space.parameters] == ["stripes[0]", "stripes[1]"]
    assert [f.stripes for f in space.candidate((12.0, 150.0)).fringes] == [12.0, 150.0]


def test_a_stage_is_needed_for_a_baseline(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="the rig has no stage"):
        runner_of(tmp_path, limits=with_stage(None), space={"stage_mm": [-5, 5]})


def test_study_for_another_rig_is_refused() -> None:
    study(rig="Formula").check_rig("Formula", "study.yaml")
    with pytest.raises(ConfigError, match="'rig' is 'Formula', but the rig given is 'Other'"):
        study(rig="Formula").check_rig("Other", "study.yaml")


@pytest.mark.parametrize("name", ["phases", "stripes", "stripes_gradient", "baseline", "pareto", "guided"])
def test_shipped_studies_suit_the_demonstration_rig(name: str) -> None:
    from fpplab.devices.rig import Rig
    from fpplab.optimisation.limits import RigLimits

    with Rig.load("rig_demo") as rig:
        limits = RigLimits.of(rig)
    known = Study.load(f"study_{name}")
    space = SearchSpace.of(known, limits, name)
    assert space.refusal(space.candidate(space.start)) is None
    assert limits.items is not None
    assert set(known.artefacts) <= limits.items


def test_files_of_a_study_are_found_beside_it(tmp_path: Path) -> None:
    plan = {"fringes": FRINGES, "filter": None}
    (tmp_path / "mine.yaml").write_text(config.to_yaml(plan))
    (tmp_path / "c.yaml").touch()
    wanted = {**PLAIN, "start": "mine.yaml", "calibrations": [{"file": "c.yaml", "stage_mm": 0.0}]}
    (tmp_path / "study.yaml").write_text(config.to_yaml(wanted))
    known = Study.load(tmp_path / "study.yaml")
    assert known.start == config.validate(plan, Plan, "plan")
    assert known.start.filter is None
    assert known.calibrations[0].file == str(tmp_path / "c.yaml")
