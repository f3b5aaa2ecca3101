"""A rig file -> open devices, closed safely.

    name: Virtual bench
    bench:     {backend: virtual_bench, world: world_demo.yaml}
    camera:    {backend: virtual_camera, bits: 8}
    projector: {backend: virtual_projector}

`backend` names the class that drives the device: `module:Class`. `bench` is what the devices
share, where they share anything; `stage` and `fixture` are optional. `bits`, `gain_db` and `dead_time_s` are
the camera's standing settings; every other key goes to the backend, which refuses what it does not know.
`depth_mm` may state the range of distances from the camera in which everything visible lies, for plans that
state none; `geometry: {max_age_h: 8}` for how many hours a calibration holds. A relative file name is first
looked up in the rig file's folder.
"""

from __future__ import annotations

import logging
import re
import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.depth import DepthField
from fpplab.core.errors import ConfigError
from fpplab.core.file_kinds import naming_other_kinds
from fpplab.core.interrupts import held_back
from fpplab.devices import Camera, CameraSettings, Device, Fixture, Projector, Stage, StageMove, State
from fpplab.devices.backends import SharedBackend, load_backend
from fpplab.devices.rig_lock import using_rig
from fpplab.patterns.curve import Curve
from fpplab.patterns.response import with_named_response

Dev = TypeVar("Dev", bound=Device)

_log = logging.getLogger(__name__)

Mounted = tuple[str, int]  # an item and its pose, as a fixture names them


def _named(backend: str) -> str:
    if not re.fullmatch(r"[\w-]+|\w+(\.\w+)*:\w+", backend):
        raise ValueError("must be a name that a package announces, such as basler, or module:Class")
    return backend


class DeviceSection(Document):
    """One device of a rig file; keys beyond these are the backend's own options."""

    model_config = ConfigDict(extra="allow")

    backend: Annotated[str, AfterValidator(_named)]
    """The class that drives the device: by an announced name, such as `basler`, or as `module:Class`."""

    @property
    def options(self) -> dict[str, Any]:
        """What goes to the backend."""
        return dict(self.model_extra or {})


class DeadTime(Document):
    """Dead time of a camera that needs longer after longer exposures."""

    fixed_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Part in s that is always the same."""
    of_exposure: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Part that grows, as a share of the exposure."""


class CameraSection(DeviceSection):
    """The camera and its standing settings."""

    bits: Literal[8, 10, 12, 16] = 8
    """Depth of the frames' grey levels, where the plan gives none."""

    gain_db: float = 0.0
    """Gain in dB."""

    dead_time_s: Annotated[float, Field(ge=0, le=10)] | DeadTime | None = None
    """Time in s after each exposure in which the camera ignores a trigger, where it is longer than the camera
    reports; for a camera that reports nothing it is 1 ms by default. For triggered plans. One that grows with
    the exposure is `{fixed_s: 0.001, of_exposure: 0.1}`.
    """

    def dead_s(self, exposure_s: float) -> float | None:
        """Give the stated dead time in s after an exposure in s; None where none is stated."""
        stated = self.dead_time_s
        if isinstance(stated, DeadTime):
            return stated.fixed_s + stated.of_exposure * exposure_s
        return stated


class StageSection(DeviceSection):
    """The stage, and how far it may go."""

    soft_limits_mm: tuple[float, float] | None = None
    """Positions in mm, of a turning stage in degrees, that are exceeded only with consent; by default only
    the travel limits it."""

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if self.soft_limits_mm is not None and self.soft_limits_mm[0] >= self.soft_limits_mm[1]:
            raise ValueError("'soft_limits_mm' must be two rising positions")
        return self


class DepthSection(Document):
    """The part of a rig file that says where everything lies."""

    depth_mm: DepthField | None = None
    """Least and greatest distance from the camera along its axis, in mm, between which everything lies that
    is seen: for plans without a `depth_mm` of their own. By default unknown.
    """


class GeometrySection(Document):
    """The part of a rig file that says how well the rig keeps its geometry."""

    max_age_h: Annotated[float, Field(gt=0, le=10_000)]
    """For how many hours after the poses of its characterisation, or of the last board that confirmed it, a
    calibration is taken to hold, as long as no scan contradicts it."""
    settings: dict[str, float | str] | None = None
    """What is set by hand and read off, such as `aperture: 8`: a calibration holds for these alone."""
    temperature_c: Annotated[float, Field(ge=-50, le=100)] | None = None
    """Temperature of the rig now, in °C, where it is read off."""
    max_change_k: Annotated[float, Field(gt=0, le=100)] = 2.0
    """By how much the temperature may differ from that at the characterisation. Chosen: a mount of aluminium
    with a baseline of 200 mm grows by 10 µm."""


