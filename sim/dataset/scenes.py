"""Draws random scenes: item, pose, surface, light and camera noise.

A scene follows from the ranges, the seed and its index alone, independent of process and order.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from fpplab import artefacts
from fpplab.artefacts import Lengths
from fpplab.calibration.model import Calibration, PoseFile
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import RigidTransform
from fpplab.targets import Target
from sim.studio import DatasetScene

MAX_TRIES = 2000  # random poses, or sizes, that are tried before giving up (chosen)

Interval = tuple[float, float]  # least and greatest value


def _within(low: float, high: float) -> AfterValidator:
    def check(ends: Interval) -> Interval:
        if not low <= ends[0] <= ends[1] <= high:
            raise ValueError(f"must be the minimum and the maximum, within {low:g} to {high:g}")
        return ends

    return AfterValidator(check)


Shares = Annotated[Interval, _within(0.0, 1.0)]  # interval within 0 to 1


class SceneRanges(Document):
    """What scenes are drawn from; an interval is [minimum, maximum], drawn from uniformly.

    Artefacts and targets are all equally likely.
    """

    artefacts: tuple[str, ...]
    """Artefacts, by name."""
    targets: tuple[str, ...]
    """Calibration boards, by file."""
    variation: Annotated[float, Field(ge=0, lt=1)]
    """Greatest deviation of each length of an artefact from its usual one, as a share."""
    distance_mm: Annotated[Interval, _within(1.0, 1e5)]
    """Depth of the item's origin in the camera's frame in mm."""
    off_centre: Annotated[float, Field(ge=0, le=1)]
    """Greatest distance of the item from the image centre, as a share of the distance to the edge."""
    tilt_deg: Annotated[float, Field(ge=0, le=80)]
    """Greatest tilt away from the camera in degrees."""
    turn_deg: Annotated[float, Field(ge=0, le=180)]
    """Greatest rotation about the line of sight in degrees, to both sides."""
    reflectance: Shares
    """Reflectance of an artefact's paint, as of a world's glossy material, or of a board's paper."""
    ink: Shares
    """Reflectance of a board's print."""
    roughness: Shares
    """Roughness of an artefact's paint."""
    gloss: Shares
    """Share of the specular reflection of an artefact's paint."""
    gloss_roughness: Annotated[Interval, _within(0.02, 1.0)]
    """Roughness of the specular reflection of an artefact's paint."""
    ambient: Annotated[Interval, _within(0.0, 10.0)]
    """Ambient light relative to the projector's white."""
    charge: Annotated[Interval, _within(1e-3, 1.0)]
    """Electrons for the same grey level, relative to the rig's sensor; drawn uniformly in the logarithm.

    Relative shot noise is proportional to the inverse of its square root.
    """
    read_noise_e: Annotated[Interval, _within(0.0, 1e4)]
    """Read noise in electrons."""
    exposure_s: Annotated[Interval, _within(1e-6, 60.0)]
    """Exposure of every image in seconds."""
    projector_blur: Annotated[Interval, _within(0.4, 20.0)]
    """Blur of the projector in micromirrors."""
    projector_focus_mm: Annotated[Interval, _within(1.0, 1e5)]
    """Depth in mm at which the projector is in focus."""
    stage_mm: Annotated[Interval, _within(-1e4, 1e4)]
    """Position of the stage in mm."""
    licence: Annotated[str, Field(min_length=1)]
    """Licence of the data, as granted by whoever makes them."""

    @model_validator(mode="after")
    def _items_given(self) -> SceneRanges:
        if not self.artefacts and not self.targets:
            raise ValueError("'artefacts' and 'targets' are both empty: name at least one item")
        if self.targets and self.ink[1] >= self.reflectance[0]:
            raise ValueError(
                f"'ink' reaches {self.ink[1]:g}: must stay below 'reflectance', which begins at "
                f"{self.reflectance[0]:g}, or the print of a board is invisible"
            )
        return self

    @classmethod
    def load(cls, path: Path | str) -> SceneRanges:
        file = config.find_config(path, "dataset")
        scenes = config.load_document(file, cls, "dataset")
        for name in scenes.artefacts:
            artefacts.make(name)
        targets = tuple(_target_file(name, file.parent) for name in scenes.targets)
        for name in targets:
            Target.load(name)
        return scenes.model_copy(update={"targets": targets})


def _target_file(name: str, folder: Path) -> str:
    """Find a board in `folder` or among those that come with fpplab."""
    # The latter keep their bare names, by which they are found wherever the data set is copied.
    near = config.resolve_relative_to(name, folder)
    try:
        shipped = config.find_config(Path(name).name)
    except ConfigError:
        return near
    return shipped.name if Path(near).exists() and shipped.samefile(near) else near


_DRAWN_UNIFORMLY = (
    "reflectance", "ink", "roughness", "gloss", "gloss_roughness", "ambient", "read_noise_e", "exposure_s",
    "projector_blur", "projector_focus_mm",
)  # fmt: skip
"""Numbers that are drawn uniformly from the interval of the same name."""


