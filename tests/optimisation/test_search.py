"""The search: spaces, limits, methods and journals, on formulas whose optimum is known."""

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.core import config, errors
from fpplab.core.errors import ConfigError, DataError, LimitError
from fpplab.optimisation.candidate import Candidate, CandidateFigures, MeasuredCandidate, Score
from fpplab.optimisation.candidate_runner import BudgetExhausted, CandidateRunner
from fpplab.optimisation.methods.gradient import Gradient
from fpplab.optimisation.methods.nsga2 import _noise_bound
from fpplab.optimisation.ranking import CandidateRanking
from fpplab.optimisation.scheduling import InProcessWorkers, measure_outcome
from fpplab.optimisation.scope import SearchScope
from fpplab.optimisation.space import Parameter, SearchSpace
from fpplab.optimisation.storage import Journal
from fpplab.optimisation.study import Study
from fpplab.patterns.fringe_sets import stepped_fringes
from fpplab.patterns.plan import Plan
from tests.support.searching import FRINGES, LIMITS, PLAIN, Formula, runner_of, search, study, with_stage

PHASES = {
    "space": {"steps": [[3, 12], [3, 12], [3, 16]]},
    "objectives": ["images"],
    "constraints": {"smcd_of_start": 1.0},
}
FRONT = {
    "space": {
        "steps": [[3, 12], [3, 12], [3, 15]],
        "stripes": [None, [2, 32], [12, 228]],
        "stage_mm": [-60, 60],
    },
    "start": {"fringes": [{**fringe, "steps": 7} for fringe in FRINGES], "stage_mm": 0.0},
    "objectives": ["surface_smcd_um", "images"],
    "method": {"kind": "nsga2", "population": 12},
    "constraints": {"images": 21},
    "budget": 600,
}
GRADIENT = {"kind": "gradient"}


# Candidates and plans


def test_plan_of_a_candidate_keeps_the_rest_of_the_template() -> None:
    like = Plan.load("plan_paper.yaml").model_copy(update={"settle_s": 0.1})
    candidate = Candidate((stepped_fringes("y", 1.0, 3), stepped_fringes("y", 9.5, 4)), 0.04, stage_mm=-3.0)
    plan = candidate.plan(like)
    assert [(f.axis, f.stripes, f.steps) for f in plan.fringes] == [("y", 1.0, 3), ("y", 9.5, 4)]
    assert (plan.exposure_s, plan.stage_mm, plan.settle_s) == (0.04, -3.0, 0.1)
    assert plan.masks == like.masks
    assert plan.images == candidate.images == 7


# Space


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


GRAY = {
    "fringes": [
        {"kind": "gray", "axis": "x", "bits": 6, "cell_px": 19.0},
        {"axis": "x", "stripes": 48, "steps": 4},
    ],
    "ranges": [{"bits": [5, 7], "cell_px": [8, 38]}, {"steps": [3, 6]}],
}


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


# Figures, limits and fronts


def _scores(table: dict[tuple[str, int], float], **others: Any) -> tuple[Score, ...]:
    plain: dict[str, Any] = {
        "images": 36, "points": 9, "smcd_um": 80.0, "smcd_floor_um": 50.0, "surface_rms_um": 1.0,
        "completeness": 0.9, "wrong_orders": 0.0, "outliers": 0.0, "seconds": 1.0,
    }  # fmt: skip
    return tuple(
        Score(artefact=name, seed=seed, surface_smcd_um=um, **{**plain, **others})
        for (name, seed), um in table.items()
    )


def test_figures_are_means_over_artefacts_and_seeds() -> None:
    found = CandidateFigures.of(_scores({("a", 1): 10.0, ("b", 1): 20.0, ("a", 2): 14.0, ("b", 2): 24.0}))
    assert found.surface_smcd_um == 17.0
    assert found.smcd_spread_um == pytest.approx(np.std([15.0, 19.0], ddof=1))
    assert found.worst_smcd_um == 19.0
    assert found.worst_artefact_um == 22.0
    assert CandidateFigures.of(_scores({("a", 1): 10.0})).smcd_spread_um is None


