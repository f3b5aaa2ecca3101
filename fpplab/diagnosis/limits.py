"""Limits of the diagnosis as one value, which is passed to whatever judges.

Each cause, and each measurement that several causes share, states its limits next to its code as a
`LimitsSection`. The sentence beneath a limit ends in where its value comes from: derived (from what),
measured (on what) or chosen. "Benches" are the simulated ones of the seeds
that are listed in `benchmarks.diagnosis`; on others, 100 scans without a fault had no finding.
"""

import re
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import Field

from fpplab.core.config import Document

ShareLimit = Annotated[float, Field(gt=0.0, le=1.0)]  # a part of a whole
PercentileLimit = Annotated[float, Field(ge=0.0, le=100.0)]  # a percentile
CountLimit = Annotated[int, Field(ge=1)]  # a number of things


class LimitsSection(Document):
    """Limits of one cause or measurement: a section of a file of limits."""

    section: ClassVar[str]  # by default the name of the class without "Limits"

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "section" not in vars(cls):
            cls.section = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__.removesuffix("Limits")).lower()


L = TypeVar("L", bound=LimitsSection)


@dataclass(frozen=True)
class DiagnosisLimits:
    """All limits of a diagnosis: the usual ones, and those that an expert has changed."""

    changed: tuple[LimitsSection, ...] = ()

    def of(self, kind: type[L]) -> L:
        """Look up the limits of one section."""
        return next((limits for limits in self.changed if isinstance(limits, kind)), None) or kind()

    def changes(self) -> dict[str, dict[str, Any]]:
        """List the limits that are not the usual ones, by section and name."""
        by_section = {}
        for limits in self.changed:
            usual = type(limits)()
            values = {n: v for n, v in limits.model_dump().items() if v != getattr(usual, n)}
            if values:
                by_section[limits.section] = values
        return by_section


USUAL_LIMITS = DiagnosisLimits()