def draw_scene(
    scenes: SceneRanges, seed: int, index: int, devices: Calibration, stage_mm: float
) -> DatasetScene:
    random = _random(seed, index, _SCENE)
    items = (*scenes.artefacts, *scenes.targets)
    item = items[int(random.integers(len(items)))]
    if item in scenes.artefacts:
        sizes = _draw_lengths(item, scenes.variation, random)
        what = {"artefact": item, "sizes": sizes}
        box = _grid_in_box(np.asarray(artefacts.make(item, sizes).bounds))
    else:
        what = {"target": item}
        half = 0.5 * np.array([*_board_size(item), 0.0])
        box = _grid_in_box(np.stack([-half, half]))
    return DatasetScene.model_validate(
        {
            **what,
            **{name: float(random.uniform(*getattr(scenes, name))) for name in _DRAWN_UNIFORMLY},
            "charge": float(np.exp(random.uniform(*np.log(scenes.charge)))),
            "pose": _draw_pose(scenes, box, "artefact" in what, devices, random),
            "seed": int(random.integers(2**31)),
            "stage_mm": stage_mm,
        }
    )


_SCENE, _STAGE = range(2)


def draw_stage(scenes: SceneRanges, seed: int, index: int) -> float:
    return float(_random(seed, index, _STAGE).uniform(*scenes.stage_mm))


def _random(seed: int, index: int, what: int) -> np.random.Generator:
    return np.random.default_rng([seed, index, what])


def _draw_lengths(name: str, variation: float, random: np.random.Generator) -> dict[str, Lengths]:
    """Draw lengths around the usual ones until they make a valid solid."""
    usual = artefacts.usual_sizes(name)
    for _ in range(MAX_TRIES):
        sizes = {field: _scale_lengths(length, variation, random) for field, length in usual.items()}
        try:
            artefacts.make(name, sizes)
        except ConfigError:
            continue
        return sizes
    raise ConfigError(
        f"'variation' is {variation:g}: hardly any '{name}' with such lengths is a valid solid; lower it"
    )


def _scale_lengths(lengths: Lengths, variation: float, random: np.random.Generator) -> Lengths:
    factors = 1.0 + variation * random.uniform(-1, 1, np.shape(lengths))
    scaled = (np.asarray(lengths) * factors).tolist()
    return tuple(scaled) if isinstance(scaled, list) else float(scaled)


@lru_cache(maxsize=16)
def _board_size(target: str) -> tuple[float, float]:
    return Target.load(target).size_mm


def _grid_in_box(corners: Floats) -> Floats:
    """Make a regular grid of points (27, 3) in and on the box between two corners (2, 3)."""
    low, high = corners
    share = np.linspace(0, 1, 3)
    grid = np.stack(np.meshgrid(share, share, share), axis=-1).reshape(-1, 3)
    return np.asarray(low + grid * (high - low))


def _draw_pose(
    scenes: SceneRanges, box: Floats, upright: bool, devices: Calibration, random: np.random.Generator
) -> PoseFile:
    """Draw T_camera_item with half of the item's box in view. upright: its z axis points to the camera."""
    for _ in range(MAX_TRIES):
        pose = _random_pose(scenes, upright, devices, random)
        points = pose.apply(box)
        visible = devices.camera.sees(points) & devices.projector.sees(points, devices.T_projector_camera)
        if visible.mean() >= 0.5:
            return PoseFile.of(pose)
    raise ConfigError(
        f"'distance_mm' is {list(scenes.distance_mm)}: hardly any item lies there in the camera's image and "
        "the projector's light; change it, or lower 'off_centre' or 'tilt_deg'"
    )


def _random_pose(
    scenes: SceneRanges, upright: bool, devices: Calibration, random: np.random.Generator
) -> RigidTransform:
    middle = 0.5 * (np.array(devices.camera.size) - 1)
    pixel = middle * (1 + scenes.off_centre * random.uniform(-1, 1, 2))
    depth = random.uniform(*scenes.distance_mm)
    place = depth * np.append(devices.camera.normalise(pixel), 1.0)
    direction = random.uniform(0, 2 * np.pi)
    tilt = np.radians(scenes.tilt_deg) * np.sqrt(random.uniform())  # uniform over a disc of directions
    tilted = _turned(tilt * np.cos(direction), tilt * np.sin(direction), 0.0)
    turned = _turned(0.0, 0.0, np.radians(scenes.turn_deg) * random.uniform(-1, 1))
    facing = _turned(np.pi if upright else 0.0, 0.0, 0.0)
    return RigidTransform((tilted @ turned @ facing).rotation, place)


def _turned(x: float, y: float, z: float) -> RigidTransform:
    return RigidTransform.from_vectors(np.array([x, y, z]), np.zeros(3))