def _trial(images: int, um: float, **others: Any) -> MeasuredCandidate:
    scores = _scores({("a", 1): um}, images=images, **others)
    return MeasuredCandidate((images,), Candidate((stepped_fringes("x", 1.0, images),), um), scores)


def _ranking(**changes: Any) -> CandidateRanking:
    start = _trial(36, 20.0)
    return CandidateRanking(
        study(**{"objectives": ["surface_smcd_um", "images"], "method": {"kind": "nsga2"}, **changes}), start
    )


@pytest.mark.parametrize(
    ("others", "limit"),
    [
        ({"wrong_orders": 0.0011}, "wrong_orders"),
        ({"completeness": 0.85}, "completeness"),
        ({"seconds": 1.6}, "seconds"),
        ({"um": 20.3}, "surface_smcd_um"),
    ],
)
def test_limit_outweighs_every_objective(others: dict[str, Any], limit: str) -> None:
    ranking = _ranking(constraints={"seconds": 1.5, "smcd_of_start": 1.01})
    bad, good = _trial(3, **{"um": 0.1, **others}), _trial(36, 20.1)
    assert [name for name, by in ranking.violations(bad).items() if by > 0] == [limit]
    assert ranking.is_acceptable(good)
    assert not ranking.is_acceptable(bad)
    assert ranking.rank(good) < ranking.rank(bad)
    assert ranking.front([bad, good]) == [good]


def test_violation_of_a_limit_is_measured_as_a_share() -> None:
    ranking = _ranking(constraints={"seconds": 1.5, "smcd_of_start": 1.01, "completeness_of_start": 0.9})
    trial = _trial(3, 25.25, seconds=1.8, completeness=0.7, wrong_orders=0.003)
    of_start = ranking.start.figures.completeness
    assert ranking.violations(trial) == pytest.approx(
        {
            "wrong_orders": 0.002,
            "completeness": 0.9 * of_start - 0.7,
            "seconds": 0.2,
            "surface_smcd_um": 0.25,
        }
    )


def test_failed_candidate_ranks_last() -> None:
    ranking = _ranking()
    failed = MeasuredCandidate((0.0,), Candidate((), 1.0), failed="nothing there")
    assert ranking.rank(_trial(3, 1e9, wrong_orders=1.0)) < ranking.rank(failed)


@given(st.lists(st.tuples(st.integers(3, 12), st.integers(1, 30)), min_size=1, max_size=40))
def test_pareto_front_dominates_all_other_candidates(points: list[tuple[int, int]]) -> None:
    ranking = _ranking()
    trials = [_trial(images, float(um)) for images, um in points]
    front = ranking.front(trials)
    kept = {ranking.values(t) for t in front}
    assert len(kept) == len(front)
    for trial in trials:
        own = ranking.values(trial)
        better = [v for v in kept if v != own and all(a <= b for a, b in zip(v, own, strict=True))]
        assert bool(better) != (own in kept)
    assert [t.candidate.images for t in front] == sorted((t.candidate.images for t in front), reverse=True)


# Methods


def test_coordinate_search_finds_the_stripes(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, Formula(best_stripes=100.0, noise_um=3.0))
    search(runner)
    # The valley is quadratic: half the finest move, 1 % of a range of log(228/12), is the most left.
    assert abs(math.log(runner.best.candidate.fringes[-1].stripes / 100.0)) <= 0.01 * math.log(228 / 12)
    assert runner.best.figures.wrong_orders == 0.0


def test_coordinate_search_finds_the_baseline(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, Formula(best_stage_mm=-31.0), space={"stage_mm": [-60, 60]})
    search(runner)
    assert runner.best.candidate.stage_mm == pytest.approx(-31.0, abs=0.6)


