"""Random scenes: what stands before the devices, of what, where, and in what light.

A scene follows from the ranges, the seed and its index alone, whoever draws it and in what order.
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
from fpplab.simulation.scene import DatasetScene
from fpplab.targets import Target

TRIES = 2000
LEAST_IN_VIEW = 0.5
"""So much of an item's box must lie in the camera's image and in the projector's, shadows aside."""

Ends = tuple[float, float]


def _within(low: float, high: float) -> AfterValidator:
    def check(ends: Ends) -> Ends:
        if not low <= ends[0] <= ends[1] <= high:
            raise ValueError(f"must be the least and the greatest, within {low:g} to {high:g}")
        return ends

    return AfterValidator(check)


Shares = Annotated[Ends, _within(0.0, 1.0)]


class Scenes(Document):
    """What scenes are drawn from; a range is [least, greatest], drawn from evenly.

    artefacts: by name; targets: boards, by file. Each is as likely as any other. variation: how far each
    length of an artefact may be off its usual one, as a share.
    distance_mm: depth of the item's origin. off_centre: how far from the middle of the image it may be seen,
    as a share of the way to the edge. tilt_deg, turn_deg: the most that it is turned away from the camera,
    and about the line of sight.
    reflectance, roughness, gloss, gloss_roughness: of an artefact's paint, as a world's glossy material;
    for a board reflectance is its paper's, and ink its print's. ambient: relative to the projector's white.
    charge: electrons for the same grey level, relative to the rig's sensor, drawn evenly in its logarithm:
    shot noise grows as its root falls. read_noise_e: electrons.
    projector_blur: in mirrors. projector_focus_mm: the depth that the projector has sharp.
    stage_mm: where the stage stands.
    licence: of the data, as whoever makes them grants it.
    """

    artefacts: tuple[str, ...]
    targets: tuple[str, ...]
    variation: Annotated[float, Field(ge=0, lt=1)]
    distance_mm: Annotated[Ends, _within(1.0, 1e5)]
    off_centre: Annotated[float, Field(ge=0, le=1)]
    tilt_deg: Annotated[float, Field(ge=0, le=80)]
    turn_deg: Annotated[float, Field(ge=0, le=180)]
    reflectance: Shares
    ink: Shares
    roughness: Shares
    gloss: Shares
    gloss_roughness: Annotated[Ends, _within(0.02, 1.0)]
    ambient: Annotated[Ends, _within(0.0, 10.0)]
    charge: Annotated[Ends, _within(1e-3, 1.0)]
    read_noise_e: Annotated[Ends, _within(0.0, 1e4)]
    exposure_s: Annotated[Ends, _within(1e-6, 60.0)]
    projector_blur: Annotated[Ends, _within(0.4, 20.0)]
    projector_focus_mm: Annotated[Ends, _within(1.0, 1e5)]
    stage_mm: Annotated[Ends, _within(-1e4, 1e4)]
    licence: Annotated[str, Field(min_length=1)]

    @model_validator(mode="after")
    def _there_is_something(self) -> Scenes:
        if not self.artefacts and not self.targets:
            raise ValueError("'artefacts' and 'targets' are both empty: name at least one item")
        if self.targets and self.ink[1] >= self.reflectance[0]:
            raise ValueError(
                f"'ink' reaches {self.ink[1]:g}: must stay below 'reflectance', which begins at "
                f"{self.reflectance[0]:g}, or nothing shows on a board"
            )
        return self

    @classmethod
    def load(cls, path: Path | str) -> Scenes:
        """Read a file of ranges, by path or by the name of one that comes with fpplab.

        Boards are looked for beside it first. Raises `ConfigError`, also for items that are not there.
        """
        found = config.find_config(path)
        scenes = config.load_document(found, cls)
        for name in scenes.artefacts:
            artefacts.make(name)
        targets = tuple(_target(name, found.parent) for name in scenes.targets)
        for name in targets:
            Target.load(name)
        return scenes.model_copy(update={"targets": targets})


def _target(name: str, folder: Path) -> str:
    """The file of that name in `folder`, if it is there; but one that comes with fpplab keeps its bare name,
    by which it is found wherever the data set is taken.
    """
    near = config.resolve_beside(name, folder)
    try:
        shipped = config.find_config(Path(name).name)
    except ConfigError:
        return near
    return shipped.name if Path(near).exists() and shipped.samefile(near) else near


_DRAWN = (
    "reflectance", "ink", "roughness", "gloss", "gloss_roughness", "ambient", "read_noise_e", "exposure_s",
    "projector_blur", "projector_focus_mm",
)  # fmt: skip
"""Numbers that are drawn evenly from the range of the same name."""


