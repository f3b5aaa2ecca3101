"""The parameters of a twin and the world that has them: what can be matched, as fields of a world file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fpplab.calibration.model import Calibration, CalibrationFile, PoseFile
from fpplab.core import config
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.curve import Curve
from fpplab.targets import Target
from sim.items import item_poses
from sim.part_surface import PartSurface
from sim.sensor import SensorModel
from sim.world import RoomLamp, World
from sim.world.surface import with_surface

NO_LINE = (0.0, 0.0, 0.0)
"""Of a vibration that has no direction."""
NO_FALLOFF = (0.0, 0.0, 0.0, 0.0, 0.0)
"""Of a projector whose light is even."""


@dataclass(frozen=True, eq=False)
class TwinParameters:
    """Everything of a twin that matching may change. A parameter that is None is absent from the world."""

    calibration: Calibration  # both devices and the pose between them
    poses: tuple[RigidTransform, ...]  # `T_camera_item` of the board
    white: float  # level above black of a surface that faces the lamp at its distance
    response: Curve  # of the projector, with a + b = 1, since `white` takes the scale
    ambient: float  # even ambient light, relative to the projector's white
    paper: float  # reflectances of the board's ground and print
    ink: float  # reflectances of the board's ground and print
    projector_blur: float  # standard deviation of the projector lens's point spread at its sharpest
    projector_focus_mm: float | None  # distance in focus of the projector, as in a world file
    projector_aperture_mm: float  # diameter of the projector's aperture, as in a world file
    camera_focus_mm: float | None  # distance in focus of the camera; None: sharp at every depth
    f_number: float  # of the camera's lens
    vignetting: float  # exponent n of the camera's loss of light cosⁿ towards the edge
    black_level: float  # share of full scale
    read_noise_e: float  # electrons of the unbinned pixel
    full_well_e: float  # electrons of the unbinned pixel
    vibration_mm: float  # standard deviation of the item's position from frame to frame
    vibration_line_mm: tuple[float, float, float] = NO_LINE
    vibration_periodic: float = 0.0  # share of its variance that has one frequency
    vibration_cycles_per_frame: float = 0.0  # that frequency, as frames at regular intervals sample it
    projector_falloff: tuple[float, float, float, float, float] = NO_FALLOFF  # coefficients of x
    projector_flicker: float = 0.0  # standard deviation of the projector's light from frame to frame
    lamp_irradiance: float = 0.0  # light of the room's lamp on a surface that faces it
    lamp_angle_deg: float = 45.0  # place of the lamp from that point
    lamp_azimuth_deg: float = -90.0  # place of the lamp from that point
    lamp_distance_mm: float = 2000.0  # place of the lamp from that point
    ambient_ripple: float = 0.0  # amplitude of the rolling bands of ambient light and lamp, as a share of it
    band_period_px: float = 0.0  # from band to band, in rows of the frame; 0 where there are none
    band_advance: float | None = None  # share of a period by which they move from frame to frame
    placed: Mapping[str, RigidTransform] = field(default_factory=dict)
    surfaces: Mapping[str, PartSurface] = field(default_factory=dict)  # of items whose surface was matched
    sigma: Mapping[str, float] = field(default_factory=dict)  # standard uncertainties that a fit stated

    @property
    def displacement_mm(self) -> float:
        """RMS displacement of the item along an axis by all of its vibration."""
        return float(np.sqrt(self.vibration_mm**2 + np.mean(np.square(self.vibration_line_mm))))

    def sigma_with(self, **known: float) -> dict[str, float]:
        """Give the standard uncertainties with some replaced."""
        return {name: value for name, value in {**self.sigma, **known}.items() if value or name not in known}

    def with_pose(self, index: int, pose: RigidTransform) -> TwinParameters:
        """Replace one of the poses."""
        return replace(self, poses=(*self.poses[:index], pose, *self.poses[index + 1 :]))


NO_LAMP = RoomLamp(irradiance=0.0)
LAMP = "room"
"""Name of the lamp that can be matched."""
FIELDS = {
    "projector_blur": "projector.blur",
    "projector_focus_mm": "projector.focus_mm",
    "projector_aperture_mm": "projector.aperture_mm",
    "projector_flicker": "projector.flicker",
    "g": "projector.response.g",
    "camera_focus_mm": "camera.focus_mm",
    "f_number": "camera.f_number",
    "vignetting": "camera.vignetting",
    "black_level": "camera.sensor.black_level",
    "read_noise_e": "camera.sensor.read_noise_e",
    "full_well_e": "camera.sensor.full_well_e",
    "ambient": "ambient",
    "lamp_irradiance": f"lamps.{LAMP}.irradiance",
    "lamp_angle_deg": f"lamps.{LAMP}.angle_deg",
    "lamp_azimuth_deg": f"lamps.{LAMP}.azimuth_deg",
    "ambient_ripple": "ambient_bands.ripple",
    "vibration_mm": "vibration_mm",
    "vibration_cycles_per_frame": "vibration_line.cycles_per_frame",
}
"""Paths in a world of parameters whose uncertainty holds for every measurement, by name."""


def parameters_of(world: World, board: str, target: Target) -> TwinParameters:
    """Read the parameters that can be matched from a world."""
    camera, projector, response = world.camera, world.projector, world.projector.response
    line = world.vibration_line
    brightest, lamp = response.a + response.b, world.lamps.get(LAMP, NO_LAMP)
    return TwinParameters(
        calibration=Calibration(
            *(world.camera_model(), world.projector_model(), world.T_projector_camera()),
            rms_px={},
            uncertainty=world.calibration.calibration().uncertainty if world.calibration else None,
        ),
        poses=item_poses(world, board),
        white=1.0,
        response=response.curve().model_copy(
            update={"a": response.a / brightest, "b": response.b / brightest}
        ),
        ambient=world.ambient / brightest,
        paper=target.background,
        ink=target.foreground,
        projector_blur=projector.blur,
        projector_focus_mm=projector.focus_mm,
        projector_aperture_mm=projector.aperture_mm,
        camera_focus_mm=camera.focus_mm,
        f_number=camera.f_number,
        vignetting=camera.vignetting,
        black_level=camera.sensor.black_level,
        read_noise_e=camera.sensor.read_noise_e,
        full_well_e=camera.sensor.full_well_e,
        vibration_mm=world.vibration_mm,
        vibration_line_mm=line.rms_mm if line else NO_LINE,
        vibration_periodic=line.periodic if line else 0.0,
        vibration_cycles_per_frame=line.cycles_per_frame if line else 0.0,
        projector_falloff=projector.falloff,
        projector_flicker=projector.flicker,
        lamp_irradiance=lamp.irradiance / brightest,
        lamp_angle_deg=lamp.angle_deg,
        lamp_azimuth_deg=lamp.azimuth_deg,
        lamp_distance_mm=lamp.distance_mm,
        ambient_ripple=world.ambient_bands.ripple if world.ambient_bands else 0.0,
        band_period_px=world.ambient_bands.period_px / camera.binning if world.ambient_bands else 0.0,
        band_advance=world.ambient_bands.cycles_per_frame if world.ambient_bands else None,
    )


def world_of(nominal: World, board: str, parameters: TwinParameters) -> World:
    """Make the nominal world with other parameters."""
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
    data["projector"] |= {
        "response": config.plain(p.response),
        "blur": p.projector_blur,
        "focus_mm": p.projector_focus_mm,
        "aperture_mm": p.projector_aperture_mm,
        "falloff": list(p.projector_falloff),
        "flicker": p.projector_flicker,
    }
    data["camera"] |= {
        "focus_mm": p.camera_focus_mm,
        "f_number": p.f_number,
        "vignetting": p.vignetting,
    }
    data["camera"]["sensor"] |= {
        "black_level": p.black_level,
        "read_noise_e": p.read_noise_e,
        "full_well_e": p.full_well_e,
    }
    if p.lamp_irradiance:
        data["lamps"][LAMP] = {
            "irradiance": p.lamp_irradiance,
            "angle_deg": p.lamp_angle_deg,
            "azimuth_deg": p.lamp_azimuth_deg,
            "distance_mm": p.lamp_distance_mm,
        }
    else:
        data["lamps"].pop(LAMP, None)
    if p.ambient_ripple:
        data["ambient_bands"] = {
            "ripple": p.ambient_ripple,
            "period_px": p.band_period_px * nominal.camera.binning,
            "cycles_per_frame": p.band_advance,
        }
    data |= {"ambient": p.ambient, "vibration_mm": p.vibration_mm, "vibration_line": None}
    if any(p.vibration_line_mm):
        data["vibration_line"] = {
            "rms_mm": list(p.vibration_line_mm),
            "periodic": p.vibration_periodic,
            "cycles_per_frame": p.vibration_cycles_per_frame,
        }
    world = config.validate(data, World, "the twin's parameters")
    lit = _with_light(world, p.white * white_level_per_s(nominal) / white_level_per_s(world))
    return lit.model_copy(update={"uncertainty": _uncertainty(lit, p)})


def _uncertainty(world: World, parameters: TwinParameters) -> dict[str, float]:
    """Give the standard uncertainties that a fit has stated by the world's own fields."""
    sigma = parameters.sigma
    known = {FIELDS[name]: value for name, value in sigma.items() if name in FIELDS}
    leds = world.projector.leds if "white" in sigma else {}
    relative = sigma.get("white", 0.0) / parameters.white
    known |= {f"projector.leds.{name}.lumens": relative * led.lumens for name, led in leds.items()}
    return {path: value for path, value in known.items() if world.number(path) is not None}


def white_level_per_s(world: World) -> float:
    """Compute the level above black of a white surface under the projector's white, per second at 0 dB."""
    sensor, response = SensorModel.of(world), world.projector.response
    return (response.a + response.b) * sensor.gain(CameraSettings(1.0)) * sensor.electrons(1.0, 1.0)


def _with_light(world: World, factor: float) -> World:
    """Make the same world with `factor` times the light."""
    leds = {
        name: led.model_copy(update={"lumens": factor * led.lumens})
        for name, led in world.projector.leds.items()
    }
    return world.model_copy(update={"projector": world.projector.model_copy(update={"leds": leds})})
