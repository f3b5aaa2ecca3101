"""Base class of the search methods.

A method is one module of the package `fpplab.optimisation.methods`: a subclass of `SearchMethod` with the
settings that a study file may give under ``method``, and the algorithm. Nothing else has to be changed for a
new one: its settings are read, its kind is named in messages, and `fpplab.optimisation.run` calls its
`SearchMethod.search`.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from fpplab.core.config import Document
from fpplab.optimisation.candidate_runner import CandidateRunner


class SearchMethod(Document):
    """Settings and algorithm of one way to search a space.

    A subclass declares ``kind: Literal["name"] = "name"``, its settings as fields with defaults, and
    `search`, which has to be deterministic: an interrupted search is continued by running it again, and what
    was measured before is taken from the journal.
    """

    kind: str
    """Name of the method in a study file."""

    several_objectives: ClassVar[bool] = False
    """Whether the method searches a Pareto front of several objectives, instead of the optimum of one."""

    @abstractmethod
    def search(self, runner: CandidateRunner) -> str:
        """Search the runner's space, beginning at `CandidateRunner.start`.

        Called once by `fpplab.optimisation.run`, after the start was measured and recorded as epoch 0. Has
        candidates measured with `CandidateRunner.measure`, compares them with `CandidateRunner.ranking`, and
        ends every round with `CandidateRunner.epoch`. What was found is taken from the runner.

        Parameters
        ----------
        runner : CandidateRunner
            Measures points of the space, each once, and keeps the results.

        Returns
        -------
        str
            Why the search ended, for the report: a phrase without a full stop.

        Raises
        ------
        BudgetExhausted
            From `CandidateRunner.measure`, when the study's budget is used up; not to be caught.
        FppError
            From the rig that measures; not to be caught.
        """
