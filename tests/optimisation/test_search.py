"""The methods of search, on formulas whose optimum is known."""

import math
from pathlib import Path

import pytest

from fpplab.optimisation.candidate import MeasuredCandidate
from fpplab.optimisation.candidate_runner import BudgetExhausted, CandidateRunner
from fpplab.optimisation.methods.gradient import Gradient
from fpplab.optimisation.methods.nsga2 import _noise_bound
from fpplab.optimisation.scope import SearchScope
from tests.support.searching import (
    FRINGES,
    FRONT,
    GRAY,
    PHASES,
    Formula,
    runner_of,
    search,
)

GRADIENT = {"kind": "gradient"}


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
