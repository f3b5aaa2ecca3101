"""Frames of a plan, acquired on an open rig into sessions."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

from fpplab.acquisition.acquire import FrameObserver, acquire, end_markers
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.core.session_names import JOURNAL
from fpplab.devices import Frame
from fpplab.devices.rig import Mounted, Rig
from fpplab.devices.simulation import NumberedFrames
from fpplab.patterns.plan import Plan
from fpplab.sessions.folder import need_space_for_frames
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.log import begin_session_log
from fpplab.sessions.origin import record_origin, session_origin
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


def take_or_resume_session(
    rig: Rig,
    plan: Plan,
    session_folder: Path,
    mounted_item: Mounted | None = None,
    *,
    replace_existing: bool = False,
    accept_complete: bool = False,
    place_item: Callable[[], object] | None = None,
    progress: Progress = no_progress,
    observe_frame: FrameObserver = ignore,
    exposed: Callable[[], object] = ignore,
) -> Session:
    """Acquire a plan on an open rig, or complete an interrupted session."""
    # Where the stage cannot go nothing is replaced.
    if plan.stage_mm is not None:
        rig.need_stage(plan.stage_mm)
    for entry in plan.stages or ():
        rig.need_stage(entry.at, entry.stage)
    with exclusive_write(session_folder):
        check_disk_space(rig, plan, [session_folder], replace_existing)
        session = Session.resume(
            session_folder, plan, rig.described(mounted_item), replace_existing, accept_complete
        )
        begin_session_log(session_folder)
        record_origin(session_folder, rig, next_frame_of(rig))
        number_frames(rig, session)
        if plan.stage_mm is not None and session.missing():
            rig.place_stage(plan.stage_mm)
        for entry in (plan.stages or ()) if session.missing() else ():
            rig.place_stage(entry.at, entry.stage)
        if mounted_item is not None and session.missing():
            fixture = rig.need_fixture(f"mounting the {mounted_item[0]}")
            place_item() if place_item else fixture.mount(*mounted_item)

        def report(frame: Frame) -> None:
            progress(1.0 - len(session.missing()) / plan.frames)
            observe_frame(frame)

        acquire(rig, plan, session, report, exposed)
        session.check_kept()
    return session


def plan_stage_moves(rig: Rig, plan: Plan, session_folder: Path, replace_existing: bool) -> dict[str, Any]:
    """Say what `take_or_resume_session` would do, without moving, projecting or writing anything."""
    check_disk_space(rig, plan, [session_folder], replace_existing)
    move = None if plan.stage_mm is None else asdict(rig.plan_stage_move(plan.stage_mm))
    for entry in plan.stages or ():
        rig.need_stage(entry.at, entry.stage)
    replaces = replace_existing and (session_folder / JOURNAL).is_file()
    return {"images": plan.frames, "stage": move, "replaces": replaces, "dry_run": True}


def check_disk_space(rig: Rig, plan: Plan, session_folders: Sequence[Path], replace_existing: bool) -> None:
    """Refuse sessions that do not fit on the disk, before anything is projected or written."""
    bits = rig.camera_settings(plan.exposure_s, plan.bits).bits
    need_space_for_frames(session_folders, plan, rig.camera.caps.size, bits, replace_existing)


def take_poses(
    rig: Rig,
    plan: Plan,
    item: str,
    poses: int,
    folder: Path,
    replace_existing: bool,
    progress: Progress = no_progress,
    observe_frame: FrameObserver = ignore,
) -> list[Session]:
    """Take one session for each pose of a target that the rig's fixture holds."""
    paths = [folder / f"pose_{pose:02d}" for pose in range(poses)]
    check_disk_space(rig, plan, paths, replace_existing)

    def take_pose(pose: int) -> Session:
        return take_or_resume_session(
            rig,
            plan,
            paths[pose],
            (item, pose),
            replace_existing=replace_existing,
            accept_complete=True,
            progress=lambda share: progress((pose + share) / poses),
            observe_frame=observe_frame,
        )

    return [take_pose(pose) for pose in range(poses)]