def test_search_on_a_grid_stays_on_it(tmp_path: Path) -> None:
    space = {"stage_mm": [-60, 60], "stage_every_mm": 10}
    runner = runner_of(tmp_path, Formula(best_stage_mm=-31.0), space=space)
    search(runner)
    assert runner.best.candidate.stage_mm == -30
    assert {trial.candidate.stage_mm for trial in runner.trials} <= {*range(-60, 61, 10)}


def test_coordinate_search_finds_the_fewest_images(tmp_path: Path) -> None:
    """Orders hold with 3 steps at ratio 8; the distance, which must not rise, is the finest set's alone."""
    runner = runner_of(tmp_path, **PHASES)
    search(runner)
    assert [f.steps for f in runner.best.candidate.fringes] == [3, 3, 12]


def test_failing_fringe_orders_limit_the_search(tmp_path: Path) -> None:
    """With noisier orders, a ratio of 8 needs 8**2 / (4 throw)**2 steps in the coarser set: 6."""
    runner = runner_of(tmp_path, Formula(throw=0.82), **PHASES)
    search(runner)
    assert [f.steps for f in runner.best.candidate.fringes] == [6, 6, 12]


def test_gradient_descent_as_in_the_paper(tmp_path: Path) -> None:
    runner = runner_of(
        tmp_path,
        start={"fringes": [{**f, "stripes": s} for f, s in zip(FRINGES, (1, 8, 16), strict=True)]},
        method=GRADIENT,
    )
    ended = search(runner)
    assert ended == "improved by less than 1 in 5 epochs"
    start, best = runner.start.figures.surface_smcd_um, runner.best.figures.surface_smcd_um
    # Near the bottom each epoch leaves a share q of what is above it, and five gained less than 1 µm.
    curvature = 2 * 30.0 * math.log(228 / 12) ** 2 / start
    q = (1 - Gradient().rate * curvature) ** 2
    least = best_of(Formula(), 12)
    assert least <= best < least + q**5 / (1 - q**5)
    assert len(runner.epochs) > 5


def best_of(formula: Formula, steps: int) -> float:
    return 12.5 + 40.0 / math.sqrt(steps) + 20.0 * (formula.best_stage_mm / 60.0) ** 2


def test_gradient_stops_when_the_gain_is_small(tmp_path: Path) -> None:
    runner = runner_of(
        tmp_path, Formula(best_stripes=64.0), method={**GRADIENT, "patience": 3, "rate": 0.0001}
    )
    assert search(runner) == "improved by less than 1 in 3 epochs"
    assert len(runner.epochs) == 3


def test_gradient_moves_steps_by_one(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, **{**PHASES, "method": GRADIENT})
    search(runner)
    for before, after in zip([runner.start, *_steps(runner)], _steps(runner), strict=False):
        assert max(abs(a - b) for a, b in zip(before.point, after.point, strict=True)) == 1
    assert runner.best.candidate.images < 36


def _steps(runner: CandidateRunner) -> list[MeasuredCandidate]:
    return [epoch.trials[-1] for epoch in runner.epochs if epoch.step == "step"]


def test_bayesian_search_finds_the_stripes(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, method={"kind": "bayesian", "batch": 8}, budget=64)
    with pytest.raises(BudgetExhausted):
        search(runner)
    assert runner.best.figures.surface_smcd_um < best_of(Formula(), 12) + 1.0
    assert runner.ranking.is_acceptable(runner.best)


@pytest.mark.whole
def test_bayesian_search_asks_until_candidates_are_new(tmp_path: Path) -> None:
    """Numbers of sets that are not shown make 320 points 26 candidates."""
    fringes = [{"axis": "x", "stripes": float(stripes), "steps": 4} for stripes in (1, 8, 64)]
    alternative = {"fringes": fringes, "ranges": [{"steps": [3, 18]}, None, None]}
    space = {"steps": [[3, 12], None, None], "alternatives": [alternative]}
    runner = runner_of(tmp_path, space=space, method={"kind": "bayesian", "batch": 6}, budget=60)
    assert search(runner) == "nothing new is asked"
    assert len(runner.trials) == 26


