"""Base class of the objectives of a search, each a module of `fpplab.optimisation.objectives`."""

from dataclasses import dataclass
from typing import Any, ClassVar

from fpplab.core.tagged_union import concrete_subclasses
from fpplab.optimisation.candidate import MeasuredCandidate


@dataclass(frozen=True)
class ObjectiveLimit:
    """A field of a study's `constraints`, which limits one objective."""

    key: str  # name of the field
    type: Any  # type of the field for pydantic, with its bounds
    default: float | None  # None: without a limit unless the study gives one
    description: str  # what the limit is, for the reference of study files


class Objective:
    """One figure of a measured candidate that a search can improve; stateless."""

    key: ClassVar[str]
    """Name in study files, in results and in messages; it ends with the unit."""
    title: ClassVar[str]
    """Name for people, such as the head of a column."""
    unit: ClassVar[str] = ""
    """Unit, empty for a share or a count."""
    sentence: ClassVar[str]
    """What it is, as a phrase without a full stop."""
    number_format: ClassVar[str] = ".2f"
    """How `title` is printed in a report."""
    is_maximised: ClassVar[bool] = False
    """Whether more is better."""
    is_integer: ClassVar[bool] = False
    """Whether it counts something."""
    limit: ClassVar[ObjectiveLimit | None] = None
    """Field of a study's `constraints` that limits it."""

    def value(self, candidate: MeasuredCandidate) -> float:
        """Compute the objective, in `unit`, of a candidate that has scores; by default its figure `key`."""
        value: float = getattr(candidate.figures, self.key)
        return value

    def spread(self, candidate: MeasuredCandidate) -> float | None:
        """Compute the standard deviation over the seeds of the noise; None where it is not known."""
        return None

    def excess(self, value: float, of_start: float, limit: float) -> float:
        """Compute by which share, to be added up, a value exceeds a limit, which the start's may scale."""
        raise NotImplementedError(f"{self.key} has a limit, and no excess over it")

    @property
    def label(self) -> str:
        return f"{self.title}, {self.unit}" if self.unit else self.title

    def text(self, candidate: MeasuredCandidate) -> str:
        spread = self.spread(candidate)
        value = f"{self.value(candidate):{self.number_format}}"
        return value if spread is None else f"{value} ± {spread:.2g}"


def registered_objectives() -> dict[str, Objective]:
    objectives: dict[str, Objective] = {}
    for cls in concrete_subclasses(Objective):
        if cls.key in objectives:
            raise TypeError(
                f"{type(objectives[cls.key]).__name__} and {cls.__name__} have the key '{cls.key}'"
            )
        objectives[cls.key] = cls()
    return objectives
