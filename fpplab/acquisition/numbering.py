"""Frames of a simulation numbered by session: a resumed one gets the noise that it would have had."""

from itertools import pairwise

from fpplab.acquisition.acquire import end_markers
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import NumberedFrames
from fpplab.sessions.origin import session_origin
from fpplab.sessions.session import Session


def next_frame_of(rig: Rig) -> int | None:
    return rig.simulation.next_frame if isinstance(rig.simulation, NumberedFrames) else None


def number_frames(rig: Rig, session: Session) -> None:
    """Number the frames that a session lacks as if none had been taken before; nothing on a real bench."""
    # The first number is in the session's origin. Sessions that are complete are counted too, so that those
    # after them get the numbers that they would have had.
    simulation, origin = rig.simulation, session_origin(session.path)
    if not isinstance(simulation, NumberedFrames) or origin is None or origin.first_frame is None:
        return
    plan, first, missing = session.plan, origin.first_frame, session.missing()
    numbers: list[int] = []
    for exposure_s, (start, end) in zip(plan.exposures, pairwise(plan.pass_starts), strict=True):
        ends = len(end_markers(plan.part_at(exposure_s), rig.projector.caps.size))
        taken = [first + i for i in missing if start <= i < end]
        first += ends
        numbers += [*taken, *range(first + end - ends, first + end)] if taken else []
    after = first + plan.frames
    simulation.number_frames(numbers, max(simulation.next_frame, after))
