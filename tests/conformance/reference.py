"""A rig without optics that has every capability: what the conformance suite is measured on.

The camera sees the projector's image pixel for pixel, scaled to its own size, and adds a
black level and noise. Nothing else happens, so that every deviation is a fault of the
device interface.
"""

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fpplab.core.conventions import Floats, Image, Lattice, full_scale, raw_dtype
from fpplab.core.errors import DeviceTimeoutError
from fpplab.devices import (
    Camera,
    CameraCaps,
    CameraSettings,
    DeviceInfo,
    Fixture,
    FixtureCaps,
    Frame,
    Projector,
    ProjectorCaps,
    Stage,
    StageCaps,
    Trigger,
)
from fpplab.patterns.fringes import Pattern, quantise

CAMERA_SIZE, PROJECTOR_SIZE = (48, 32), (24, 16)
READOUT_S = 0.004
EXPOSURE_TICK_S, GAIN_STEP_DB, STAGE_STEP_MM = 1e-5, 0.1, 0.0125
BLACK, WHITE, NOISE = 0.02, 0.7, 0.002
REFERENCE_EXPOSURE_S = 0.02


@dataclass
class ReferenceBench:
    """The light between the devices."""

    options: dict[str, Any]
    following: deque[Pattern] = field(default_factory=deque)  # patterns that ends of exposures bring

    def open(self) -> None:
        self.on_show: Pattern | None = None
        self.pulses: deque[Pattern] = deque()
        self.frames_to_lose = 0
        self.reflectance = 1.0
        self.random = np.random.default_rng(1)

    def close(self) -> None:
        self.on_show = None

    def lose_frames(self, n: int) -> None:
        """Lose the next frames on the link from the camera."""
        self.frames_to_lose = n

    def light(self, pattern: Pattern | None) -> Floats:
        """Share of full scale at the reference exposure, (height, width) of the camera."""
        width, height = CAMERA_SIZE
        light = np.full((height, width), BLACK)
        if pattern is not None:
            rows = np.arange(height) * PROJECTOR_SIZE[1] // height
            columns = np.arange(width) * PROJECTOR_SIZE[0] // width
            light += self.reflectance * WHITE * pattern.image[np.ix_(rows, columns)] / 255.0
        light += self.random.normal(0.0, NOISE, light.shape)
        return light


def sensor_image(bench: ReferenceBench, pattern: Pattern | None, settings: CameraSettings) -> Image:
    """What a camera without any noise of its own sees of a pattern, in raw integers."""
    gain = settings.exposure_s / REFERENCE_EXPOSURE_S * 10 ** (settings.gain_db / 20)
    share = np.clip(bench.light(pattern) * gain, 0.0, 1.0)
    return np.rint(share * full_scale(settings.bits)).astype(raw_dtype(settings.bits))


