"""Reasons to refuse a matching, and what an operator accepts all the same.

What is accepted stays with the twin: it is a note of its rig file, which every command that opens the rig
prints.
"""

from collections.abc import Iterable

from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.diagnosis import FaultCause
from fpplab.diagnosis.causes.of_characterisation import LENS_NOT_LOCKED
from fpplab.diagnosis.causes.of_matching_and_search import ARTEFACT_MISFIT, NO_GAIN, UNLIKE_IMAGES
from fpplab.diagnosis.causes.response import RESPONSE
from fpplab.diagnosis.causes.stale_calibration import STALE_CALIBRATION

ACCEPTABLE = (STALE_CALIBRATION, RESPONSE, ARTEFACT_MISFIT, LENS_NOT_LOCKED, UNLIKE_IMAGES, NO_GAIN)
"""Causes for which a matching is refused unless they are accepted."""


def acceptable_causes(keys: Iterable[str]) -> frozenset[FaultCause]:
    """Read causes as an operator names them."""
    causes = {cause.key: cause for cause in ACCEPTABLE}
    for key in keys:
        if key not in causes:
            raise ConfigError(
                f"--accept: '{key}' is no cause that can be accepted; there are {', '.join(causes)}"
            )
    return frozenset(causes[key] for key in keys)


class Refusals:
    """Refuses a matching, unless the cause was accepted, and keeps what was accepted."""

    def __init__(self, accepted: Iterable[FaultCause] = ()) -> None:
        self.accepted = frozenset(accepted)
        self.notes: list[str] = []

    def refuse(self, cause: FaultCause, message: str) -> None:
        if cause not in self.accepted:
            raise CalibrationError(f"{message} (--accept {cause} matches the twin all the same)")
        self.notes.append(f"{cause} accepted: {message}")