def draw(scenes: Scenes, seed: int, index: int, devices: Calibration, stage_mm: float) -> DatasetScene:
    """Scene `index` of a data set.

    devices: where they stand with the stage at `stage_mm`, see `draw_stage`.
    Raises `ConfigError` when hardly any pose lies in view and light.
    """
    random = _random(seed, index, _SCENE)
    items = (*scenes.artefacts, *scenes.targets)
    item = items[int(random.integers(len(items)))]
    if item in scenes.artefacts:
        sizes = _varied(item, scenes.variation, random)
        what = {"artefact": item, "sizes": sizes}
        box = _box(np.asarray(artefacts.make(item, sizes).bounds))
    else:
        what = {"target": item}
        half = 0.5 * np.array([*_board_size(item), 0.0])
        box = _box(np.stack([-half, half]))
    return DatasetScene.model_validate(
        {
            **what,
            **{name: float(random.uniform(*getattr(scenes, name))) for name in _DRAWN},
            "charge": float(np.exp(random.uniform(*np.log(scenes.charge)))),
            "pose": _pose(scenes, box, "artefact" in what, devices, random),
            "seed": int(random.integers(2**31)),
            "stage_mm": stage_mm,
        }
    )


_SCENE, _STAGE = range(2)


def draw_stage(scenes: Scenes, seed: int, index: int) -> float:
    """Where the stage stands in scene `index`, in mm."""
    return float(_random(seed, index, _STAGE).uniform(*scenes.stage_mm))


def _random(seed: int, index: int, what: int) -> np.random.Generator:
    return np.random.default_rng([seed, index, what])


def _varied(name: str, variation: float, random: np.random.Generator) -> dict[str, Lengths]:
    """Lengths around the usual ones that make a solid."""
    usual = artefacts.usual_sizes(name)
    for _ in range(TRIES):
        sizes = {field: _scaled(length, variation, random) for field, length in usual.items()}
        try:
            artefacts.make(name, sizes)
        except ConfigError:
            continue
        return sizes
    raise ConfigError(
        f"'variation' is {variation:g}: hardly any '{name}' so far from its usual lengths is whole"
    )


def _scaled(lengths: Lengths, variation: float, random: np.random.Generator) -> Lengths:
    factors = 1.0 + variation * random.uniform(-1, 1, np.shape(lengths))
    scaled = (np.asarray(lengths) * factors).tolist()
    return tuple(scaled) if isinstance(scaled, list) else float(scaled)


@lru_cache(maxsize=16)
def _board_size(target: str) -> tuple[float, float]:
    return Target.load(target).size_mm


def _box(bounds: Floats) -> Floats:
    """Points (27, 3) in and on the box between two corners (2, 3)."""
    low, high = bounds
    share = np.linspace(0, 1, 3)
    grid = np.stack(np.meshgrid(share, share, share), axis=-1).reshape(-1, 3)
    return np.asarray(low + grid * (high - low))


def _pose(
    scenes: Scenes, box: Floats, upright: bool, devices: Calibration, random: np.random.Generator
) -> PoseFile:
    """T_camera_item with enough of the item's box in view. upright: its z axis points to the camera."""
    for _ in range(TRIES):
        pose = _random_pose(scenes, upright, devices, random)
        points = pose.apply(box)
        visible = devices.camera.sees(points) & devices.projector.sees(points, devices.T_projector_camera)
        if visible.mean() >= LEAST_IN_VIEW:
            return PoseFile.of(pose)
    raise ConfigError(
        f"'distance_mm' is {list(scenes.distance_mm)}: hardly any item lies there in the camera's image and "
        "the projector's light; change it, or lower 'off_centre' or 'tilt_deg'"
    )


def _random_pose(
    scenes: Scenes, upright: bool, devices: Calibration, random: np.random.Generator
) -> RigidTransform:
    middle = 0.5 * (np.array(devices.camera.size) - 1)
    pixel = middle * (1 + scenes.off_centre * random.uniform(-1, 1, 2))
    depth = random.uniform(*scenes.distance_mm)
    place = depth * np.append(devices.camera.normalise(pixel), 1.0)
    direction = random.uniform(0, 2 * np.pi)
    tilt = np.radians(scenes.tilt_deg) * np.sqrt(random.uniform())  # evenly over a disc of directions
    tilted = _turned(tilt * np.cos(direction), tilt * np.sin(direction), 0.0)
    turned = _turned(0.0, 0.0, np.radians(scenes.turn_deg) * random.uniform(-1, 1))
    facing = _turned(np.pi if upright else 0.0, 0.0, 0.0)
    return RigidTransform((tilted @ turned @ facing).rotation, place)


def _turned(x: float, y: float, z: float) -> RigidTransform:
    return RigidTransform.from_vectors(np.array([x, y, z]), np.zeros(3))
