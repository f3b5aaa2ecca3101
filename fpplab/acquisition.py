"""Patterns -> frames: the one place that keeps projector and camera in step.

Stepped: show, settle, snap, one pattern at a time. Triggered: the projector is the clock,
and each of its pulses exposes one frame.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing

from fpplab.devices import Camera, CameraSettings, Frame, Projector
from fpplab.errors import SyncError
from fpplab.patterns import Pattern, make_patterns
from fpplab.plan import Plan
from fpplab.rig import Rig
from fpplab.session import Session

PATIENCE_S = 10.0
"""How long beyond its exposure a frame may take."""

Observer = Callable[[Frame], None]
"""Sees each frame once it is on disk: a progress bar, a viewer."""


def unseen(frame: Frame) -> None:
    """An observer that does not look."""


def acquire(rig: Rig, plan: Plan, session: Session, observe: Observer = unseen) -> None:
    """Take every image of the plan that the session lacks.

    The projector is dark afterwards, whatever happened. Raises `DeviceError`, `DataError`.
    """
    settings = rig.camera_settings(plan.exposure_s)
    caps = rig.projector.caps
    patterns = make_patterns(plan, caps.size, caps.lattice)
    wanted = session.missing()
    with closing(expose(rig, [patterns[i] for i in wanted], settings, plan)) as shots:
        for index, shot in zip(wanted, shots, strict=True):
            frame = shot.showing(patterns[index].id, index)
            session.write(frame)
            observe(frame)


def expose(
    rig: Rig, patterns: Sequence[Pattern], settings: CameraSettings, plan: Plan | None = None
) -> Generator[Frame, None, None]:
    """One frame per pattern, in order, synchronised as the plan says (stepped without one).

    The bench is dark again once the generator ends or is closed; who may leave it early closes it.
    """
    if not patterns:
        return
    camera, projector = rig.camera, rig.projector
    try:
        settings = camera.configure(settings)
        projector.load(patterns)
        if plan is not None and plan.trigger == "triggered":
            yield from _triggered(camera, projector, patterns, settings)
        else:
            yield from _stepped(camera, projector, patterns, settings, plan.settle_s if plan else 0.0)
    finally:
        rig.make_dark()


def _stepped(
    camera: Camera,
    projector: Projector,
    patterns: Sequence[Pattern],
    settings: CameraSettings,
    settle_s: float,
) -> Iterator[Frame]:
    for i, pattern in enumerate(patterns):
        projector.show(i)
        time.sleep(settle_s)  # the display's own latency, which the plan states
        yield _in_step(camera, camera.snap(timeout_s=settings.exposure_s + PATIENCE_S), pattern)


def _triggered(
    camera: Camera, projector: Projector, patterns: Sequence[Pattern], settings: CameraSettings
) -> Iterator[Frame]:
    camera.arm(len(patterns), "hardware")
    projector.play(settings.exposure_s + camera.caps.readout_s)
    for pattern in patterns:
        yield _in_step(camera, camera.read(timeout_s=settings.exposure_s + PATIENCE_S), pattern)


def _in_step(camera: Camera, frame: Frame, pattern: Pattern) -> Frame:
    """Where the camera's backend knows what was on show, it must be what was asked for."""
    if frame.pattern_id not in (None, pattern.id):
        raise SyncError(
            camera.name,
            "read",
            f"the frame shows '{frame.pattern_id}' instead of '{pattern.id}'",
            "see that nothing else drives the projector, and scan again",
        )
    return frame
