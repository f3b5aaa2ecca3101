"""The parameters of a twin: one table of what can be matched, and where a world document has it.

The world document is all that a twin is; its parameters are the part of it that a matching may change. Each
field of `TwinParameters` states where the world has it, within which bounds it is fitted, and to which effect
it belongs; `TABLE` has this by name. Reading parameters from a world, writing them into one, the record of a
matching and its report all go by that table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from fpplab.calibration.model import Calibration, CalibrationFile, PoseFile
from fpplab.core import config
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.curve import Curve
from fpplab.targets import Target
from sim.effects import EFFECTS, EffectParameters
from sim.items import item_poses
from sim.parameter_entry import FitRange, ParameterEntry, SubstituteNumber, table_entry
from sim.part_surface import PartSurface
from sim.sensor import SensorModel
from sim.world import World
from sim.world.materials.base import with_surface

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@dataclass(frozen=True, eq=False)
class DeviceParameters:
    """Parameters of a twin without effects."""

    calibration: Calibration  # both devices and the pose between them
    poses: tuple[RigidTransform, ...]  # `T_camera_item` of the board
    white: float = field(
        metadata=table_entry(
            "Level above black of a surface that faces the projector, relative to the twin's own file.",
            fit=FitRange(0.01, 0.01, 100.0),
        )
    )
    response: Curve  # of the projector, with a + b = 1, since `white` takes the scale
    ambient: float = field(
        metadata=table_entry(
            "Even ambient light, relative to the projector's white.",
            "ambient",
            FitRange(0.005, 0.0, 10.0, may_be_at_lower_bound=True),
            per_white=True,
        )
    )
    paper: float = field(
        metadata=table_entry("Reflectance of the board's ground.", fit=FitRange(0.01, 0.02, 1.0))
    )
    ink: float = field(
        metadata=table_entry(
            "Reflectance of the board's print.", fit=FitRange(0.005, 0.0, 1.0, may_be_at_lower_bound=True)
        )
    )
    projector_blur: float = field(
        metadata=table_entry(
            "Standard deviation of the projector lens's point spread at its sharpest, in mirrors.",
            "projector.blur",
            FitRange(0.05, 0.35, 20.0, may_be_at_lower_bound=True),
        )
    )
    projector_focus_mm: float | None = field(
        metadata=table_entry(
            "Distance in focus of the projector in mm; None: sharp at every depth.",
            "projector.focus_mm",
            FitRange(2.0, 50.0, 5000.0),
        )
    )
    projector_aperture_mm: float = field(
        metadata=table_entry(
            "Diameter of the projector's aperture in mm.",
            "projector.aperture_mm",
            FitRange(0.5, 0.0, 60.0, may_be_at_lower_bound=True),
        )
    )
    camera_focus_mm: float | None = field(
        metadata=table_entry(
            "Distance in focus of the camera in mm; None: sharp at every depth.",
            "camera.focus_mm",
            FitRange(2.0, 50.0, 5000.0),
        )
    )
    f_number: float = field(
        metadata=table_entry("F-number of the camera's lens.", "camera.f_number", FitRange(0.2, 0.7, 64.0))
    )
    vignetting: float = field(
        metadata=table_entry(
            "Exponent n of the camera's loss of light cosⁿ towards the edge.",
            "camera.vignetting",
            FitRange(0.5, 0.0, 40.0, may_be_at_lower_bound=True),
        )
    )
    black_level: float = field(
        metadata=table_entry(
            "The camera's black level, as a share of full scale.",
            "camera.sensor.black_level",
            FitRange(0.002, 0.0, 0.49, may_be_at_lower_bound=True),
        )
    )
    read_noise_e: float = field(
        metadata=table_entry("Read noise in electrons of the unbinned pixel.", "camera.sensor.read_noise_e")
    )
    full_well_e: float = field(
        metadata=table_entry("Full well in electrons of the unbinned pixel.", "camera.sensor.full_well_e")
    )


@dataclass(frozen=True, eq=False)
class TwinParameters(EffectParameters, DeviceParameters):
    """Everything of a twin that matching may change. A parameter that is None is absent from the world."""

    placed: Mapping[str, RigidTransform] = field(default_factory=dict)  # `T_camera_item` of measured items
    surfaces: Mapping[str, PartSurface] = field(default_factory=dict)  # of items whose surface was matched
    sigma: Mapping[str, float] = field(default_factory=dict)  # standard uncertainties that a fit stated

    def with_effect(self, effect: DataclassInstance, **sigma: float) -> TwinParameters:
        """Replace the parameters of one effect and some standard uncertainties; one of 0 is left out."""
        stated = {
            name: value for name, value in {**self.sigma, **sigma}.items() if value or name not in sigma
        }
        values: dict[str, Any] = {entry.name: getattr(effect, entry.name) for entry in fields(effect)}
        return replace(self, **values, sigma=stated)

    def has(self, entry: ParameterEntry) -> bool:
        return entry.effect is None or bool(np.any(getattr(self, entry.effect)))

    def with_pose(self, index: int, pose: RigidTransform) -> TwinParameters:
        return replace(self, poses=(*self.poses[:index], pose, *self.poses[index + 1 :]))


TABLE: dict[str, ParameterEntry] = {
    entry.name: entry.metadata["parameter"]
    for entry in fields(TwinParameters)
    if "parameter" in entry.metadata
}
"""What is known of every parameter that is a number or a tuple of numbers, by name."""
UNCERTAIN = {
    "g": "projector.response.g",
    **{
        name: entry.path
        for name, entry in TABLE.items()
        if entry.path and not entry.parts and not entry.in_binned_px
    },
}
"""Paths in a world of numbers whose uncertainty holds for every measurement, by name."""


def named_numbers(parameters: TwinParameters) -> dict[str, float | None]:
    alone = {name: getattr(parameters, name) for name, entry in TABLE.items() if not entry.parts}
    tuples = {
        part: value
        for name, known in TABLE.items()
        if known.parts
        for part, value in zip(known.parts, getattr(parameters, name), strict=True)
    }
    return alone | tuples


def normalised_response(curve: Curve, *, black: float | None = None, g: float | None = None) -> Curve:
    """Scale a response so that its white is 1."""
    dark = curve.b / (curve.a + curve.b) if black is None else black
    return Curve(a=1.0 - dark, b=dark, g=curve.g if g is None else g, spline=curve.spline)


@dataclass(frozen=True)
class AdjustableParameter:
    """A number of a twin that can be fitted."""

    fit: FitRange
    read: Callable[[TwinParameters], float]  # gives the value from `TwinParameters`
    set: Callable[[TwinParameters, float], TwinParameters]  # gives `TwinParameters` with another value

    def with_value(self, parameters: TwinParameters, value: float) -> TwinParameters:
        """Set the value, clipped to the range."""
        return self.set(parameters, min(max(value, self.fit.lower), self.fit.upper))


def _number_parameter(name: str, fit: FitRange) -> AdjustableParameter:
    def read(parameters: TwinParameters) -> float:
        return float(getattr(parameters, name))

    def set_(parameters: TwinParameters, value: float) -> TwinParameters:
        changes: dict[str, Any] = {name: value}
        return replace(parameters, **changes)

    return AdjustableParameter(fit, read, set_)


def _tuple_part_parameter(name: str, index: int, fit: FitRange) -> AdjustableParameter:
    def read(parameters: TwinParameters) -> float:
        return float(getattr(parameters, name)[index])

    def set_(parameters: TwinParameters, value: float) -> TwinParameters:
        values = tuple(value if n == index else kept for n, kept in enumerate(getattr(parameters, name)))
        changes: dict[str, Any] = {name: values}
        return replace(parameters, **changes)

    return AdjustableParameter(fit, read, set_)


def _substitute(number: SubstituteNumber) -> AdjustableParameter:
    parameter = _number_parameter(number.parameter, number.fit)
    return AdjustableParameter(
        number.fit,
        lambda p: number.from_parameter(parameter.read(p)),
        lambda p, value: parameter.set(p, number.to_parameter(value)),
    )


ADJUSTABLE: dict[str, AdjustableParameter] = {
    **{
        name: _number_parameter(name, entry.fit)
        for name, entry in TABLE.items()
        if entry.fit and not entry.parts
    },
    **{
        part: _tuple_part_parameter(name, index, entry.fit)
        for name, entry in TABLE.items()
        if entry.fit
        for index, part in enumerate(entry.parts)
    },
    **{name: _substitute(number) for effect in EFFECTS for name, number in effect.adjustable.items()},
    "b": AdjustableParameter(
        FitRange(0.005, 0.0, 0.5),
        lambda p: p.response.b,
        lambda p, value: replace(p, response=normalised_response(p.response, black=value)),
    ),
    "g": AdjustableParameter(
        FitRange(0.01, 0.2, 5.0),
        lambda p: p.response.g,
        lambda p, value: replace(p, response=normalised_response(p.response, g=value)),
    ),
}
"""The numbers that can be fitted, by name; `b` and `g` are those of the response."""


def parameters_of(world: World, board: str, target: Target) -> TwinParameters:
    response = world.projector.response
    brightest = response.a + response.b
    calibration = Calibration(
        world.camera_model(),
        world.projector_model(),
        world.T_projector_camera(),
        rms_px={},
        uncertainty=world.calibration.calibration().uncertainty if world.calibration else None,
    )
    return TwinParameters(
        calibration=calibration,
        poses=item_poses(world, board),
        white=1.0,
        response=Curve(
            a=response.a / brightest, b=response.b / brightest, g=response.g, spline=response.spline
        ),
        paper=target.background,
        ink=target.foreground,
        **_numbers_of(world, brightest),
    )


def _numbers_of(world: World, brightest: float) -> dict[str, Any]:
    """Read the numbers that stand in a world's document; those that it has not keep their default."""
    defaults = {entry.name: entry.default for entry in fields(TwinParameters)}
    numbers: dict[str, Any] = {}
    for name, entry in TABLE.items():
        if entry.path is None:
            continue
        value = _value_at(world, entry.path)
        if value is None and defaults[name] is not MISSING:
            continue
        if entry.per_white:
            value = value / brightest
        if entry.in_binned_px:
            value = value / world.camera.binning
        numbers[name] = value
    return numbers


