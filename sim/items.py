"""What the fixture holds: items of the world file as surfaces, and the poses a board is held in."""

from __future__ import annotations

from functools import lru_cache
from itertools import count

import numpy as np

from fpplab import artefacts
from fpplab.conventions import Floats
from fpplab.errors import ConfigError
from fpplab.geometry import Pinhole, RigidTransform
from fpplab.targets import Target
from sim.scene import Lamp, Optics, Scene, Surface
from sim.world import ArtefactItem, BoardItem, CardItem, PoseRules, World

TRIES = 20000
CANDIDATES = 6
PRINT_PX_PER_MM = (4.0, 32.0)


def item_poses(world: World, name: str) -> tuple[RigidTransform, ...]:
    """Every pose T_camera_item that an item is held in. Raises `ConfigError`."""
    item = world.item(name)
    if not isinstance(item, BoardItem):
        return (item.pose.transform(),)
    if isinstance(item.poses, PoseRules):
        return board_poses(world, name, Target.load(item.target).size_mm, item.poses)
    return tuple(pose.transform() for pose in item.poses)


def build_scene(world: World, name: str, pose: int, stage_mm: float) -> Scene:
    """The scene with item `name` in its pose number `pose`. Raises `ConfigError`."""
    surface = _surface(world, name, item_poses(world, name)[pose])
    texture, projector = world.projector.texture(), world.projector_model()
    lamp = Lamp(
        optics=_optics(projector),
        T_camera_projector=world.T_projector_camera(stage_mm).inverse().matrix,
        affine=texture.affine,
        texture_shape=texture.shape,
        exact=texture.exact,
        distance_mm=world.projector.distance_mm,
        half_angle=_half_angle(projector),
    )
    camera = world.camera_model()
    return Scene(_optics(camera), lamp, (surface,), _window(camera, surface))


def _optics(model: Pinhole) -> Optics:
    return Optics(model.size, model.matrix, model.distortion)


def _half_angle(projector: Pinhole) -> float:
    """Of the cone around the axis that holds the whole image and a margin, rad."""
    width, height = projector.size
    corners = np.array([[-8.0, -8.0], [width + 8, -8], [width + 8, height + 8], [-8, height + 8]])
    return float(np.arctan(np.linalg.norm(projector.normalise(corners), axis=-1)).max()) + 0.01


def _surface(world: World, name: str, pose: RigidTransform) -> Surface:
    item, reflectance = world.item(name), world.material.reflectance
    if isinstance(item, ArtefactItem):
        mesh = artefacts.make(item.artefact)
        return Surface(
            np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64), pose.matrix, reflectance
        )
    if isinstance(item, CardItem):
        return Surface(_corners(item.card_mm), np.array([[0, 1, 2], [0, 2, 3]]), pose.matrix, reflectance)
    target = Target.load(item.target)
    return Surface(
        _corners(target.size_mm),
        np.array([[0, 1, 2], [0, 2, 3]]),
        pose.matrix,
        1.0,  # a print has its own reflectance
        target.image(_print_resolution(world, pose)),
        np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),
    )


def _window(camera: Pinhole, surface: Surface) -> tuple[int, int, int, int]:
    """Pixels (left, top, right, bottom) that hold a surface: those of its bounding box, with a margin."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    share = np.linspace(0, 1, 9)
    grid = np.stack(np.meshgrid(share, share, share), axis=-1).reshape(-1, 3)
    rotation, translation = surface.T_camera_item[:3, :3], surface.T_camera_item[:3, 3]
    points = RigidTransform(rotation, translation).apply(low + grid * (high - low))
    width, height = camera.size
    if points[:, 2].min() <= 0:
        return 0, 0, width, height
    pixels = camera.project(points)
    margin = 4 + 0.02 * max(camera.size)
    left, top = np.floor(pixels.min(axis=0) - margin)
    right, bottom = np.ceil(pixels.max(axis=0) + margin)
    across, down = np.clip([left, right], 0, width), np.clip([top, bottom], 0, height)
    return int(across[0]), int(down[0]), int(across[1]), int(down[1])


def _print_resolution(world: World, pose: RigidTransform) -> float:
    """Pixels per mm of a board's picture: twice what the camera resolves, within reason."""
    camera = world.camera_model()
    resolved = camera.matrix[0, 0] / max(pose.translation[2], 1.0)
    return float(np.clip(2 * resolved, *PRINT_PX_PER_MM))