class ReferenceCamera(Camera):
    """Reads exposure and gain back on its own grid, and keeps one buffer as drivers do."""

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        super()._setup(options, bench)
        self._bench: ReferenceBench = bench

    def _open(self) -> None:
        self._applied = CameraSettings(REFERENCE_EXPOSURE_S)
        self._trigger: Trigger = "software"
        self._count = 0
        self._opened_s = time.monotonic()

    def _close(self) -> None:
        self._bench.pulses.clear()

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", "reference", "1", "memory")

    def _caps(self) -> CameraCaps:
        triggers: tuple[Trigger, ...] = ("software", "hardware")
        bits, exposures_s, gains_db = (8, 12), (1e-4, 1.0), (0.0, 12.0)
        return CameraCaps(
            CAMERA_SIZE, bits, exposures_s, gains_db, triggers, READOUT_S, period_s=0.0, strobe=True
        )

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        exposure = round(settings.exposure_s / EXPOSURE_TICK_S) * EXPOSURE_TICK_S
        gain = round(settings.gain_db / GAIN_STEP_DB) * GAIN_STEP_DB
        self._applied = CameraSettings(exposure, gain, settings.bits)
        shape = self.caps.size[::-1]
        self._buffer: Image = np.zeros(shape, np.uint8) if settings.bits == 8 else np.zeros(shape, np.uint16)
        return self._applied

    def _arm(self, n: int, trigger: Trigger) -> None:
        self._trigger, self._count = trigger, 0
        self._bench.pulses.clear()

    def _read(self, timeout_s: float) -> Frame:
        pattern = self._arrived()
        settings = self._applied
        self._buffer[...] = self._levels(pattern)
        frame = Frame(
            self._buffer.copy(),
            self._count,
            settings,
            time.time(),
            time.monotonic() - self._opened_s,
            pattern.id or None if pattern else None,
        )
        self._count += 1
        if following := getattr(self._bench, "following", None):
            self._bench.on_show = following.popleft()
        return frame

    def _arrived(self) -> Pattern | None:
        """What was on show at the next exposure whose frame is not lost on the link."""
        pattern = self._exposed()
        while self._bench.frames_to_lose:
            self._bench.frames_to_lose -= 1
            self._count += 1
            pattern = self._exposed()
        return pattern

    def _levels(self, pattern: Pattern | None) -> Floats | Image:
        settings = self._applied
        gain = settings.exposure_s / REFERENCE_EXPOSURE_S * 10 ** (settings.gain_db / 20)
        full = (1 << settings.bits) - 1
        return np.asarray(np.rint(np.clip(self._bench.light(pattern) * gain, 0.0, 1.0) * full))

    def _exposed(self) -> Pattern | None:
        if self._trigger == "software":
            return self._bench.on_show
        if not self._bench.pulses:
            raise DeviceTimeoutError(self.name, "read", "no trigger came", "see to the trigger cable")
        return self._bench.pulses.popleft()

    def _stop(self) -> None:
        self._bench.pulses.clear()


class ReferenceProjector(Projector):
    """Shows patterns at 1 or 8 bits and pulses with each that it plays."""

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        super()._setup(options, bench)
        self._bench: ReferenceBench = bench

    def _open(self) -> None:
        self._held: list[Pattern] = []

    def _close(self) -> None:
        self._bench.on_show = None

    def _info(self) -> DeviceInfo:
        return DeviceInfo("projector", "reference", "2", "memory")

    def _caps(self) -> ProjectorCaps:
        return ProjectorCaps(PROJECTOR_SIZE, Lattice.DIAMOND, {1: 2e-4, 8: 8e-3}, 1, 32, trigger_inputs=1)

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        self._held = [replace(p, image=quantise(p.image / 255.0, p.bit_depth)) for p in patterns]
        return self._held

    def _show(self, i: int) -> None:
        self._bench.on_show = self._held[i]

    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None:
        self._bench.pulses.extend(self._held)

    def _follow(self, pulse_s: float) -> None:
        first, *others = self._held
        self._bench.on_show, self._bench.following = first, deque(others)

    def _blank(self) -> None:
        self._bench.following = deque()
        self._bench.on_show = None


class ReferenceStage(Stage):
    """Moves at once, in whole steps."""

    def _open(self) -> None:
        self._steps = 400

    def _close(self) -> None:
        """Nothing moves by itself."""

    def _info(self) -> DeviceInfo:
        return DeviceInfo("stage", "reference", "3", "memory")

    def _caps(self) -> StageCaps:
        return StageCaps((0.0, 50.0))

    def _home(self) -> None:
        self._steps = 0

    def _move_to(self, mm: float, deadline_s: float) -> None:
        if time.monotonic() >= deadline_s:
            raise DeviceTimeoutError(self.name, "move_to", f"is at {self._position_mm():g} mm still")
        self._steps = round(mm / STAGE_STEP_MM)

    def _position_mm(self) -> float:
        return self._steps * STAGE_STEP_MM

    def _halt(self) -> None:
        """Nothing moves by itself."""


class ReferenceFixture(Fixture):
    """Holds a white sheet or a grey one."""

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        super()._setup(options, bench)
        self._bench: ReferenceBench = bench

    def _open(self) -> None:
        """Always there."""

    def _close(self) -> None:
        """Always there."""

    def _info(self) -> DeviceInfo:
        return DeviceInfo("fixture", "reference", "4", "memory")

    def _caps(self) -> FixtureCaps:
        return FixtureCaps({"white": None, "grey": 2})

    def _mount(self, item: str, pose: int) -> None:
        self._bench.reflectance = {"nothing": 0.05, "grey": 0.5, "white": 1.0}[item]
