"""Figures of candidates, limits on them, and the front of the best."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.optimisation.candidate import Candidate, CandidateFigures, MeasuredCandidate
from fpplab.optimisation.ranking import CandidateRanking
from fpplab.patterns.fringe_sets import stepped_fringes
from tests.support.searching import scores_of, study


def test_figures_are_means_over_artefacts_and_seeds() -> None:
    found = CandidateFigures.of(scores_of({("a", 1): 10.0, ("b", 1): 20.0, ("a", 2): 14.0, ("b", 2): 24.0}))
    assert found.surface_smcd_um == 17.0
    assert found.smcd_spread_um == pytest.approx(np.std([15.0, 19.0], ddof=1))
    assert found.worst_smcd_um == 19.0
    assert found.worst_artefact_um == 22.0
    assert CandidateFigures.of(scores_of({("a", 1): 10.0})).smcd_spread_um is None


def _trial(images: int, um: float, **others: Any) -> MeasuredCandidate:
    scores = scores_of({("a", 1): um}, images=images, **others)
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
