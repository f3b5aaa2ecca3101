"""The result of a search, and its summary for JSON."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fpplab.optimisation.candidate import Candidate, CandidateFigures, MeasuredCandidate, Score, seed_means
from fpplab.optimisation.candidate_runner import SearchEpoch
from fpplab.optimisation.ranking import CandidateRanking
from fpplab.optimisation.space import SearchSpace
from fpplab.optimisation.study import Study


@dataclass(frozen=True)
class Gain:
    """Decrease of the mean distance to the surface, each seed compared with itself."""

    down_um: float  # decrease in µm
    uncertainty_um: float | None  # standard uncertainty over the seeds in µm; None with one seed
    down_percent: float  # decrease in % of the start's distance


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The result of a search."""

    study: Study  # what was searched
    rig: str  # name in the rig's file
    space: SearchSpace  # the parameters
    start: MeasuredCandidate  # where the search began
    optimum: MeasuredCandidate  # the best candidate by `CandidateRanking.rank`
    front: tuple[MeasuredCandidate, ...]  # the Pareto front, see `CandidateRanking.front`
    epochs: tuple[SearchEpoch, ...]  # the rounds
    trials: tuple[MeasuredCandidate, ...]  # every candidate measured, in the order asked
    refused: dict[str, int]  # how often a point was refused, by reason
    rescored: dict[Candidate, tuple[Score, ...]]  # scores of start
    ended: str  # why the search ended
    plans: tuple[Path, ...]  # plan files written: that of the optimum, or those of the front in its order
    planned: tuple[MeasuredCandidate, ...]  # the candidates of `plans`
    ended_early: bool  # whether the budget ended the search, and not its method
    screened: bool = False  # whether `trials` were predicted, and those of `rescored` alone were measured

    @property
    def ranking(self) -> CandidateRanking:
        return CandidateRanking(self.study, self.start)

    @property
    def gain(self) -> Gain | None:
        """Gain of the optimum over the start with the other seeds; None where these measurements failed."""
        return _gain(self.rescored[self.start.candidate], self.rescored[self.optimum.candidate])

    def summary(self) -> dict[str, Any]:
        return {
            "study": self.study.name,
            "rig": self.rig,
            "initial": self._described(self.start),
            "optimum": self._described(self.optimum),
            "gain": asdict(self.gain) if self.gain else None,
            "epochs": len(self.epochs),
            "ended": self.ended,
            "images": self.optimum.candidate.images,
            "front": [self._described(trial) for trial in self.front],
            "candidates": len(self.trials),
            "screened": self.screened,
            "failed": sum(not trial.measured for trial in self.trials),
            "refused": self.refused,
            "convergence": [self._epoch(epoch) for epoch in self.epochs],
        }

    def _described(self, trial: MeasuredCandidate) -> dict[str, Any]:
        scores = self.rescored.get(trial.candidate)
        return {
            **trial.summary(),
            **self.ranking.objective_values(trial),
            "again": asdict(CandidateFigures.of(scores)) if scores else None,
        }

    def _epoch(self, epoch: SearchEpoch) -> dict[str, Any]:
        best = epoch.best.figures
        return {
            "epoch": epoch.number,
            "step": epoch.step,
            "candidates": epoch.measured,
            "surface_smcd_um": best.surface_smcd_um,
            "images": best.images,
        }


def _gain(before: Sequence[Score], after: Sequence[Score]) -> Gain | None:
    if not before or not after:
        return None
    first, then = (np.array(list(seed_means(scores).values())) for scores in (before, after))
    down = first - then
    return Gain(
        down_um=float(down.mean()),
        uncertainty_um=float(down.std(ddof=1) / np.sqrt(len(down))) if len(down) > 1 else None,
        down_percent=float(100.0 * down.mean() / first.mean()),
    )
