"""The steps of a measurement, each from open devices or recorded sessions to a result.

One code for the command line, the demonstration and the tests; nothing here knows what kind
of rig it runs on.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fpplab.acquisition.acquire import FrameObserver, acquire, expose
from fpplab.acquisition.synchronisation import check_synchronisation, remedy
from fpplab.calibration.model import Calibration
from fpplab.characterisation import (
    Characterisation,
    DistortionModel,
    Observation,
    characterise,
    finest_periods,
    observe,
)
from fpplab.clouds import Cloud, save_cloud
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError, DataError
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.devices import Frame
from fpplab.devices.rig import Mounted, Rig
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import FilterRules, GreyLevels, Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.response import Response
from fpplab.patterns.response_fit import GreyLevelImages, fit_greys, pixels_of_regions, statistics
from fpplab.phase import Decoded, decode
from fpplab.reconstruction.filtering import filtered
from fpplab.reconstruction.triangulation import triangulate
from fpplab.reconstruction.uncertainty import coordinate_noise, with_uncertainty
from fpplab.sessions.session import Session
from fpplab.targets import Target

DECODED, CLOUD, CALIBRATION, REPORT = "decoded.npz", "cloud.ply", "calibration.yaml", "report.html"
"""Names of the results inside a session."""


def take(
    rig: Rig,
    plan: Plan,
    out: Path,
    mount: Mounted | None = None,
    *,
    force: bool = False,
    complete_too: bool = False,
    progress: Progress = no_progress,
    observe_frame: FrameObserver = ignore,
) -> Session:
    """Acquire the plan on an open rig into `out`, or complete the interrupted session there.

    mount: what the rig's fixture puts up first. complete_too: leave a session that is complete as it is,
    instead of refusing it. Where the stage cannot go nothing is replaced.
    """
    if plan.stage_mm is not None:
        rig.need_stage(plan.stage_mm)
    session = Session.resume(out, plan, rig.described(mount), force, complete_too)
    if plan.stage_mm is not None and session.missing():
        rig.place_stage(plan.stage_mm)
    if mount is not None and session.missing():
        rig.need_fixture(f"mounting the {mount[0]}").mount(*mount)

    def seen(frame: Frame) -> None:
        progress(1.0 - len(session.missing()) / plan.images)
        observe_frame(frame)

    acquire(rig, plan, session, seen)
    return session


def decode_session(session: Session, progress: Progress = no_progress) -> Decoded:
    """Find the projector coordinates of every camera pixel of a session.

    Parameters
    ----------
    session : Session
        A complete one.
    progress : callable
        Told the share done, 0 … 1.

    Returns
    -------
    Decoded
        Maps (height, width) of float32.

    Raises
    ------
    DataError
        Frames are missing or damaged, or out of step with the plan.
    ConfigError
        The plan cannot be unwrapped.
    """
    return _decode_in_step(session.recording(progress=lambda share: progress(0.5 * share)), progress)


def _decode_in_step(recording: Recording, progress: Progress) -> Decoded:
    if fault := _out_of_step(recording):
        raise DataError(f"{recording.name}: {fault}; take it again, with --force")
    return decode(recording, lambda share: progress(0.5 + 0.5 * share))


def _out_of_step(recording: Recording) -> str | None:
    """How the frames are out of step with the plan, and what to see to."""
    verdict = check_synchronisation(recording.frames, recording.plan, recording.bits)
    return None if verdict.in_step else f"{verdict.words()}; {remedy(recording.plan)}"


def reconstruct(
    session: Session,
    calibration: Calibration,
    progress: Progress = no_progress,
    *,
    filtering: bool | None = None,
) -> tuple[Decoded, Cloud]:
    """Decode, triangulate, filter, and say how well each point is known.

    filtering: whether to filter; by default as the session's plan says. A plan without rules means the usual.
    Raises `CalibrationError` when the calibration is of another rig.
    """
    calibration.check_camera(session.format[:2], session.path)
    calibration.check_projector(*session.projector(), session.path)
    recording = session.recording(progress=lambda share: progress(0.3 * share))
    decoded = _decode_in_step(recording, lambda share: progress(0.6 * share))
    plan = recording.plan
    if filtering is not None:
        plan = plan.model_copy(update={"filter": (plan.filter or FilterRules()) if filtering else None})
    decoded, cloud = points_of(decoded, calibration, plan, recording.mean_image())
    noise = coordinate_noise(decoded)
    return decoded, with_uncertainty(cloud, calibration, noise, lambda share: progress(0.7 + 0.3 * share))


def points_of(
    decoded: Decoded, calibration: Calibration, plan: Plan, texture: NDArray[np.uint8] | None = None
) -> tuple[Decoded, Cloud]:
    """Triangulate, and filter as the plan says: the cloud, and the maps that know what was removed.

    texture: as in `triangulate`, and the same errors.
    """
    cloud = triangulate(decoded, calibration, texture, normals=plan.filter is None)
    return filtered(decoded, cloud, plan, calibration.projector.size)


def finish_scan(
    session: Session, calibration: Calibration, progress: Progress = no_progress
) -> tuple[Decoded, Cloud]:
    """Reconstruct a complete session and leave every result in it."""
    decoded, cloud = reconstruct(session, calibration, progress)
    decoded.save(session.path / DECODED)
    save_cloud(cloud, session.path / CLOUD)
    calibration.save(session.path / CALIBRATION)
    return decoded, cloud


def take_poses(
    rig: Rig, plan: Plan, item: str, poses: int, folder: Path, force: bool, progress: Progress = no_progress
) -> list[Session]:
    """One session per pose of a target that the rig's fixture holds; poses taken before are kept."""

    def one(pose: int) -> Session:
        return take(
            rig,
            plan,
            folder / f"pose_{pose:02d}",
            (item, pose),
            force=force,
            complete_too=True,
            progress=lambda share: progress((pose + share) / poses),
        )

    return [one(pose) for pose in range(poses)]