def _value_at(world: World, path: str) -> Any:
    """Look up what a world has at a path; None where it has no such section."""
    value: Any = world
    for name in path.split("."):
        value = value.get(name) if isinstance(value, Mapping) else getattr(value, name, None)
    return value


def world_of(nominal: World, board: str, parameters: TwinParameters) -> World:
    """Make the nominal world with other parameters; `ConfigError` where no world can have them."""
    p, data = parameters, nominal.model_dump(mode="json") | {"uncertainty": {}}
    data["calibration"] = config.plain(CalibrationFile.of(replace(p.calibration, uncertainty=None)))
    data["items"][board] |= {
        "poses": [config.plain(PoseFile.of(pose)) for pose in p.poses],
        "reflectance": p.paper,
        "ink": p.ink,
    }
    for name, pose in p.placed.items():
        data["items"][name]["pose"] = config.plain(PoseFile.of(pose))
    for name, surface in p.surfaces.items():
        data["items"][name]["material"] = own = f"surface of {name}"
        data["materials"][own] = with_surface(nominal.material_of(name), surface)
    data["projector"]["response"] = config.plain(p.response)
    _write_numbers(data, p, nominal.camera.binning)
    world = config.validate(data, World, "the twin's parameters")
    lit = _with_light(world, p.white * white_level_per_s(nominal) / white_level_per_s(world))
    return lit.model_copy(update={"uncertainty": _uncertainty(lit, p)})


