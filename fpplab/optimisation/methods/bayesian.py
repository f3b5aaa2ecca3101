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

        from fpplab.optimisation.optuna_rounds import (
            enqueue_points,
            make_optuna_study,
            measure_round,
            quiet_optuna,
        )

        with quiet_optuna():
            seed = runner.space.problem.seeds[0]
            sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True)
            study = make_optuna_study(runner, sampler)
            enqueue_points(study, runner, [runner.start.point])
            while True:
                measured_before = len(runner.trials)
                trials = measure_round(study, runner, self.batch)
                runner.epoch("batch", trials)
                if len(runner.trials) == measured_before and measured_before > 1:
                    return "nothing new is asked"
