"""Bayesian optimisation (optuna's tree-structured Parzen estimators), for objectives with local minima."""

from typing import Annotated, Literal

from pydantic import Field

from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.search_method import SearchMethod


class Bayesian(SearchMethod):
    """Bayesian optimisation with tree-structured Parzen estimators."""

    kind: Literal["bayesian"] = "bayesian"
    """Name of the method."""
    batch: Annotated[int, Field(ge=1)] = 8
    """Candidates that are proposed and measured together."""

    def search(self, runner: CandidateRunner) -> str:
        # Imported here because optuna is slow to import, and studies are read without searching.
        import optuna

        from fpplab.optimisation.optuna_rounds import OptunaRounds, quiet_optuna

        with quiet_optuna():
            seed = runner.space.problem.seeds[0]
            sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True)
            rounds = OptunaRounds.of(runner, sampler)
            rounds.enqueue([runner.start.point])
            while True:
                trials = rounds.measure(self.batch)
                if not trials:
                    return "nothing new is asked"
                runner.epoch("batch", trials)
