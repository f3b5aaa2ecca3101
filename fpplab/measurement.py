"""The steps of a measurement, each from open devices or recorded sessions to a result.

One code for the command line, the demonstration and the tests; nothing here knows what kind
of rig it runs on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fpplab.acquisition import Observer, acquire, expose, unseen
from fpplab.calibration import Calibration
from fpplab.characterisation import (
    Characterisation,
    Observation,
    characterise,
    finest_periods,
    observe,
)
from fpplab.clouds import Cloud, save_cloud
from fpplab.conventions import Floats
from fpplab.devices import Frame
from fpplab.errors import CalibrationError
from fpplab.gamma import Response, fit_response
from fpplab.patterns import uniform_patterns
from fpplab.phase import Decoded, decode
from fpplab.plan import Plan
from fpplab.reconstruction import triangulate
from fpplab.rig import Mounted, Rig
from fpplab.session import Session
from fpplab.targets import Target

Progress = Callable[[float], None]

DECODED, CLOUD, CALIBRATION, REPORT = "decoded.npz", "cloud.ply", "calibration.yaml", "report.html"
"""Names of the results inside a session."""


def nothing(share: float) -> None:
    """A progress report that nobody reads."""


def take(
    rig: Rig,
    plan: Plan,
    out: Path,
    mount: Mounted | None = None,
    *,
    force: bool = False,
    complete_too: bool = False,
    progress: Progress = nothing,
    observe_frame: Observer = unseen,
) -> Session:
    """Acquire the plan on an open rig into `out`, or complete the interrupted session there.

    mount: what the rig's fixture puts up first. complete_too: leave a session that is complete as it is,
    instead of refusing it.
    """
    session = Session.resume(out, plan, rig.described(mount), force, complete_too)
    if mount is not None and session.missing():
        rig.need_fixture(f"mounting the {mount[0]}").mount(*mount)

    def seen(frame: Frame) -> None:
        progress(1.0 - len(session.missing()) / plan.images)
        observe_frame(frame)

    acquire(rig, plan, session, seen)
    return session


def decode_session(session: Session, progress: Progress = nothing) -> Decoded:
    """Projector coordinates of every camera pixel. Raises `DataError`, `ConfigError`."""
    size, _ = session.projector()
    session.plan.check_projector(size, session.path)
    frames = session.stack(progress=lambda share: progress(0.5 * share))
    decoded = decode(frames, session.plan, size, session.format[2], str(session.path))
    progress(1.0)
    return decoded


def reconstruct(
    session: Session, calibration: Calibration, progress: Progress = nothing
) -> tuple[Decoded, Cloud]:
    """Decode and triangulate. Raises `CalibrationError` when the calibration is of another rig."""
    calibration.check_camera(session.format[:2], session.path)
    calibration.check_projector(*session.projector(), session.path)
    decoded = decode_session(session, progress)
    return decoded, triangulate(decoded, calibration, mean_image(session))


def finish_scan(
    session: Session, calibration: Calibration, progress: Progress = nothing
) -> tuple[Decoded, Cloud]:
    """Reconstruct a complete session and leave every result in it."""
    decoded, cloud = reconstruct(session, calibration, progress)
    decoded.save(session.path / DECODED)
    save_cloud(cloud, session.path / CLOUD)
    calibration.save(session.path / CALIBRATION)
    return decoded, cloud


def mean_image(session: Session) -> NDArray[np.uint8]:
    """The scene under even light, uint8 [v, u]: the mean of the finest set's frames, which is its offset."""
    finest = session.plan.sets_along(session.plan.axes[0])[-1]
    chosen = [i for i, (fringe, _, _) in enumerate(session.plan.steps()) if fringe == finest]
    width, height, bits = session.format
    total = np.zeros((height, width), np.float32)
    for i in chosen:
        total += session.read(i, verify=False)
    mean: NDArray[np.uint8] = np.rint(total / (len(chosen) * (1 << (bits - 8)))).clip(0, 255).astype(np.uint8)
    return mean


def take_poses(
    rig: Rig, plan: Plan, item: str, poses: int, folder: Path, force: bool, progress: Progress = nothing
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
    sessions: Sequence[Session], target: Target, progress: Progress = nothing
) -> Characterisation:
    """Camera, projector and the pose between them from one session per pose of a target.

    A pose in which the target is not found is left out and named, as long as enough remain.
    Raises `CalibrationError`.
    """
    size, lattice = sessions[0].projector()
    periods = finest_periods(sessions[0].plan, size)
    observations: list[Observation] = []
    left_out: dict[str, str] = {}
    for k, session in enumerate(sessions):
        decoded = decode_session(session)
        name = session.path.name
        try:
            observations.append(observe(name, mean_image(session), decoded, target, periods))
        except CalibrationError as error:
            left_out[name] = str(error)
        progress(0.8 * (k + 1) / len(sessions))
    width, height, _ = sessions[0].format
    result = characterise(observations, target, (width, height), size, lattice, left_out=left_out)
    progress(1.0)
    return result


def measure_response(
    rig: Rig, exposure_s: float, greys: Sequence[int] = tuple(range(0, 256, 17)), progress: Progress = nothing
) -> tuple[Response, Floats]:
    """Show uniform greys and fit the response; also the levels, (K, 2) of in and out in [0, 1].

    The mean of the middle ninth of the image stands for the frame: evenly lit, and free of the edge.
    """
    settings = rig.camera_settings(exposure_s)
    patterns = uniform_patterns(list(greys), rig.projector.caps.size)
    levels = []
    with closing(expose(rig, patterns, settings)) as shots:
        for grey, frame in zip(greys, shots, strict=True):
            height, width = frame.image.shape
            middle = frame.image[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3]
            levels.append((grey / 255.0, float(middle.mean()) / ((1 << frame.settings.bits) - 1)))
            progress(len(levels) / len(greys))
    measured = np.array(levels)
    return fit_response(measured[:, 0], measured[:, 1]), measured
