"""Base class of the search methods, each a module of `fpplab.optimisation.methods`."""

from abc import abstractmethod
from typing import ClassVar

from fpplab.core.config import Document
from fpplab.optimisation.candidate_runner import CandidateRunner


class SearchMethod(Document):
    """Settings and algorithm of one way to search a space; the settings are fields with defaults."""

    kind: str
    """Name of the method in a study file."""

    several_objectives: ClassVar[bool] = False
    """Whether the method searches a Pareto front of several objectives, instead of the optimum of one."""

    @abstractmethod
    def search(self, runner: CandidateRunner) -> str:
        """Search the runner's space from `CandidateRunner.start`, and return a phrase that says why it ended.

        Deterministic, since an interrupted search is run again with its journal. Has candidates measured with
        `CandidateRunner.measure`, compares them with `CandidateRunner.ranking`, and ends every round with
        `CandidateRunner.epoch`. `BudgetExhausted` and errors of the rig are not to be caught.
        """