def _write_numbers(data: dict[str, Any], parameters: TwinParameters, binning: int) -> None:
    """Write the numbers that stand in a world's document; a section is left out without its effect."""
    for effect in EFFECTS:
        effect.clear(data)
    for name, entry in TABLE.items():
        path = entry.path
        if path is None or not parameters.has(entry):
            continue
        value = getattr(parameters, name)
        *sections, last = path.split(".")
        section = data
        for part in sections:
            if section.get(part) is None:
                section[part] = {}
            section = section[part]
        section[last] = list(value) if entry.parts else value * binning if entry.in_binned_px else value


def _uncertainty(world: World, parameters: TwinParameters) -> dict[str, float]:
    """Give the standard uncertainties that a fit has stated by the world's own fields."""
    sigma = parameters.sigma
    stated = {UNCERTAIN[name]: value for name, value in sigma.items() if name in UNCERTAIN}
    leds = world.projector.leds if "white" in sigma else {}
    relative = sigma.get("white", 0.0) / parameters.white
    stated |= {f"projector.leds.{name}.lumens": relative * led.lumens for name, led in leds.items()}
    return {path: value for path, value in stated.items() if world.number(path) is not None}


def white_level_per_s(world: World) -> float:
    """Compute the level above black of a white surface under the projector's white, per second at 0 dB."""
    sensor, response = SensorModel.of(world), world.projector.response
    return (response.a + response.b) * sensor.gain(CameraSettings(1.0)) * sensor.electrons(1.0, 1.0)


def _with_light(world: World, factor: float) -> World:
    leds = {
        name: led.model_copy(update={"lumens": factor * led.lumens})
        for name, led in world.projector.leds.items()
    }
    return world.model_copy(update={"projector": world.projector.model_copy(update={"leds": leds})})
