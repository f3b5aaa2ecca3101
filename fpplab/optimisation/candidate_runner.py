"""Where methods have candidates measured: each once, journalled, with the same seeds, in the order asked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from fpplab.core.errors import DataError
from fpplab.core.progress import ignore
from fpplab.optimisation.candidate import Candidate, Score
from fpplab.optimisation.objectives import CandidateRanking, MeasuredCandidate
from fpplab.optimisation.scheduling import Task, Workers
from fpplab.optimisation.space import Point, SearchSpace
from fpplab.optimisation.storage import Journal, ScoresOrReason


class BudgetExhausted(Exception):  # noqa: N818 - no fault: the budget is used up
    """The study's budget of candidates is used up."""


@dataclass(frozen=True)
class SearchEpoch:
    """One round of a search: what was asked in it, and the best of all until then.

    step: what the method did. trials: of this round, in the order asked.
    """

    number: int
    step: str
    trials: tuple[MeasuredCandidate, ...]
    best: MeasuredCandidate
    measured: int


CandidateObserver = Callable[[SearchEpoch], None]


class CandidateRunner:
    """Measures points of a space, keeps what came of them, and counts the rounds.

    trials: every candidate measured, in the order asked. refused: how often, by reason. epochs: so far.
    """

    def __init__(
        self, space: SearchSpace, workers: Workers, journal: Journal, observe: CandidateObserver = ignore
    ) -> None:
        self.space = space
        self._workers, self._journal, self._observe = workers, journal, observe
        self._by_candidate: dict[Candidate, MeasuredCandidate] = {}
        self.refused: Counter[str] = Counter()
        self.epochs: list[SearchEpoch] = []

    @property
    def trials(self) -> list[MeasuredCandidate]:
        """All that were measured."""
        return list(self._by_candidate.values())

    @cached_property
    def start(self) -> MeasuredCandidate:
        """Where the study starts, which limits are relative to. Raises `DataError` if it measures nothing."""
        begin = MeasuredCandidate(self.space.start, self.space.candidate(self.space.start))
        trial = self._take([begin])[0]
        if trial.failed:
            raise DataError(f"the start of the study cannot be measured: {trial.failed}")
        return trial

    @cached_property
    def ranking(self) -> CandidateRanking:
        """What the study makes of trials."""
        return CandidateRanking(self.space.study, self.start.figures)

    @property
    def best(self) -> MeasuredCandidate:
        """The best of all until now."""
        return min(self.trials, key=self.ranking.rank)

    @property
    def front(self) -> list[MeasuredCandidate]:
        """Of all until now those that no other is better than in everything."""
        return self.ranking.front(self.trials)

    def is_feasible(self, point: Point) -> bool:
        """Whether a point can be shown; where not, its refusal is counted."""
        refused = self._asked(point).refused
        if refused:
            self.refused[refused] += 1
        return refused is None

    def measure(self, points: Sequence[Point]) -> list[MeasuredCandidate]:
        """Measure points, or refuse them. Raises `BudgetExhausted` when the budget is used up before."""
        if self.start and len(self._by_candidate) >= self.space.study.budget:
            raise BudgetExhausted
        asked = [self._asked(point) for point in points]
        self.refused.update(trial.refused for trial in asked if trial.refused)
        taken = iter(self._take([trial for trial in asked if not trial.refused]))
        return [trial if trial.refused else next(taken) for trial in asked]

    def epoch(self, step: str, trials: Sequence[MeasuredCandidate]) -> SearchEpoch:
        """A round has ended."""
        epoch = SearchEpoch(len(self.epochs), step, tuple(trials), self.best, len(self._by_candidate))
        self.epochs.append(epoch)
        self._observe(epoch)
        return epoch

    def rescore(self, candidates: Sequence[Candidate], seeds: Sequence[int]) -> list[tuple[Score, ...]]:
        """Scores of candidates with other seeds than the study's; empty where nothing came of it."""
        found = iter(self._outcomes([(candidate, seed) for candidate in candidates for seed in seeds]))
        scores = []
        for _ in candidates:
            outcomes = [next(found) for _ in seeds]
            scores.append(_joined(outcomes) if not any(isinstance(o, str) for o in outcomes) else ())
        return scores

    def _asked(self, point: Point) -> MeasuredCandidate:
        candidate = self.space.candidate(point)
        refused = None if candidate == self.start.candidate else self.space.refusal(candidate)
        return MeasuredCandidate(point, candidate, refused=refused)

    def _take(self, asked: Sequence[MeasuredCandidate]) -> list[MeasuredCandidate]:
        new = {trial.candidate: trial for trial in asked if trial.candidate not in self._by_candidate}
        seeds = self.space.study.seeds
        outcomes = iter(self._outcomes([(candidate, seed) for candidate in new for seed in seeds]))
        for candidate, trial in new.items():
            found = [next(outcomes) for _ in seeds]
            failed = next((outcome for outcome in found if isinstance(outcome, str)), None)
            scores = () if failed else _joined(found)
            self._by_candidate[candidate] = MeasuredCandidate(trial.point, candidate, scores, failed=failed)
        return [self._by_candidate[trial.candidate] for trial in asked]

    def _outcomes(self, tasks: Sequence[Task]) -> list[ScoresOrReason]:
        """Of every task, from the journal where it is there."""
        missing = [task for task in dict.fromkeys(tasks) if self._journal.get(*task) is None]
        self._workers.measure(missing, lambda place, outcome: self._journal.add(*missing[place], outcome))
        return [outcome for task in tasks if (outcome := self._journal.get(*task)) is not None]


def _joined(outcomes: Sequence[ScoresOrReason]) -> tuple[Score, ...]:
    return tuple(score for outcome in outcomes for score in outcome if not isinstance(score, str))
