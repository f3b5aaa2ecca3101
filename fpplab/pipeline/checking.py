"""Signs that the frames of a session are not what its plan says, looked for before they are used."""

from fpplab.acquisition.synchronisation import IMPORTED_REMEDY, check_synchronisation, synchronisation_remedy
from fpplab.core.errors import DataError
from fpplab.diagnosis.plan import (
    check_plan_fit,
    code_order_fault,
    describe_changing_brightness,
    name_other_patterns,
)
from fpplab.patterns.recording import Recording
from fpplab.sessions.session import Session


def fault_in_step(recording: Recording) -> str | None:
    verdict = check_synchronisation(recording)
    if verdict.in_step:
        return None
    if not recording.is_imported:
        return f"{verdict.describe()}; {synchronisation_remedy(recording.plan)}"
    if recording.fringe_part is not recording:  # the others know sinusoids alone
        return f"{verdict.describe()}; {IMPORTED_REMEDY}"
    sizes = [each.images for each in recording.plan.sets]
    images = recording.frames, recording.full_scale, sizes
    other = describe_changing_brightness(*images) or name_other_patterns(*images)
    return other or f"{verdict.describe()}; {IMPORTED_REMEDY}"


def require_in_step(recording: Recording) -> None:
    if fault := fault_in_step(recording):
        retake = "" if recording.is_imported else "take it again, with --force, or "
        raise DataError(f"{recording.name}: {fault}; {retake}--as-recorded takes the frames as they are")


def plan_fault(recording: Recording) -> str | None:
    misfit = check_plan_fit(recording)
    return misfit.fault if misfit else code_order_fault(recording)


def doubts_about_session(session: Session) -> list[str]:
    """Look for signs that the frames of a session are not what its plan says."""
    recording = session.recording(verify=False)
    misfit = check_plan_fit(recording)
    signs = [fault_in_step(recording), code_order_fault(recording)]
    if misfit:
        signs += [misfit.fault, misfit.note]
    return [f"{session.path}: {sign}" for sign in signs if sign]
