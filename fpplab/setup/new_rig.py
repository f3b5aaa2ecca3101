"""Write a rig file from what is connected: choose each device, open it, and test it."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fpplab.core import config
from fpplab.core.conventions import Image, full_scale
from fpplab.core.errors import ConfigError, DeviceError, FppError
from fpplab.devices import Camera, CameraSettings, Device, Projector, Stage
from fpplab.devices.backends import load_backend
from fpplab.devices.discovery import FoundDevice, FoundDevices
from fpplab.devices.rig import RigFile
from fpplab.patterns.fringes import uniform_patterns
from fpplab.setup.rig_check.marker_check import LIMITS as MARKER_LIMITS

Chosen = TypeVar("Chosen", bound=Device)
Ask = Callable[[str, Sequence[str]], int]
"""Asks a question with several answers, and returns the index of the chosen one."""

NONE = "none"  # name of no device
OPERATOR = {"backend": "fpplab.devices.operator:Operator"}  # the fixture that asks a person


@dataclass(frozen=True)
class NewRigLimits:
    """How devices are tried; all chosen."""

    first_exposure_s: float = 0.033  # whole refreshes of 60 Hz, and nearly of 30
    max_saturated: float = 0.01  # share of saturated pixels of a good exposure
    min_brightness: float = 0.2  # of its brightest pixels, as a share of full scale
    settle_s: float = 0.5  # after which every projector shows its pattern


LIMITS = NewRigLimits()


@dataclass(frozen=True)
class CameraTest:
    """What a camera sees, as shares of full scale."""

    exposure_s: float  # exposure of the picture in s
    mean: float  # of the pixels
    least: float  # 0.1st percentile
    most: float  # 99.9th percentile
    saturated: float  # share of the pixels at full scale


@dataclass(frozen=True)
class ProjectorTest:
    """What the camera sees of the projector's black and white, as shares of full scale."""

    exposure_s: float  # exposure in s with which white is well exposed
    black: float  # mean level of the pixels that the projector illuminates
    white: float  # mean level of the pixels that the projector illuminates
    lit: float  # share of the picture that it illuminates


@dataclass(frozen=True)
class StageTest:
    """The stage."""

    homed: bool  # whether it was homed
    travel_mm: tuple[float, float]  # its travel in mm


@dataclass(frozen=True)
class RigDraft:
    """A rig whose devices have passed."""

    sections: dict[str, dict[str, Any]] = field(default_factory=dict)  # of the rig file, by kind of device
    tests: dict[str, CameraTest | ProjectorTest | StageTest] = field(default_factory=dict)

    def text(self, name: str) -> str:
        written = config.to_yaml({"name": name, **self.sections})
        config.validate(config.parse_yaml(written, "rig"), RigFile, "rig")
        return f"# Written by `fpplab rig new`; docs/hardware.md has every option.\n{written}"

    def summary(self) -> dict[str, Any]:
        return {kind: asdict(test) for kind, test in self.tests.items()}


class RigSetup:
    """Chooses and tests the devices of a rig, one kind after another."""

    def __init__(
        self,
        discovered: FoundDevices,
        names: Mapping[str, str],
        folder: Path,
        ask: Ask | None,
        tell: Callable[[str], None],
    ) -> None:
        self._discovered, self._names, self._folder = discovered, dict(names), folder
        self._ask, self._tell = ask, tell

    def choose_and_test_devices(self, home_stage: bool, operator_as_fixture: bool) -> RigDraft:
        draft = RigDraft()
        with ExitStack() as stack:
            camera = self._device(stack, draft, "camera", Camera, look_at_scene)  # type: ignore[type-abstract]
            if camera is None:
                raise self._no_device_error("camera")
            lit = self._device(stack, draft, "projector", Projector, lambda p: look_at_light(camera, p))  # type: ignore[type-abstract]
            if lit is None:
                raise self._no_device_error("projector")
            self._device(stack, draft, "stage", Stage, lambda stage: self._test_stage(stage, home_stage))  # type: ignore[type-abstract]
        if operator_as_fixture:
            draft.sections["fixture"] = dict(OPERATOR)
        return draft

    def _device(
        self, stack: ExitStack, draft: RigDraft, kind: str, base: type[Chosen], test: Callable[[Chosen], Any]
    ) -> Chosen | None:
        while (chosen := self._choose_device(kind)) is not None:
            try:
                with ExitStack() as attempt:
                    self._tell(f"{kind}: {chosen.title}")
                    device: Chosen = self._open_chosen(chosen, kind, base)
                    attempt.enter_context(device)
                    draft.tests[kind] = test(device)
                    stack.push(attempt.pop_all())
            except FppError as error:
                if self._ask is None:
                    raise
                self._tell(str(error))
                if self._ask(f"The {kind} did not pass", ["try again, or another one", "stop"]) == 1:
                    raise
                self._names.pop(kind, None)
                continue
            draft.sections[kind] = dict(chosen.section)
            self._tell(f"{kind} passed: {_description(draft.tests[kind])}")
            return device
        return None

    def _choose_device(self, kind: str) -> FoundDevice | None:
        named = self._names.get(kind)
        if named == NONE:
            return None
        all_of_kind = [d for d in self._discovered.devices if d.kind == kind and d.section]
        if named is not None:
            return _require_one_device(
                [d for d in all_of_kind if d.is_called(named)], all_of_kind, kind, named
            )
        if self._ask is None:
            certain = [d for d in all_of_kind if d.is_certain]
            return _require_one_device(certain, all_of_kind, kind, None) if certain else None
        if not all_of_kind:
            return None
        answers = [d.title for d in all_of_kind] + ([NONE] if kind == "stage" else [])
        k = self._ask(f"Which {kind}?", answers)
        return all_of_kind[k] if k < len(all_of_kind) else None

    def _open_chosen(self, chosen: FoundDevice, kind: str, base: type[Chosen]) -> Chosen:
        options = dict(chosen.section)
        name = options.pop("backend")
        backend = load_backend(name, "rig", kind)
        if not issubclass(backend, base):
            raise ConfigError(f"rig: '{kind}.backend' is '{name}': not a {kind}")
        for key, value in options.items():
            if isinstance(value, str):
                options[key] = config.resolve_relative_to(value, self._folder)
        device: Chosen = backend(kind, options, None)
        return device

    def _test_stage(self, stage: Stage, home: bool) -> StageTest:
        if not home and self._ask is not None:
            home = self._ask("Home the stage? Its carriage moves", ["no", "yes"]) == 1
        if home:
            stage.home()
        return StageTest(stage.homed, stage.caps.travel_mm)

    def _no_device_error(self, kind: str) -> DeviceError:
        hints = [sentence for sentence in self._discovered.missing if kind in sentence]
        others = [d.title for d in self._discovered.devices if d.kind == kind]
        evidence = f"none is connected{'; ' + hints[0] if hints else ''}"
        if others:
            evidence = f"none is certain to be one; there are {', '.join(others)}"
        remedy = f"name one with --{kind}" if others else "check power and cable, and run `fpplab devices`"
        return DeviceError(kind, "choose", evidence, remedy)


