"""A recorded session played back through the device interface.

    bench:     {backend: "fpplab.sessions.replay:RecordedSession", session: path/to/session}
    camera:    {backend: "fpplab.sessions.replay:ReplayCamera"}
    projector: {backend: "fpplab.sessions.replay:ReplayProjector"}

The projector knows which recorded pattern is asked for, the camera gives the frame that was
taken of it. Nothing is invented: other patterns, settings or more frames than were recorded
are refused.
"""

import time
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from fpplab.core.conventions import Image
from fpplab.core.errors import CapabilityError, ConfigError, DataError, FrameLossError
from fpplab.devices import (
    Camera,
    CameraCaps,
    CameraSettings,
    DeviceInfo,
    Frame,
    Projector,
    ProjectorCaps,
    Trigger,
)
from fpplab.patterns.fringe_sets import LedName
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.sessions.journal import FrameRecord
from fpplab.sessions.origin import session_origin
from fpplab.sessions.session import Session


class RecordedSession:
    """What the replayed devices share: the session, and which of its patterns is on show."""

    def __init__(self, options: dict[str, Any]) -> None:
        unknown = set(options) - {"session"}
        if unknown or not isinstance(options.get("session"), str):
            raise ConfigError("bench: a replay takes exactly one option, 'session': the recorded directory")
        self.session = Session.open(Path(options["session"]))
        self.shown: int | None = None

    def open(self) -> None:
        _ = self.session.format

    def close(self) -> None:
        """Nothing is held open between frames."""

    def first(self) -> FrameRecord:
        return self.session.records[0]

    def exposures(self) -> dict[float, int]:
        """Give the place in the plan of each exposure in s that was recorded."""
        starts = self.session.plan.pass_starts
        return {record.exposure_s: bisect_right(starts, record.index) - 1 for record in self.session.records}

    def frame_of(self, exposure_s: float, image: int) -> int:
        k, plan = self.exposures()[exposure_s], self.session.plan
        if image not in plan.passes[k]:
            raise DataError(f"image {image} was not recorded at {exposure_s:g} s")
        return plan.pass_starts[k] + plan.passes[k].index(image)

    def camera_offset(self) -> tuple[int, int] | None:
        origin = session_origin(self.session.path)
        return origin.camera_offset if origin else None

    def info(self, name: str) -> DeviceInfo:
        path = self.session.path
        origin = session_origin(path)
        recorded = origin.devices.get(name) if origin else None
        model, serial = (recorded.model, recorded.serial) if recorded else ("replay", "")
        return DeviceInfo(name, model, serial, f"replay of session {path}")


def _recording(name: str, shared: Any) -> RecordedSession:
    if not isinstance(shared, RecordedSession):
        raise ConfigError(f"{name}: a replay needs the bench fpplab.sessions.replay:RecordedSession")
    return shared


class ReplayCamera(Camera):
    """Gives the recorded frame of the pattern that the replayed projector shows."""

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        super()._setup(options, shared)
        self._recording = _recording(self.name, shared)

    def _open(self) -> None:
        """The bench holds the recording."""

    def _close(self) -> None:
        """Nothing to make safe."""

    def _info(self) -> DeviceInfo:
        return self._recording.info("camera")

    def _caps(self) -> CameraCaps:
        width, height, bits = self._recording.session.format
        first, exposures = self._recording.first(), self._recording.exposures()
        return CameraCaps(
            size=(width, height),
            bits=(bits,),
            exposure_s=(min(exposures), max(exposures)),
            gain_db=(first.gain_db, first.gain_db),
            triggers=("software",),
            offset=self._recording.camera_offset(),
            bayer=self._recording.session.bayer,
        )

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        recorded = self._recording.exposures()
        nearest_s = min(recorded, key=lambda each: abs(each - settings.exposure_s))
        return replace(settings, exposure_s=nearest_s)

    def _arm(self, n: int, trigger: Trigger) -> None:
        """Every frame is there already."""

    def _read(self, timeout_s: float) -> Frame:
        shown = self._recording.shown
        if shown is None:
            raise FrameLossError(self.name, "read", "the projector is dark, and no dark frame was recorded")
        try:
            index = self._recording.frame_of(self._configured("read").exposure_s, shown)
            record = self._recording.session.record(index)
            image: Image = self._recording.session.read(index).copy()
        except DataError as error:
            raise FrameLossError(self.name, "read", str(error), "record the session again") from error
        return Frame(image, self._taken, record.settings, time.time(), record.device_time_s, record.pattern)

    def _stop(self) -> None:
        """Nothing is under way between calls."""


class ReplayProjector(Projector):
    """Accepts the recorded patterns, and no others."""

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        super()._setup(options, shared)
        self._recording = _recording(self.name, shared)
        self._indices: list[int] = []

    def _open(self) -> None:
        session = self._recording.session
        size, lattice = session.projector()
        self._recorded = {p.id: (i, p) for i, p in enumerate(make_patterns(session.plan, size, lattice))}

    def _close(self) -> None:
        self._recording.shown = None

    def _info(self) -> DeviceInfo:
        return self._recording.info("projector")

    def _caps(self) -> ProjectorCaps:
        size, lattice = self._recording.session.projector()
        depths = {pattern.bit_depth: 0.0 for _, pattern in self._recorded.values()}
        recorded = len(self._recorded)
        return ProjectorCaps(
            size, lattice, depths, trigger_outputs=0, max_patterns=recorded, leds=get_args(LedName)
        )

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        self._indices = [self._recorded_index(p) for p in patterns]
        return patterns

    def _recorded_index(self, pattern: Pattern) -> int:
        index, recorded = self._recorded.get(pattern.id, (None, None))
        if index is None or recorded is None or not np.array_equal(recorded.image, pattern.image):
            raise CapabilityError(
                self.name,
                "load",
                f"pattern '{pattern.id}' was not recorded in {self._recording.session.path}",
                "replay it with the plan it was taken with",
            )
        return index

    def _show(self, i: int) -> None:
        self._recording.shown = self._indices[i]

    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None:
        raise CapabilityError(self.name, "play", "a recording has no clock", "use a stepped plan")

    def _blank(self) -> None:
        self._recording.shown = None
