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
    """Judge a characterisation by the frames of its poses.

    Parameters
    ----------
    sessions : sequence of Session
        One for each pose.
    warnings : sequence of str
        Of the fit.
    left_out : mapping of str to str
        Why poses could not be used, by name.
    of_fit : sequence of Finding
        What the fit shows.

    Returns
    -------
    Diagnosis
        With one finding for each cause.
    """
    from fpplab.diagnosis import diagnose_poses

    with console.progress("Checking the frames") as report:

        def frames() -> Iterator[tuple[str, Recording]]:
            for k, session in enumerate(sessions):
                yield session.path.name, session.recording(verify=False)
                report((k + 1) / len(sessions))

        return diagnose_poses(frames(), warnings, left_out, of_fit)


def with_causes(error: CalibrationError, sessions: Sequence[Session]) -> CalibrationError:
    """Say with an error of the fit what is wrong with the frames, which may be its cause.

    Parameters
    ----------
    error : CalibrationError
        Why the fit failed.
    sessions : sequence of Session
        One for each pose.

    Returns
    -------
    CalibrationError
        With the worst causes in its sentence, and a verdict for `--json`; `error` itself where the frames
        cannot be read.
    """
    try:
        found = diagnosed_poses(sessions, [str(error)], {})
    except FppError:  # frames that cannot be read were the error itself
        return error
    words = "".join(f"; {one.sentence}; {one.remedy}" for one in found.findings[:2])
    explained = CalibrationError(f"{error}{words}")
    explained.details = {**found.summary(), "verdict": "useless", "reason": str(error)}
    return explained