def test_codes_that_look_alike_are_refused_before_they_are_measured(tmp_path: Path) -> None:
    alternative = {**GRAY, "ranges": [{"cell_px": [19, 38]}, None]}
    runner = runner_of(tmp_path, space={"steps": [[3, 12], None, None], "alternatives": [alternative]})
    assert runner.is_feasible((12, 1, 19))
    assert not runner.is_feasible((12, 1, 38))  # two periods of the fringes
    assert any("look alike" in reason for reason in runner.refused)


def test_several_exposures_are_an_alternative(tmp_path: Path) -> None:
    """The single exposure that is searched makes no other candidate of them."""
    alternative = {"fringes": FRINGES, "exposures_s": [0.01, 0.05]}
    space = runner_of(tmp_path, space={"exposure_s": [0.01, 0.04], "alternatives": [alternative]}).space
    assert [p.name for p in space.parameters] == ["alternative", "exposure_s"]
    assert space.candidate((1, 0.012)) == space.candidate((1, 0.03))
    chosen, start = space.candidate((1, 0.03)), space.candidate((0, 0.03))
    assert chosen.seconds(0.0) == pytest.approx(2 * start.seconds(0.0))
    assert chosen.plan(space.problem.start).exposures_s == (0.01, 0.05)
    assert start.plan(space.problem.start).exposures == (0.03,)


@pytest.mark.parametrize("scope", [SearchScope.PHASES, SearchScope.STRIPES])
def test_searches_of_one_objective_take_exposures(scope: SearchScope) -> None:
    assert "light" in scope.groups


@pytest.mark.whole
def test_front_against_seconds_begins_with_quick_plans_of_little_noise(tmp_path: Path) -> None:
    """At the start's exposure no plan of three sets is more than four times as quick."""
    space = {**FRONT["space"], "exposure_s": [0.002, 0.05], "pattern_bits": [4, 8]}  # type: ignore[dict-item]
    changes = {"space": space, "objectives": ["surface_smcd_um", "seconds"], "constraints": {}, "budget": 12}
    start = {"fringes": FRINGES, "stage_mm": 0.0, "exposure_s": 0.02}
    runner = runner_of(tmp_path, **{**FRONT, **changes, "start": start, "seeds": [83, 84]})
    with pytest.raises(BudgetExhausted):
        search(runner)
    quick = [trial for trial in runner.trials if trial.figures.seconds < runner.start.figures.seconds / 5]
    most = _noise_bound(runner, runner.start.candidate)
    assert any(_noise_bound(runner, trial.candidate) <= most for trial in quick)


@pytest.mark.nightly
def test_front_is_at_least_as_good_as_every_single_optimum(tmp_path: Path) -> None:
    runner = runner_of(tmp_path / "front", **FRONT)
    search(runner)
    front = {t.candidate.images: t.figures.surface_smcd_um for t in runner.front}
    assert set(front) == set(range(9, 22))
    for name in ("steps", "stripes", "stage_mm"):
        single = runner_of(
            tmp_path / name,
            **{**FRONT, "space": {name: FRONT["space"][name]}, "objectives": ["surface_smcd_um"],  # type: ignore[index]
               "method": {"kind": "coordinate"}},
        )  # fmt: skip
        search(single)
        best = single.best.figures
        assert front[best.images] <= best.surface_smcd_um


# The journal