def _stage_names(stages: dict[str, StageSection] | None) -> dict[str, StageSection] | None:
    if taken := sorted({"camera", "projector", "stage", "fixture"} & set(stages or {})):
        raise ValueError(f"'stages' has one called '{taken[0]}', as another section is; call it otherwise")
    return stages


class RigFile(DepthSection):
    """Schema of a rig file."""

    name: str
    """What the rig is called in reports and messages."""

    notes: tuple[str, ...] | None = None
    """What the user of the rig should know, logged each time it is opened: reasons for which a matched twin
    would have been refused, had they not been accepted.
    """

    camera: CameraSection
    """The camera."""

    projector: DeviceSection
    """The projector."""

    bench: DeviceSection | None = None
    """What the devices share, where they share anything: a simulated world, a recording, emulated wires."""

    stage: StageSection | None = None
    """The linear stage that moves a device along the baseline, if there is one."""

    stages: Annotated[dict[str, StageSection] | None, AfterValidator(_stage_names)] = None
    """Further stages by name, linear or turning, which move what is measured: a turntable, a lift. A plan
    says where they stand. None is called camera, projector, stage or fixture."""

    response: Curve | None = None
    """The measured response, the name of a file that `fpplab gamma` wrote or its `{a, b, g}`: it tells which
    phase error the patterns' harmonics cause. Patterns are corrected by the plan's `response` alone.
    """

    fixture: DeviceSection | None = None
    """The device that holds the measured object, if there is one."""

    geometry: GeometrySection | None = None
    """How well the rig keeps its geometry, as its owner knows it; without, no scan's geometry is verified."""


