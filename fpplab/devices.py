"""The one interface of every instrument: camera, projector, stage, fixture.

Public methods are final: they check state, capabilities and limits, and pass one
guard, so that these cannot differ between backends. A backend fills in the hooks,
the methods that begin with an underscore, and nothing else. A device refuses what it
cannot do and never clamps; what it did is read back from it.

States: CLOSED -> `open` -> IDLE -> (`arm`, `play`) ARMED -> IDLE; any fault of the
hardware leads to FAULT, from which only `close` is legal. `close` is legal from
anywhere and leaves the bench safe.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import TracebackType
from typing import Any, Literal, Self, final

import numpy as np

from fpplab.conventions import Image, Lattice
from fpplab.errors import (
    CapabilityError,
    ConfigError,
    DeviceError,
    FppError,
    FrameLossError,
    LimitError,
    NotOpenError,
    SettingError,
    StateError,
)
from fpplab.geometry import RigidTransform
from fpplab.patterns import Pattern

Trigger = Literal["software", "hardware"]


class State(StrEnum):
    """Where a device is in its life."""

    CLOSED = "closed"
    IDLE = "idle"
    ARMED = "armed"
    FAULT = "fault"


@dataclass(frozen=True)
class DeviceInfo:
    """What a device says it is: `link` is how it is connected."""

    kind: str
    model: str
    serial: str
    link: str


@dataclass(frozen=True)
class CameraSettings:
    """What a camera can be told. `bits` is the depth of the integers in a frame."""

    exposure_s: float
    gain_db: float = 0.0
    bits: int = 8


@dataclass(frozen=True)
class CameraCaps:
    """What a camera can do. size: (width, height) in px; ranges are (least, most)."""

    size: tuple[int, int]
    bits: tuple[int, ...]
    exposure_s: tuple[float, float]
    gain_db: tuple[float, float]
    triggers: tuple[Trigger, ...]


@dataclass(frozen=True)
class ProjectorCaps:
    """What a projector can do.

    size: (width, height) in mirrors. bit_depths: depths it can show, with the least
    exposure in s of each. max_patterns: how many it holds at once.
    """

    size: tuple[int, int]
    lattice: Lattice
    bit_depths: dict[int, float]
    trigger_outputs: int
    max_patterns: int


@dataclass(frozen=True)
class StageCaps:
    """Travel of a stage in mm, (least, most)."""

    travel_mm: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure: the sensor's raw integers, and where they come from.

    image: uint8 or uint16 [v, u], its owner's alone: no later frame changes it. index: the frame's
    number since `arm`, from 0, as the device counts, so that a gap is a lost frame; acquisition
    makes it the plan's. pattern_id: what was on show, when the backend knows; acquisition fills it
    in otherwise. device_time_s is None where the device has no clock.
    """

    image: Image
    index: int
    settings: CameraSettings
    host_time_s: float
    device_time_s: float | None = None
    pattern_id: str | None = None

    def showing(self, pattern_id: str, index: int) -> Frame:
        """The same frame, named as the picture of one pattern."""
        return replace(self, pattern_id=pattern_id, index=index)