def _corners(size_mm: tuple[float, float]) -> Floats:
    """Corners (4, 3) of a plate around its origin, clockwise from the top left."""
    x, y = 0.5 * size_mm[0], 0.5 * size_mm[1]
    return np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])


@lru_cache(maxsize=16)
def _poses_of(
    world_key: str, name: str, size_mm: tuple[float, float], rules: PoseRules
) -> tuple[RigidTransform, ...]:
    world = World.model_validate_json(world_key)
    random = np.random.default_rng([world.seed, *name.encode()])
    camera, projector = world.camera_model(), world.projector_model()
    outline = _outline(size_mm)
    T_projector_camera = world.T_projector_camera()
    chosen: list[RigidTransform] = []
    fitting: list[RigidTransform] = []
    for attempt in count():
        if len(chosen) == rules.count:
            return tuple(chosen)
        if attempt == TRIES * rules.count:
            raise ConfigError(
                f"world: 'items.{name}.poses' asks for {rules.count} poses of a board of {size_mm[0]:g} x "
                f"{size_mm[1]:g} mm, but hardly any lie in the camera's image and the projector's light; "
                "lower tilt_deg or range_mm, or use a smaller board"
            )
        pose = _random_pose(random, camera, rules)
        seen = pose.apply(outline)
        if _inside(camera, seen, rules.margin_px) and _inside(
            projector, T_projector_camera.apply(seen), rules.margin_px
        ):
            fitting.append(pose)
        if len(fitting) == CANDIDATES:
            chosen.append(_farthest(fitting, chosen))
            fitting.clear()
    raise AssertionError


def board_poses(
    world: World, name: str, size_mm: tuple[float, float], rules: PoseRules
) -> tuple[RigidTransform, ...]:
    """Poses T_camera_board, reproducible from the world's seed, spread over the camera's image.

    Of a few random poses that fit, the one farthest from all before is taken (Mitchell's best candidate).
    Raises `ConfigError` when there is no room.
    """
    return _poses_of(world.model_dump_json(), name, size_mm, rules)


def _outline(size_mm: tuple[float, float]) -> Floats:
    """Points along a board's edge, so that distortion cannot bend one out of sight."""
    corners = _corners(size_mm)
    steps = np.linspace(0, 1, 5)[:-1, None]
    return np.concatenate(
        [a + steps * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    )


def _random_pose(random: np.random.Generator, camera: Pinhole, rules: PoseRules) -> RigidTransform:
    direction, turn = random.uniform(0, 2 * np.pi), np.radians(random.uniform(-1, 1) * rules.turn_deg)
    tilt = np.radians(rules.tilt_deg) * np.sqrt(random.uniform())
    tilted = RigidTransform.from_vectors(
        tilt * np.array([np.cos(direction), np.sin(direction), 0]), np.zeros(3)
    )
    turned = RigidTransform.from_vectors(np.array([0, 0, turn]), np.zeros(3))
    pixel = random.uniform((0, 0), camera.size)
    depth = rules.distance_mm + random.uniform(-1, 1) * rules.range_mm
    centre = depth * np.append(camera.normalise(pixel), 1.0)
    return RigidTransform(tilted.rotation @ turned.rotation, centre)


def _inside(device: Pinhole, points: Floats, margin_px: float) -> bool:
    pixels = device.project(points)
    return bool(np.all(pixels >= margin_px) and np.all(pixels <= np.array(device.size) - 1 - margin_px))


def _farthest(fitting: list[RigidTransform], chosen: list[RigidTransform]) -> RigidTransform:
    if not chosen:
        return fitting[0]
    before = np.array([pose.translation for pose in chosen])
    return max(fitting, key=lambda pose: np.linalg.norm(before - pose.translation, axis=1).min())