def _require_one_device(
    chosen: list[FoundDevice], all_of_kind: list[FoundDevice], kind: str, named: str | None
) -> FoundDevice:
    if len(chosen) == 1:
        return chosen[0]
    listed = ", ".join(d.title for d in all_of_kind) or "none"
    if named is None:
        raise ConfigError(f"there are several of kind {kind}; name one with --{kind}: {listed}")
    count = "no" if not chosen else "more than one"
    raise ConfigError(f"--{kind} is '{named}': {count} {kind} has this name; there are {listed}")


def look_at_scene(camera: Camera) -> CameraTest:
    settings, image = _well_exposed(camera)
    full = full_scale(settings.bits)
    darkest, brightest = (float(v) / full for v in np.quantile(image, (0.001, 0.999)))
    if image.min() == image.max():
        raise DeviceError(
            camera.name,
            "look",
            f"all pixels are {int(image.min())}, without any noise",
            "switch off test images, and check the lens cap",
        )
    mean, saturated = float(image.mean()) / full, float((image >= full).mean())
    return CameraTest(settings.exposure_s, mean, darkest, brightest, saturated)


def look_at_light(camera: Camera, projector: Projector) -> ProjectorTest:
    projector.load(uniform_patterns([255, 0], projector.caps.size))
    projector.show(0)
    time.sleep(LIMITS.settle_s)
    settings, white = _well_exposed(camera)
    projector.show(1)
    time.sleep(LIMITS.settle_s)
    black = camera.snap(settings.exposure_s + 10.0).image
    projector.blank()
    full = full_scale(settings.bits)
    change = (white.astype(np.float64) - black) / full
    lit = change >= 0.5 * np.quantile(change, 0.99)
    rise = float(change[lit].mean())
    if not rise >= MARKER_LIMITS.min_rise:
        raise DeviceError(
            projector.name,
            "look",
            f"the camera sees white brighter than black by {100 * rise:.2g} % of full scale, less than "
            f"{100 * MARKER_LIMITS.min_rise:g} %",
            "check lens caps, the projector's light, and that camera and projector look at the same bright "
            "surface",
        )
    return ProjectorTest(
        settings.exposure_s,
        float(black[lit].mean()) / full,
        float(white[lit].mean()) / full,
        float(lit.mean()),
    )


def _well_exposed(camera: Camera) -> tuple[CameraSettings, Image]:
    shortest_s, longest_s = camera.caps.exposure_s
    bits = min(camera.caps.bits)
    exposure_s, tried = min(max(LIMITS.first_exposure_s, shortest_s), longest_s), set[float]()
    while True:
        gain_db = min(max(0.0, camera.caps.gain_db[0]), camera.caps.gain_db[1])
        settings = camera.configure(CameraSettings(exposure_s, gain_db, bits))
        image = camera.snap(exposure_s + 10.0).image
        tried.add(exposure_s)
        full = full_scale(bits)
        if float((image >= full).mean()) > LIMITS.max_saturated:
            next_s = max(exposure_s / 2, shortest_s)
        elif float(np.quantile(image, 0.99)) < LIMITS.min_brightness * full:
            next_s = min(exposure_s * 2, longest_s, 0.5)
        else:
            return settings, image
        if next_s in tried:
            return settings, image
        exposure_s = next_s


def _description(test: CameraTest | ProjectorTest | StageTest) -> str:
    match test:
        case CameraTest():
            return (
                f"mean {100 * test.mean:.1f} % of full scale, from {100 * test.least:.1f} to "
                f"{100 * test.most:.1f} %, at {1e3 * test.exposure_s:.3g} ms"
            )
        case ProjectorTest():
            return (
                f"black {100 * test.black:.1f} %, white {100 * test.white:.1f} % of full scale on "
                f"{100 * test.lit:.0f} % of the picture, at {1e3 * test.exposure_s:.3g} ms"
            )
        case StageTest():
            state = "homed" if test.homed else "not homed yet"
            return "{}, travel {:g} to {:g} mm".format(state, *test.travel_mm)