class Rig:
    """The devices of a rig file, open between `with Rig.load(path) as rig:` and its end.

    simulation: what the devices share (the rig file's `bench`), or None; see `fpplab.devices.simulation`.

    Every device is closed in reverse order, whatever fails; a device that cannot be made
    safe is reported after all the others are closed.
    """

    camera: Camera
    projector: Projector

    def __init__(self, file: RigFile, folder: Path, source: Path | str) -> None:
        self.file, self._folder, self._source = file, folder, source
        self.simulation: SharedBackend | None = None
        self.stage: Stage | None = None
        self.stages: dict[str, Stage] = {}
        self.fixture: Fixture | None = None
        self._stack = ExitStack()

    def __repr__(self) -> str:
        kinds = ("camera", "projector", "stage", "fixture")
        devices = [
            f"{kind} {entry.backend}" for kind in kinds if (entry := getattr(self.file, kind)) is not None
        ]
        return f"<Rig {self._source}: {', '.join(devices)}>"

    @classmethod
    def load(cls, path: Path | str) -> Rig:
        """Read a rig file; its devices are not opened yet.

        Parameters
        ----------
        path : Path or str
            The file, or the name of one that comes with fpplab.

        Returns
        -------
        Rig
            To be opened by `with`.

        Raises
        ------
        ConfigError
            There is no such file, or it is wrong.
        """
        file = config.find_config(path, "rig")
        with naming_other_kinds(file, "rig"):
            data = config.parse_yaml(config.read_text(file), file)
            return cls(config.validate(with_named_response(data, file), RigFile, file), file.parent, file)

    def changed_at(self) -> dict[Path, int]:
        """Tell when files that the rig file names were changed, in ns since 1970."""
        options = self.file.model_dump(mode="json", exclude_none=True).values()
        words = [word for section in options if isinstance(section, dict) for word in section.values()]
        named = (self._folder / word for word in words if isinstance(word, str) and word)
        places = (place for path in named for place in (path, Path(f"{path}.yaml")))
        return {place: place.stat().st_mtime_ns for place in places if place.is_file()}

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(using_rig(self._source))
            for note in self.file.notes or ():
                _log.warning("%s: %s", self._source, note)
            shared = self.simulation = self._open_simulation(stack)
            self.camera = self._device(stack, "camera", Camera, self.file.camera, shared)  # type: ignore[type-abstract]
            self.projector = self._device(stack, "projector", Projector, self.file.projector, shared)  # type: ignore[type-abstract]
            if self.file.stage:
                self.stage = self._open_stage(stack, "stage", self.file.stage, shared)
            for name, section in (self.file.stages or {}).items():
                self.stages[name] = self._open_stage(stack, name, section, shared)
            if self.file.fixture:
                self.fixture = self._device(stack, "fixture", Fixture, self.file.fixture, shared)  # type: ignore[type-abstract]
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with held_back():
            self._stack.close()

    @property
    def source(self) -> str:
        """What messages call the rig: its file."""
        return str(self._source)

    @source.setter
    def source(self, name: Path | str) -> None:
        self._source = name

    def camera_settings(self, exposure_s: float, bits: int | None = None) -> CameraSettings:
        """Give the rig's settings with a plan's exposure and bits; refuses bits that the camera lacks."""
        if bits is not None and bits not in (offered := self.camera.caps.bits):
            listed = ", ".join(map(str, offered))
            raise ConfigError(
                f"plan: 'bits' is {bits}, but {self.camera.name} of {self.file.name} offers {listed}; choose "
                "one of these, or leave 'bits' out for the rig's own"
            )
        return CameraSettings(exposure_s, self.file.camera.gain_db, bits or self.file.camera.bits)

    def make_dark(self) -> None:
        """Blank the projector and stop the camera, unless they are in fault and closing does it."""
        with ExitStack() as both:  # the second also when the first fails
            for device, safe in ((self.camera, self.camera.stop), (self.projector, self.projector.blank)):
                if device.state in (State.IDLE, State.ARMED):
                    both.callback(safe)

    def described(self, mounted: Mounted | None = None) -> dict[str, Any]:
        """Give the rig file's data and, under `resolved`, what the open devices are and what is mounted."""
        caps = self.projector.caps
        resolved: dict[str, Any] = {
            "camera": {"model": self.camera.info().model, "size": list(self.camera.caps.size)},
            "projector": {
                "model": self.projector.info().model,
                "size": list(caps.size),
                "lattice": caps.lattice.value,
            },
        }
        if (bayer := self.camera.caps.bayer) is not None:
            resolved["camera"]["bayer"] = bayer
        if mounted is not None:
            resolved["mounted"] = {"item": mounted[0], "pose": mounted[1]}
        return {**config.plain(self.file), "resolved": resolved}

    def need_fixture(self, doing: str) -> Fixture:
        """Give the fixture; raises `ConfigError` where there is none, with what it is needed for."""
        if self.fixture is None:
            raise ConfigError(f"{self._source}: 'fixture' is missing, and {doing} needs one")
        return self.fixture

    def need_stage(self, mm: float, name: str | None = None) -> Stage:
        """Give the stage, or one of `stages` by name, if it can go to a position; nothing moves."""
        stage = self._stage_for(mm, name)
        stage.check(mm)
        return stage

    def plan_stage_move(self, mm: float) -> StageMove:
        """Describe a move of the stage; nothing moves, and no confirmation is asked for."""
        return self._stage_for(mm).plan_move(mm)

    def _stage_for(self, mm: float, name: str | None = None) -> Stage:
        stage = self.stage if name is None else self.stages.get(name)
        if stage is None and name is not None:
            raise ConfigError(
                f"{self._source}: 'stages.{name}' is missing, and the plan's stages need it at {mm:g}"
            )
        if stage is None:
            raise ConfigError(f"{self._source}: 'stage' is missing, and the plan's stage_mm {mm:g} needs one")
        if name is None and stage.caps.unit != "mm":
            raise ConfigError(
                f"{self._source}: 'stage' turns, and the plan's stage_mm {mm:g} needs one that moves along a "
                "line; name a turntable under 'stages'"
            )
        return stage

    def place_stage(self, mm: float, name: str | None = None) -> None:
        """Bring a stage to a position in mm, a turning one in degrees, homed first where it is not."""
        stage = self.need_stage(mm, name)
        if not stage.homed:
            stage.home()
        stage.move_to(mm)

    def _open_stage(
        self, stack: ExitStack, name: str, section: StageSection, shared: SharedBackend | None
    ) -> Stage:
        stage = self._device(stack, name, Stage, section, shared)  # type: ignore[type-abstract]
        stage.soft_limits_mm = section.soft_limits_mm
        return stage

    def _open_simulation(self, stack: ExitStack) -> SharedBackend | None:
        if self.file.bench is None:
            return None
        backend = load_backend(self.file.bench.backend, self._source, "bench")
        if issubclass(backend, Device) or not issubclass(backend, SharedBackend):
            raise ConfigError(f"{self._source}: 'bench.backend' is '{self.file.bench.backend}': not a bench")
        shared: SharedBackend = self._made(backend, self._options(self.file.bench))
        shared.open()
        stack.callback(shared.close)
        return shared

    def _device(
        self,
        stack: ExitStack,
        name: str,
        kind: type[Dev],
        section: DeviceSection,
        shared: SharedBackend | None,
    ) -> Dev:
        backend = load_backend(section.backend, self._source, name)
        if not issubclass(backend, kind):
            raise ConfigError(f"{self._source}: '{name}.backend' is '{section.backend}': not a {kind.kind}")
        start = time.perf_counter()
        device: Dev = self._made(backend, name, self._options(section), shared)
        stack.enter_context(device)
        _log.info("%s opened: %s, %.3f s", name, section.backend, time.perf_counter() - start)
        return device

    def _made(self, backend: Any, *arguments: Any) -> Any:
        try:
            return backend(*arguments)
        except ConfigError as error:
            raise ConfigError(f"{self._source}: {error}") from error

    def _options(self, section: DeviceSection) -> dict[str, Any]:
        return {
            key: config.resolve_relative_to(value, self._folder) if isinstance(value, str) else value
            for key, value in section.options.items()
        }
