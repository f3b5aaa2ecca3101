"""Frames of a session that are what they should be, and their projector coordinates."""

from collections.abc import Sequence
from dataclasses import replace

from fpplab.acquisition.synchronisation import IMPORTED_REMEDY, check_synchronisation, synchronisation_remedy
from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Axis
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import Progress, no_progress
from fpplab.diagnosis.plan import (
    check_plan_fit,
    code_order_fault,
    describe_changing_brightness,
    name_other_patterns,
)
from fpplab.patterns.recording import KnownCoordinate, Recording
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase import Decoded, decode
from fpplab.pipeline.depth import given_depth
from fpplab.reconstruction.depth_range import KnownPixels, coordinates_of_points
from fpplab.reconstruction.motion import compensate_motion
from fpplab.sessions.origin import check_region, check_stage
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


def checked_recording(
    session: Session,
    calibration: Calibration,
    depth_mm: DepthInterval | None,
    progress: Progress,
    *,
    as_recorded: bool = False,
    known_mm: KnownPixels = (),
) -> Recording:
    # `depth_mm` replaces the range of depths that plan or rig state.
    given = given_depth(depth_mm)
    calibration.check_camera(session.format[:2], session.path)
    calibration.check_projector(*session.projector(), session.path)
    check_region(calibration, session)
    check_stage(calibration, session.plan, session.path)
    recording = session.recording(progress=lambda share: progress(0.3 * share))
    if not as_recorded:
        require_in_step(recording)
    recording = replace(recording, depth=given) if given else recording
    recording = compensate_motion(recording, calibration)
    if not known_mm:
        return recording
    (axis,) = spatial_axes(recording)
    return replace(recording, known=coordinates_of_points(known_mm, axis, calibration))


def parse_known(options: Sequence[str]) -> KnownPixels:
    """Read what `--known` says: COLUMN,ROW,VALUE each."""
    known = []
    for option in options:
        try:
            column, row, value = option.split(",")
            known.append((int(column), int(row), float(value)))
        except ValueError:
            raise ConfigError(
                f"--known is '{option}': must be COLUMN,ROW,VALUE, such as 640,512,431.5, without blanks"
            ) from None
    return tuple(known)


def spatial_axes(recording: Recording) -> tuple[Axis, ...]:
    """Give the axis that neighbours unwrap; refuse known points where there is none."""
    if not unwrapping_methods()[recording.plan.unwrapping].spatial:
        raise ConfigError(
            f"--known: is for plans with 'unwrapping: spatial', and {recording.name} has "
            f"'{recording.plan.unwrapping}', which determines all orders; leave it out"
        )
    return recording.plan.unwrapped_axes


def decode_session(session: Session) -> Decoded:
    """Find the projector coordinates of every camera pixel of a session."""
    return decode(recording_and_fault(session, no_progress, as_recorded=False)[0])


def recording_and_fault(
    session: Session, progress: Progress, *, as_recorded: bool, known: KnownPixels = ()
) -> tuple[Recording, str | None]:
    """Read the frames of a session, and say what is wrong with their plan if they are taken as recorded."""
    recording = session.recording(progress=lambda share: progress(0.5 * share))
    if not as_recorded:
        require_in_step(recording)
    fault = plan_fault(recording)
    if fault and not as_recorded:
        raise DataError(f"{session.path}: {fault}; --as-recorded decodes it nevertheless")
    if known and spatial_axes(recording):
        points = tuple(KnownCoordinate((column, row), value) for column, row, value in known)
        recording = replace(recording, known=points)
    return recording, fault
