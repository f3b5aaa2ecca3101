"""The verdict on a search, on rigs made of a formula, whose optimum and noise are known."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import pytest
from typer.testing import CliRunner

from fpplab.cli.every import app
from fpplab.core import config
from fpplab.diagnosis import Diagnosis, UselessScanError, Verdict
from fpplab.optimisation import run
from fpplab.optimisation.candidate import Candidate, MeasuredCandidate, Score
from fpplab.optimisation.candidate_runner import BudgetExhausted
from fpplab.optimisation.confirm import ConfirmedPlan
from fpplab.optimisation.result import SearchResult
from fpplab.optimisation.study import Study
from fpplab.optimisation.verdict import diagnose_search
from fpplab.results.search import BeforeAndAfter
from fpplab.workflows import optimise
from tests.support.searching import PLAIN, Calculated, Formula, runner_of

SEEDS = [1, 2, 3, 4, 5]
SPACE = {"stripes": [None, None, [30, 150]]}


class _Confirmation:
    """A gain with its uncertainty."""

    def __init__(self, gain: float, uncertainty: float) -> None:
        self.gain, self.uncertainty = gain, uncertainty


def searched(folder: Path, formula: Formula, **changes: Any) -> SearchResult:
    """A whole search in this process, without a rig and without files."""
    wanted: dict[str, Any] = {"space": SPACE, "seeds": SEEDS, **changes}
    runner = runner_of(folder, formula, **wanted)
    study = runner.space.problem
    assert isinstance(study, Study)
    runner.epoch("start", [runner.start])
    early = False
    try:
        ended = study.method.search(runner)
    except BudgetExhausted:
        ended, early = "the budget is used up", True
    chosen = [runner.start.candidate, runner.best.candidate]
    again = dict(zip(chosen, runner.rescore(chosen, [11, 12, 13, 14, 15]), strict=True))
    return SearchResult(
        study, "Formula", runner.space, runner.start, runner.best, (), tuple(runner.epochs),
        tuple(runner.trials), dict(runner.refused), again, ended, (), (), early,
    )  # fmt: skip


def causes(found: Diagnosis) -> list[str]:
    return [one.cause.key for one in found.findings]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> SearchResult:
    return searched(tmp_path_factory.mktemp("good"), Formula(noise_um=1.0, scatter_um=1e-4))


def test_an_optimum_within_the_space_is_good(good: SearchResult) -> None:
    found = diagnose_search(good)
    assert good.optimum.candidate.fringes[-1].stripes == pytest.approx(100.0, rel=0.05)
    assert (found.verdict, causes(found)) == (Verdict.GOOD, [])
    assert [one.split(":")[0] for one in found.unknown] == ["not_confirmed"]


def test_an_optimum_at_a_border_is_doubtful(tmp_path: Path) -> None:
    found = diagnose_search(searched(tmp_path, Formula(best_stripes=180.0, scatter_um=1e-4)))
    assert found.verdict is Verdict.DOUBTFUL
    assert causes(found) == ["at_border"]
    assert "stripes[2] is 150, at the border of its range from 30 to 150" in found.reason
    assert "space.stripes[2]" in found.findings[0].remedy


def test_a_border_of_the_rig_itself_is_none(tmp_path: Path) -> None:
    """At four pixels in a period the projector shows no more than 228 stripes."""
    space = {"stripes": [None, [2, 50], [30, 228]]}
    result = searched(tmp_path, Formula(best_stripes=400.0, scatter_um=1e-4), space=space)
    assert result.optimum.candidate.fringes[-1].stripes == 228
    assert "at_border" not in causes(diagnose_search(result))


def test_an_optimum_in_noise_cannot_be_told_from_its_neighbours(tmp_path: Path) -> None:
    found = diagnose_search(searched(tmp_path, Formula(scatter_um=20.0)))
    assert found.verdict is not Verdict.GOOD
    assert "flat_optimum" in causes(found)
    flat = next(one for one in found.findings if one.cause.key == "flat_optimum")
    assert "neighbours cannot be distinguished from it; stripes[2]" in flat.evidence


def test_an_early_end_is_doubtful(tmp_path: Path) -> None:
    result = searched(tmp_path, Formula(scatter_um=1e-4), budget=4)
    found = diagnose_search(result)
    assert result.ended_early
    assert "ended_early" in causes(found)
    assert "'budget'" in next(one for one in found.findings if one.cause.key == "ended_early").remedy


def with_rescored(result: SearchResult, of: MeasuredCandidate, by: float, **changes: Any) -> SearchResult:
    """The same with other figures of one candidate with the other seeds."""
    scores = [
        replace(s, surface_smcd_um=s.surface_smcd_um + by, **changes) for s in result.rescored[of.candidate]
    ]
    return replace(result, rescored={**result.rescored, of.candidate: tuple(scores)})


def test_worse_than_the_start_with_other_seeds_is_useless(good: SearchResult) -> None:
    worse = diagnose_search(with_rescored(good, good.optimum, 50.0))
    assert (worse.verdict, causes(worse)[0]) == (Verdict.USELESS, "no_gain")


def test_no_better_than_the_start_is_doubtful(tmp_path: Path) -> None:
    found = diagnose_search(searched(tmp_path, Formula(best_stripes=64.0, scatter_um=1e-4)))
    assert found.verdict is Verdict.DOUBTFUL
    assert causes(found) == ["no_gain"]


def test_limits_that_other_seeds_break(good: SearchResult) -> None:
    found = diagnose_search(with_rescored(good, good.optimum, 0.0, wrong_orders=0.02))
    assert causes(found) == ["limits_broken"]
    assert "wrong_orders by 0.019" in found.reason


@pytest.mark.parametrize(
    ("gain", "verdict", "named"),
    [(0.3, "good", []), (0.05, "doubtful", ["not_confirmed"]), (-0.3, "useless", ["not_confirmed"])],
)
def test_what_a_rig_says_of_the_plan(good: SearchResult, gain: float, verdict: str, named: list[str]) -> None:
    told = ConfirmedPlan("Bench", Path("p.yaml"), 36, cast(Any, _Confirmation(gain, 0.05)))
    found = diagnose_search(good, [told])
    assert (found.verdict, causes(found)) == (verdict, named)


def test_one_seed_shows_no_uncertainty(tmp_path: Path) -> None:
    found = diagnose_search(searched(tmp_path, Formula(), seeds=[1]))
    assert any(one.startswith("flat_optimum: one seed") for one in found.unknown)


def test_the_fewest_images_are_not_judged_by_distance(tmp_path: Path) -> None:
    changes: dict[str, Any] = {
        "space": {"steps": [None, None, [3, 12]]},
        "objectives": ["images"],
        "constraints": {"smcd_of_start": 1.5},
    }
    result = searched(tmp_path, Formula(noise_um=0.1), **changes)
    assert result.optimum.candidate.images < result.start.candidate.images
    assert diagnose_search(result).verdict is Verdict.GOOD


def test_the_command_leaves_no_plan_that_is_worse_than_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A formula stands for the rig; with the seeds that the search did not use its valley lies elsewhere."""

    @dataclass(frozen=True)
    class Elsewhere(Formula):
        def __call__(self) -> Calculated:
            return _Moved(self)

    class _Moved(Calculated):
        def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
            valley = 100.0 if seed <= len(SEEDS) else 20.0
            return Calculated(replace(self.formula, best_stripes=valley)).measure(candidate, seed)

    really = run.run_search
    monkeypatch.setattr(run, "run_search", lambda *a, **more: really(*a, **{**more, "factory": Elsewhere()}))
    monkeypatch.setattr(optimise, "compare_before_and_after", lambda rig, search: BeforeAndAfter())
    wanted = {**PLAIN, "artefacts": ["pyramid", "steps"], "space": SPACE, "seeds": SEEDS}
    (tmp_path / "study.yaml").write_text(config.to_yaml(wanted))
    words = ["optimise", "stripes", "--rig", "rig_demo", "--study", tmp_path / "study.yaml", "--workers", 1]
    done = CliRunner().invoke(app, [*map(str, words), "--out", str(tmp_path / "plan.yaml"), "--json"])
    assert isinstance(done.exception, UselessScanError)
    assert done.exception.exit_code == 4
    assert done.exception.details["verdict"] == "useless"
    assert done.exception.diagnosis.findings[0].cause.key == "no_gain"
    assert not (tmp_path / "plan.yaml").exists()
    assert "Useless" in (tmp_path / "plan.html").read_text()
