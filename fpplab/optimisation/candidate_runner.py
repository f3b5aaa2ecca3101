"""Measures candidates for the search methods: each once, journalled, with fixed seeds, in the order asked."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from fpplab.core.errors import DataError
from fpplab.core.progress import ignore
from fpplab.optimisation.candidate import Candidate, MeasuredCandidate, Point, Score
from fpplab.optimisation.ranking import CandidateRanking
from fpplab.optimisation.scheduling import Task, Workers
from fpplab.optimisation.space import SearchSpace
from fpplab.optimisation.storage import Journal, ScoresOrReason


class BudgetExhausted(Exception):  # noqa: N818 - no fault: the budget is used up
    """The study's budget of candidates is used up; no fault, it ends the search."""


@dataclass(frozen=True)
class SearchEpoch:
    """One round of a search."""

    number: int  # counted from 0, which is the start
    step: str  # what the method did in it, for example "poll" or "generation"
    trials: tuple[MeasuredCandidate, ...]  # candidates of this round, in the order asked
    best: MeasuredCandidate  # the best of all candidates so far
    measured: int  # number of candidates measured so far
    front: tuple[MeasuredCandidate, ...] = ()  # the Pareto front of all candidates so far


CandidateObserver = Callable[[SearchEpoch], None]  # called with every round of a search when it has ended


class CandidateRunner:
    """Measures points of a search space, keeps the results, and counts the rounds."""

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
        return list(self._by_candidate.values())

    @cached_property
    def start(self) -> MeasuredCandidate:
        begin = MeasuredCandidate(self.space.start, self.space.candidate(self.space.start))
        trial = self._measure_candidates([begin])[0]
        if trial.failed:
            raise DataError(f"the start of the study cannot be measured: {trial.failed}")
        return trial

    @cached_property
    def ranking(self) -> CandidateRanking:
        return CandidateRanking(self.space.problem, self.start)

    @property
    def best(self) -> MeasuredCandidate:
        return min(self.trials, key=self.ranking.rank)

    @property
    def front(self) -> list[MeasuredCandidate]:
        return self.ranking.front(self.trials)

    def measured(self, candidate: Candidate) -> MeasuredCandidate | None:
        return self._by_candidate.get(candidate)

    def is_feasible(self, point: Point) -> bool:
        # If not, the refusal is counted in `refused`.
        refused = self._candidate_to_measure(point).refused
        if refused:
            self.refused[refused] += 1
        return refused is None

    def measure(self, points: Sequence[Point]) -> list[MeasuredCandidate]:
        if self.start and len(self._by_candidate) >= self.space.problem.budget:
            raise BudgetExhausted
        asked = [self._candidate_to_measure(point) for point in points]
        self.refused.update(trial.refused for trial in asked if trial.refused)
        taken = iter(self._measure_candidates([trial for trial in asked if not trial.refused]))
        return [trial if trial.refused else next(taken) for trial in asked]

    def epoch(self, step: str, trials: Sequence[MeasuredCandidate]) -> SearchEpoch:
        epoch = SearchEpoch(
            len(self.epochs), step, tuple(trials), self.best, len(self._by_candidate), tuple(self.front)
        )
        self.epochs.append(epoch)
        self._observe(epoch)
        return epoch

    def rescore(self, candidates: Sequence[Candidate], seeds: Sequence[int]) -> list[tuple[Score, ...]]:
        measured = iter(self._outcomes([(candidate, seed) for candidate in candidates for seed in seeds]))
        scores = []
        for _ in candidates:
            outcomes = [next(measured) for _ in seeds]
            scores.append(_joined(outcomes) if not any(isinstance(o, str) for o in outcomes) else ())
        return scores

    def _candidate_to_measure(self, point: Point) -> MeasuredCandidate:
        candidate = self.space.candidate(point)
        refused = None if candidate == self.start.candidate else self.space.refusal(candidate)
        return MeasuredCandidate(point, candidate, refused=refused)

    def _measure_candidates(self, asked: Sequence[MeasuredCandidate]) -> list[MeasuredCandidate]:
        new = {trial.candidate: trial for trial in asked if trial.candidate not in self._by_candidate}
        seeds = self.space.problem.seeds
        outcomes = iter(self._outcomes([(candidate, seed) for candidate in new for seed in seeds]))
        for candidate, trial in new.items():
            by_seed = [next(outcomes) for _ in seeds]
            failed = next((outcome for outcome in by_seed if isinstance(outcome, str)), None)
            scores = () if failed else _joined(by_seed)
            self._by_candidate[candidate] = MeasuredCandidate(trial.point, candidate, scores, failed=failed)
        return [self._by_candidate[trial.candidate] for trial in asked]

    def _outcomes(self, tasks: Sequence[Task]) -> list[ScoresOrReason]:
        missing = [task for task in dict.fromkeys(tasks) if self._journal.get(*task) is None]
        self._workers.measure(missing, lambda place, outcome: self._journal.add(*missing[place], outcome))
        return [outcome for task in tasks if (outcome := self._journal.get(*task)) is not None]


def _joined(outcomes: Sequence[ScoresOrReason]) -> tuple[Score, ...]:
    return tuple(score for outcome in outcomes for score in outcome if not isinstance(score, str))