class Device(ABC):
    """An instrument with a name, a state and a safe end.

    Subclasses are constructed by the rig as `Backend(name, options, bench)`: `options`
    is the rest of the device's section in the rig file, `bench` what the rig's devices share.
    """

    kind = "device"

    def __init__(self, name: str, options: dict[str, Any], bench: Any = None) -> None:
        self.name = name
        self._state = State.CLOSED
        self._setup(options, bench)

    @property
    @final
    def state(self) -> State:
        """The present state."""
        return self._state

    @final
    def open(self) -> None:
        """Connect. Raises `StateError` when open already, `DeviceError` when that fails."""
        if self._state is not State.CLOSED:
            raise StateError(self.name, "open", f"is {self._state} already", "close it first")
        self._forget()
        try:
            with self._guard("open"):
                self._open()
        except BaseException:
            self._close_quietly()
            raise
        self._state = State.IDLE

    @final
    def close(self) -> None:
        """Leave the bench safe and let go of the device; legal from any state, any number of times.

        Raises `DeviceError` when the device could not be made safe; it is CLOSED all the same.
        """
        if self._state is State.CLOSED:
            return
        try:
            with self._guard("close"):
                self._close()
        finally:
            self._state = State.CLOSED

    @final
    def __enter__(self) -> Self:
        self.open()
        return self

    @final
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @final
    def info(self) -> DeviceInfo:
        """Model, serial number and connection of an open device."""
        self._need(State.IDLE, State.ARMED, doing="info")
        with self._guard("info"):
            return self._info()

    def _need(self, *allowed: State, doing: str) -> None:
        if self._state in allowed:
            return
        if self._state is State.CLOSED:
            raise NotOpenError(self.name, doing, "is not open", "open it first")
        if self._state is State.FAULT:
            raise StateError(self.name, doing, "is in fault", "close it and open it again")
        raise StateError(self.name, doing, f"is {self._state}", "stop it first")

    @contextmanager
    def _guard(self, operation: str) -> Iterator[None]:
        """Run a hook: refusals pass, anything else becomes a `DeviceError` and faults the device."""
        try:
            yield
        except (SettingError, CapabilityError, LimitError, StateError):
            raise
        except FppError:
            self._fault()
            raise
        except Exception as error:
            self._fault()
            raise DeviceError(
                self.name, operation, f"{type(error).__name__}: {error}", "see the cause in the log"
            ) from error

    def _fault(self) -> None:
        if self._state is not State.CLOSED:
            self._state = State.FAULT

    def _close_quietly(self) -> None:
        try:
            self._close()
        except Exception:  # noqa: BLE001 - the failure to open is what the operator must see
            self._state = State.CLOSED

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        """Read the options of the rig file; raise `ConfigError` for wrong ones."""
        if options:
            raise ConfigError(f"'{self.name}' has no option '{next(iter(options))}'; take it away")

    def _forget(self) -> None:  # noqa: B027 - not every kind of device has something to forget
        """Drop what was known of the device: after a closing it may have been switched off."""

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _close(self) -> None:
        """Make safe and disconnect; must work after a failed `_open` and in FAULT."""

    @abstractmethod
    def _info(self) -> DeviceInfo: ...


