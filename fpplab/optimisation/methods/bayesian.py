"""Tree-structured Parzen estimators through optuna: for one objective with many valleys."""

from __future__ import annotations

import optuna

from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.methods.asking import enqueue, quiet, round_of, study_of
from fpplab.optimisation.study import Bayesian


def bayes(lab: CandidateRunner, settings: Bayesian) -> str:
    """Search until the budget is used up, which raises `Spent`, or nothing is left to ask."""
    with quiet():
        seed = lab.space.study.seeds[0]
        sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True)
        study = study_of(lab, sampler)
        enqueue(study, lab, [lab.start.point])
        while True:
            known = len(lab.trials)
            trials = round_of(study, lab, settings.batch)
            lab.epoch("batch", trials)
            if len(lab.trials) == known and known > 1:
                return "nothing new is asked"
