"""What the frames of poses say of a fit to them, for the commands that fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from fpplab.cli import console
from fpplab.core.errors import CalibrationError, FppError

if TYPE_CHECKING:
    from fpplab.diagnosis import Diagnosis, Finding
    from fpplab.patterns.recording import Recording
    from fpplab.sessions.session import Session


def diagnosed_poses(
    sessions: Sequence[Session],
    warnings: Sequence[str],
    left_out: Mapping[str, str],
    of_fit: Sequence[Finding] = (),
) -> Diagnosis:
    """Judge a characterisation by the frames of its poses."""
    from fpplab.diagnosis import diagnose_poses

    with console.progress("Checking the frames") as report:

        def frames() -> Iterator[tuple[str, Recording]]:
            for k, session in enumerate(sessions):
                yield session.path.name, session.recording(verify=False)
                report((k + 1) / len(sessions))

        return diagnose_poses(frames(), warnings, left_out, of_fit)


def with_causes(error: CalibrationError, sessions: Sequence[Session]) -> CalibrationError:
    """Say with an error of the fit what is wrong with the frames, which may be its cause."""
    try:
        found = diagnosed_poses(sessions, [str(error)], {})
    except FppError:  # frames that cannot be read were the error itself
        return error
    words = "".join(f"; {one.sentence}; {one.remedy}" for one in found.findings[:2])
    explained = CalibrationError(f"{error}{words}")
    explained.details = {**found.summary(), "verdict": "useless", "reason": str(error)}
    return explained
