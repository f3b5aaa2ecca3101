"""Signs that the frames of a session are not what its plan says, looked for before they are used."""

from __future__ import annotations

from fpplab.acquisition.synchronisation import IMPORTED_REMEDY, check_synchronisation, remedy
from fpplab.core.errors import DataError
from fpplab.patterns.recording import Recording
from fpplab.plan_check import check_plan_fit
from fpplab.sessions.session import Session


def fault_in_step(session: Session, recording: Recording) -> str | None:
    """Say how the frames of a session are out of step with their plan, and what to check.

    Parameters
    ----------
    session : Session
        A complete one.
    recording : Recording
        Its frames.

    Returns
    -------
    str or None
        A clause; None where they are in step.
    """
    verdict = check_synchronisation(recording)
    if verdict.in_step:
        return None
    return f"{verdict.describe()}; {IMPORTED_REMEDY if session.is_imported else remedy(recording.plan)}"


def require_in_step(session: Session, recording: Recording) -> None:
    """Refuse frames that do not show their patterns.

    Parameters
    ----------
    session : Session
        A complete one.
    recording : Recording
        Its frames.

    Raises
    ------
    DataError
        They are out of step with the plan.
    """
    if fault := fault_in_step(session, recording):
        again = "" if session.is_imported else "take it again, with --force, or "
        raise DataError(f"{recording.name}: {fault}; {again}--as-recorded takes the frames as they are")


def plan_fault(recording: Recording) -> str | None:
    """Say what is wrong with the plan of a recording, by its images.

    Parameters
    ----------
    recording : Recording
        Frames and plan.

    Returns
    -------
    str or None
        A clause; None where nothing is.
    """
    found = check_plan_fit(recording)
    return found.fault if found else None


def doubts(session: Session) -> list[str]:
    """Look for signs that the frames of a session are not what its plan says.

    Parameters
    ----------
    session : Session
        A complete one.

    Returns
    -------
    list of str
        A sentence for each.
    """
    recording = session.recording(verify=False)
    found = check_plan_fit(recording)
    said = [fault_in_step(session, recording), *((found.fault, found.note) if found else ())]
    return [f"{session.path}: {sentence}" for sentence in said if sentence]