def test_killed_search_continues_from_its_journal(tmp_path: Path) -> None:
    whole = runner_of(tmp_path / "whole", Formula(noise_um=2.0))
    search(whole)
    journal = tmp_path / "whole" / "study.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    half = tmp_path / "half" / "study.jsonl"
    half.parent.mkdir()
    half.write_bytes(b"".join(lines[:21]) + lines[21][:40])  # the header, twenty, and a torn line
    log = tmp_path / "log"
    again = runner_of(tmp_path / "half", Formula(noise_um=2.0, log=log))
    search(again)
    assert half.read_bytes() == journal.read_bytes()
    assert len(log.read_text().splitlines()) == len(lines) - 21
    assert again.best == whole.best
    assert [t.candidate for t in again.trials] == [t.candidate for t in whole.trials]


def test_nothing_is_measured_twice(tmp_path: Path) -> None:
    log = tmp_path / "log"
    runner = runner_of(tmp_path, Formula(log=log))
    search(runner)
    assert len(log.read_text().splitlines()) == 2 * len(runner.trials)


def test_journal_of_another_study_is_refused(tmp_path: Path) -> None:
    runner_of(tmp_path).start  # noqa: B018 - measured for the journal
    with pytest.raises(ConfigError, match="'artefacts' is another"):
        Journal(tmp_path / "study.jsonl", study(artefacts=["ball"]), {})
    with pytest.raises(ConfigError, match="'rig' is another"):
        Journal(tmp_path / "study.jsonl", study(), {"name": "other"})
    assert len(Journal(tmp_path / "study.jsonl", study(budget=3, seeds=[5]), {})) == 2


def test_a_damaged_journal_is_refused(tmp_path: Path) -> None:
    runner_of(tmp_path).start  # noqa: B018 - measured for the journal
    path = tmp_path / "study.jsonl"
    path.write_text(path.read_text().replace('"points": 1000', '"points": "many"'))
    with pytest.raises(DataError, match=r"study\.jsonl line 2: is not a measurement"):
        Journal(path, study(), {})


def test_a_budget_is_kept(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, budget=9)
    with pytest.raises(BudgetExhausted):
        search(runner)
    assert 9 <= len(runner.trials) <= 9 + 6  # a round is always completed


# What cannot be measured


def test_failed_candidate_does_not_end_the_search(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, Formula(fails_at=35), space=PHASES["space"])
    failed, fine = runner.measure([(11, 12, 12), (10, 12, 12)])
    assert failed.failed == "no pixel could be measured"
    assert fine.measured
    assert runner.best.measured
    again = runner_of(tmp_path, Formula(), space=PHASES["space"])
    assert again.measure([(11, 12, 12)])[0].failed == failed.failed


def test_infinite_score_is_a_failure() -> None:
    class Blind:
        def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
            return _scores({("pyramid", 1): float("inf")})

        def close(self) -> None: ...

    assert measure_outcome(Blind(), Candidate((), 1.0), 1) == "nothing of the pyramid could be measured"


def test_failed_start_ends_the_search(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="the start of the study cannot be measured"):
        runner_of(tmp_path, Formula(fails_at=36)).start  # noqa: B018


def test_rig_fault_ends_the_search(tmp_path: Path) -> None:
    class Broken:
        def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
            raise LimitError("stage", "move_to", "stuck")

        def close(self) -> None: ...

    wanted = study()
    runner = CandidateRunner(
        SearchSpace.of(wanted, LIMITS, "s"),
        InProcessWorkers(Broken),
        Journal(tmp_path / "j.jsonl", wanted, {}),
    )
    with pytest.raises(LimitError):
        runner.measure([runner.space.start])


@pytest.mark.parametrize("kind", [errors.DeviceError, errors.LimitError, errors.DeviceTimeoutError])
def test_device_errors_can_be_pickled(kind: type[errors.DeviceError]) -> None:
    fault = kind("stage", "move_to", "70 mm was asked for", "the travel is 0 to 60 mm")
    copy = pickle.loads(pickle.dumps(fault))
    assert type(copy) is kind
    assert (str(copy), copy.device, copy.remedy) == (str(fault), "stage", fault.remedy)