def characterise_sessions(
    sessions: Sequence[Session],
    target: Target,
    progress: Progress = no_progress,
    *,
    level: DistortionModel | Literal["auto"] = "auto",
    refine_board: bool | None = None,
) -> Characterisation:
    """Camera, projector and the pose between them from one session per pose of a target.

    A pose in which the target is not found, or whose frames are out of step with the plan, is left out
    and named, as long as enough remain. level, refine_board: as in `characterise`.
    Raises `CalibrationError`.
    """
    size, lattice = sessions[0].projector()
    periods = finest_periods(sessions[0].plan, size)
    observations: list[Observation] = []
    left_out: dict[str, str] = {}
    for k, session in enumerate(sessions):
        try:
            observations.append(_observe_session(session, target, periods))
        except CalibrationError as error:
            left_out[session.path.name] = str(error)
        progress(0.8 * (k + 1) / len(sessions))
    width, height, _ = sessions[0].format
    result = characterise(
        observations,
        target,
        (width, height),
        size,
        lattice,
        left_out=left_out,
        level=level,
        refine_board=refine_board,
    )
    progress(1.0)
    return result


def _observe_session(session: Session, target: Target, periods: tuple[float, float]) -> Observation:
    """What one pose tells. Raises `CalibrationError` that names it."""
    name, recording = session.path.name, session.recording()
    if fault := _out_of_step(recording):
        raise CalibrationError(f"{name}: {fault}; take this pose again")
    return observe(name, recording.mean_image(), decode(recording), target, periods)


def measure_response(
    rig: Rig, exposure_s: float, greys: GreyLevels | None = None, progress: Progress = no_progress
) -> tuple[Response, Floats]:
    """Show uniform greys and fit the response; also the levels fitted, (K, 2) of in and out in [0, 1].

    The greys are shown from black to white and back, `repeats` times in all, so that a lamp that drifts
    does not pass for a response; before them one frame with the projector off.
    Raises `CalibrationError`, `DeviceError`.
    """
    wanted = greys or GreyLevels()
    settings = rig.camera_settings(exposure_s)
    patterns = uniform_patterns(wanted.shown, rig.projector.caps.size)
    dark = _dark_frame(rig, exposure_s)
    seen = np.empty((wanted.repeats, len(patterns), *statistics(dark.image, dark.settings.bits).shape))
    for repeat in range(wanted.repeats):
        order = range(len(patterns))[:: 1 if repeat % 2 == 0 else -1]
        with closing(expose(rig, [patterns[i] for i in order], settings)) as shots:
            for done, (i, frame) in enumerate(zip(order, shots, strict=True), 1):
                seen[repeat, i] = statistics(frame.image, frame.settings.bits)
                progress((repeat + done / len(patterns)) / wanted.repeats)
    response = fit_greys(
        GreyLevelImages(
            shown=np.array(wanted.shown) / 255.0,
            seen=seen,
            dark=statistics(dark.image, dark.settings.bits),
            pixels=pixels_of_regions(dark.image),
            bits=dark.settings.bits,
        )
    )
    return response, np.array([(level.shown, level.seen) for level in response.measured])


def _dark_frame(rig: Rig, exposure_s: float) -> Frame:
    """A frame with the projector off: the camera's black level, and the light of the room."""
    rig.camera.configure(rig.camera_settings(exposure_s))
    rig.make_dark()
    return rig.camera.snap()