class Camera(Device):
    """A camera: configure, then `snap`, or `arm` and `read`."""

    kind = "camera"
    _settings: CameraSettings | None = None
    _awaited = 0
    _taken = 0

    def _forget(self) -> None:
        self._settings = None

    @property
    @final
    def caps(self) -> CameraCaps:
        """What it can do; known once open."""
        self._need(State.IDLE, State.ARMED, doing="caps")
        with self._guard("caps"):
            return self._caps()

    @final
    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings and return what the device READ BACK.

        Raises `SettingError` for a value the device does not accept: it never clamps.
        """
        self._need(State.IDLE, doing="configure")
        caps = self.caps
        self._within("exposure_s", settings.exposure_s, caps.exposure_s, "s")
        self._within("gain_db", settings.gain_db, caps.gain_db, "dB")
        if settings.bits not in caps.bits:
            raise SettingError(
                self.name, "configure", f"bits is {settings.bits}", f"one of {list(caps.bits)}"
            )
        with self._guard("configure"):
            self._settings = self._configure(settings)
        return self._settings

    @final
    def arm(self, n: int, trigger: Trigger = "software") -> None:
        """Get ready for `n` frames. Raises `CapabilityError` for a trigger it has not."""
        self._need(State.IDLE, doing="arm")
        self._configured("arm")
        if n < 1:
            raise SettingError(self.name, "arm", f"n is {n}", "at least 1")
        if trigger not in self.caps.triggers:
            raise CapabilityError(self.name, "arm", f"has no {trigger} trigger")
        with self._guard("arm"):
            self._arm(n, trigger)
        self._awaited, self._taken = n, 0
        self._state = State.ARMED

    @final
    def read(self, timeout_s: float) -> Frame:
        """The next frame; the last one leaves the camera IDLE.

        Raises `TimeoutError`, `FrameLossError` (missing, or of another size or depth).
        """
        self._need(State.ARMED, doing="read")
        with self._guard("read"):
            frame = self._read(timeout_s)
            self._checked(frame)
        self._taken += 1
        if self._taken == self._awaited:
            self.stop()
        return frame

    @final
    def stop(self) -> None:
        """Give up waiting; legal whenever the camera is open."""
        self._need(State.IDLE, State.ARMED, doing="stop")
        with self._guard("stop"):
            self._stop()
        self._state = State.IDLE

    @final
    def snap(self, timeout_s: float = 10.0) -> Frame:
        """One frame by software trigger."""
        self.arm(1, "software")
        return self.read(timeout_s)

    def _within(self, what: str, value: float, allowed: tuple[float, float], unit: str) -> None:
        if not allowed[0] <= value <= allowed[1]:
            raise SettingError(
                self.name,
                "configure",
                f"{what} is {value:g} {unit}",
                f"the device accepts {allowed[0]:g} to {allowed[1]:g} {unit}",
            )

    def _configured(self, doing: str) -> CameraSettings:
        if self._settings is None:
            raise StateError(self.name, doing, "is not configured", "configure it first")
        return self._settings

    def _checked(self, frame: Frame) -> None:
        if frame.index != self._taken:
            raise FrameLossError(
                self.name,
                "read",
                f"frame {frame.index} arrived instead of frame {self._taken}",
                "see to the link to the camera, and take the frames again",
            )
        settings = self._configured("read")
        width, height = self.caps.size
        expected: type[np.unsignedinteger[Any]] = np.uint8 if settings.bits == 8 else np.uint16
        if frame.image.shape != (height, width) or frame.image.dtype != expected:
            raise FrameLossError(
                self.name,
                "read",
                f"frame {frame.index} is {frame.image.dtype} {frame.image.shape[::-1]}",
                f"{np.dtype(expected)} {(width, height)} was configured",
            )

    @abstractmethod
    def _caps(self) -> CameraCaps: ...

    @abstractmethod
    def _configure(self, settings: CameraSettings) -> CameraSettings: ...

    @abstractmethod
    def _arm(self, n: int, trigger: Trigger) -> None: ...

    @abstractmethod
    def _read(self, timeout_s: float) -> Frame: ...

    @abstractmethod
    def _stop(self) -> None: ...


class Projector(Device):
    """A projector: `load` patterns, then `show` them one by one or `play` them all."""

    kind = "projector"
    _loaded: tuple[Pattern, ...] = ()

    def _forget(self) -> None:
        self._loaded = ()

    @property
    @final
    def caps(self) -> ProjectorCaps:
        """What it can do; known once open."""
        self._need(State.IDLE, State.ARMED, doing="caps")
        with self._guard("caps"):
            return self._caps()

    @final
    def load(self, patterns: Sequence[Pattern]) -> tuple[Pattern, ...]:
        """Take patterns and return what will really be shown, quantised as the device does.

        Raises `SettingError` for a wrong size or depth, `CapabilityError` for too many.
        """
        self._need(State.IDLE, doing="load")
        caps = self.caps
        if not 1 <= len(patterns) <= caps.max_patterns:
            raise CapabilityError(
                self.name, "load", f"{len(patterns)} patterns given", f"holds 1 to {caps.max_patterns}"
            )
        for pattern in patterns:
            self._check_pattern(pattern, caps)
        own = [replace(pattern, image=pattern.image.copy()) for pattern in patterns]
        with self._guard("load"):
            self._loaded = tuple(self._load(own))
        return self._loaded

    @final
    def show(self, i: int) -> None:
        """Show loaded pattern `i` until told otherwise."""
        self._need(State.IDLE, doing="show")
        if not 0 <= i < len(self._loaded):
            raise SettingError(
                self.name, "show", f"pattern {i} was asked for", f"{len(self._loaded)} are loaded"
            )
        with self._guard("show"):
            self._show(i)

    @final
    def play(self, exposure_s: float) -> None:
        """Show every loaded pattern once, `exposure_s` each, giving a trigger pulse with each.

        The projector is ARMED until `blank`.
        Raises `CapabilityError` without trigger output, `SettingError` for too short an exposure.
        """
        self._need(State.IDLE, doing="play")
        caps = self.caps
        if not caps.trigger_outputs:
            raise CapabilityError(self.name, "play", "has no trigger output", "use a stepped plan")
        if not self._loaded:
            raise StateError(self.name, "play", "has no patterns", "load some first")
        least = max(caps.bit_depths[p.bit_depth] for p in self._loaded)
        if not exposure_s >= least:
            raise SettingError(self.name, "play", f"exposure_s is {exposure_s:g} s", f"at least {least:g} s")
        with self._guard("play"):
            self._play(exposure_s)
        self._state = State.ARMED

    @final
    def blank(self) -> None:
        """Go dark; legal whenever the projector is open."""
        self._need(State.IDLE, State.ARMED, doing="blank")
        with self._guard("blank"):
            self._blank()
        self._state = State.IDLE

    def _check_pattern(self, pattern: Pattern, caps: ProjectorCaps) -> None:
        width, height = caps.size
        if pattern.image.shape != (height, width) or pattern.image.dtype != np.uint8:
            found = " x ".join(map(str, pattern.image.shape[::-1]))
            raise SettingError(
                self.name,
                "load",
                f"pattern {pattern.id} is {pattern.image.dtype}, {found}",
                f"the projector takes uint8, {width} x {height} mirrors",
            )
        if pattern.bit_depth not in caps.bit_depths:
            raise SettingError(
                self.name,
                "load",
                f"pattern {pattern.id} has {pattern.bit_depth} bits",
                f"the projector shows {sorted(caps.bit_depths)}",
            )

    @abstractmethod
    def _caps(self) -> ProjectorCaps: ...

    @abstractmethod
    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]: ...

    @abstractmethod
    def _show(self, i: int) -> None: ...

    @abstractmethod
    def _play(self, exposure_s: float) -> None: ...

    @abstractmethod
    def _blank(self) -> None: ...


class Stage(Device):
    """A linear stage in mm."""

    kind = "stage"
    _homed = False

    def _forget(self) -> None:
        self._homed = False

    @property
    @final
    def caps(self) -> StageCaps:
        """What it can do; known once open."""
        self._need(State.IDLE, doing="caps")
        with self._guard("caps"):
            return self._caps()

    @final
    def home(self) -> None:
        """Find the reference; moves are refused before."""
        self._need(State.IDLE, doing="home")
        self._homed = False
        with self._guard("home"):
            self._home()
        self._homed = True

    @final
    def move_to(self, mm: float, timeout_s: float = 60.0) -> float:
        """Go to an absolute position and return the position READ BACK, in mm.

        Raises `LimitError` outside the travel, `StateError` before homing, `TimeoutError`.
        """
        self._need(State.IDLE, doing="move_to")
        least, most = self.caps.travel_mm
        if not least <= mm <= most:
            raise LimitError(
                self.name, "move_to", f"{mm:g} mm was asked for", f"the travel is {least:g} to {most:g} mm"
            )
        if not self._homed:
            raise StateError(self.name, "move_to", "is not homed", "home it first")
        with self._guard("move_to"):
            self._move_to(mm, time.monotonic() + timeout_s)
            return self._position_mm()

    @property
    @final
    def position_mm(self) -> float:
        """Where it is, read from the device."""
        self._need(State.IDLE, doing="position")
        with self._guard("position"):
            return self._position_mm()

    @final
    def halt(self) -> None:
        """Stop at once; the reference may be lost, so home again."""
        self._need(State.IDLE, State.ARMED, doing="halt")
        self._homed = False
        with self._guard("halt"):
            self._halt()

    @abstractmethod
    def _caps(self) -> StageCaps: ...

    @abstractmethod
    def _home(self) -> None: ...

    @abstractmethod
    def _move_to(self, mm: float, deadline_s: float) -> None:
        """Move, and return once there; raise `TimeoutError` at `deadline_s` of `time.monotonic`."""

    @abstractmethod
    def _position_mm(self) -> float: ...

    @abstractmethod
    def _halt(self) -> None: ...


@dataclass(frozen=True)
class FixtureCaps:
    """What a fixture can hold: for each item, in how many poses (None: as many as wanted)."""

    items: dict[str, int | None] = field(default_factory=dict)


class Fixture(Device):
    """What holds the thing that is measured: an operator's hands, a robot, or the twin's scene."""

    kind = "fixture"

    @property
    @final
    def caps(self) -> FixtureCaps:
        """What it can hold; known once open."""
        self._need(State.IDLE, doing="caps")
        with self._guard("caps"):
            return self._caps()

    @final
    def mount(self, item: str, pose: int = 0) -> None:
        """Put `item` in front of the rig in its pose number `pose`, or take all away with "nothing".

        Raises `SettingError` for an item or pose that it has not.
        """
        self._need(State.IDLE, doing="mount")
        if item != "nothing":
            self._check_held("mount", item, pose)
        with self._guard("mount"):
            self._mount(item, pose)

    @final
    def pose(self, item: str, pose: int = 0) -> RigidTransform | None:
        """T_camera_item of `item` in its pose number `pose`, or None where the fixture does not know.

        Raises `SettingError` for an item or pose that it has not.
        """
        self._need(State.IDLE, doing="pose")
        self._check_held("pose", item, pose)
        with self._guard("pose"):
            return self._pose(item, pose)

    def _check_held(self, doing: str, item: str, pose: int) -> None:
        items = self.caps.items
        if item not in items:
            raise SettingError(self.name, doing, f"has no item '{item}'", f"it has {sorted(items)}")
        poses = items[item]
        if pose < 0 or (poses is not None and pose >= poses):
            raise SettingError(self.name, doing, f"{item} has no pose {pose}", f"it has {poses}")

    def _pose(self, item: str, pose: int) -> RigidTransform | None:
        """An operator's hands know no pose; a fixture that does overrides this."""
        return None

    @abstractmethod
    def _caps(self) -> FixtureCaps: ...

    @abstractmethod
    def _mount(self, item: str, pose: int) -> None: ...
