"""Items of the world file as surfaces, and the poses that the fixture holds them in."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from itertools import count
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab import artefacts
from fpplab.artefacts import Lengths
from fpplab.artefacts.parts import load_part
from fpplab.artefacts.slicing import slice_as_printed
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.targets import Target
from sim.scene import Paint, Surface
from sim.sheet import drawn_sheet, sheet_corners
from sim.world import ArtefactItem, BoardItem, CardItem, MeshItem, PoseRules, World


def plate_corners(size_mm: tuple[float, float]) -> Floats:
    """List the corners of a rectangular plate centred at its origin."""
    # size_mm (width, height) mm; returns (4, 3) mm
    x, y = 0.5 * size_mm[0], 0.5 * size_mm[1]
    return np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])


@lru_cache(maxsize=16)
def _poses_of(
    world_key: str, name: str, size_mm: tuple[float, float], rules: PoseRules
) -> tuple[RigidTransform, ...]:
    world = World.model_validate_json(world_key)
    random = np.random.default_rng([world.seed, *name.encode()])
    camera, projector = world.camera_model(), world.projector_model()
    outline = _sample_board_edge(size_mm)
    T_projector_camera = world.T_projector_camera()
    margin = rules.margin_px + 0.5  # `margin_px` is measured from the centres of the outermost pixels
    chosen: list[RigidTransform] = []
    fitting: list[RigidTransform] = []
    for attempt in count():
        if len(chosen) == rules.count:
            return tuple(chosen)
        if attempt == 20_000 * rules.count:
            raise ConfigError(
                f"world: 'items.{name}.poses' asks for {rules.count} poses of a board of {size_mm[0]:g} x "
                f"{size_mm[1]:g} mm, but hardly any lie in the camera's image and the projector's light; "
                "lower tilt_deg or range_mm, or use a smaller board"
            )
        pose = _random_pose(random, camera, rules)
        seen = pose.apply(outline)
        if (
            camera.sees(seen, margin_px=margin).all()
            and projector.sees(seen, T_projector_camera, margin).all()
        ):
            fitting.append(pose)
        if len(fitting) == 6:
            chosen.append(_farthest_pose(fitting, chosen))
            fitting.clear()
    raise AssertionError


def board_poses(
    world: World, name: str, size_mm: tuple[float, float], rules: PoseRules
) -> tuple[RigidTransform, ...]:
    """Draw poses of a board, reproducible from the world's seed, spread over the camera's image."""
    # Of six random poses that fit, the one farthest from all before is taken (Mitchell's best candidate).
    # size_mm (width, height) mm
    return _poses_of(world.model_dump_json(), name, size_mm, rules)


def _sample_board_edge(size_mm: tuple[float, float]) -> Floats:
    """Sample points along a board's edge, so that distortion cannot bend a part of it out of the image."""
    corners = plate_corners(size_mm)
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


def _farthest_pose(fitting: list[RigidTransform], chosen: list[RigidTransform]) -> RigidTransform:
    if not chosen:
        return fitting[0]
    before = np.array([pose.translation for pose in chosen])
    return max(fitting, key=lambda pose: np.linalg.norm(before - pose.translation, axis=1).min())


PRINT_PX_PER_MM = (4.0, 32.0)  # least and greatest resolution of a board's picture


def item_poses(world: World, name: str) -> tuple[RigidTransform, ...]:
    item = world.item(name)
    if not isinstance(item, BoardItem):
        return (item.pose.transform(),)
    if isinstance(item.poses, PoseRules):
        return board_poses(world, name, board_target(name, item).size_mm, item.poses)
    return tuple(pose.transform() for pose in item.poses)


def item_mesh(item: ArtefactItem | MeshItem) -> trimesh.Trimesh:
    """Make or load the true shape of an artefact or part."""
    if isinstance(item, ArtefactItem):
        return _artefact(item.artefact, tuple(item.sizes.items()), item.layer_mm, item.bead_mm)
    path = Path(item.mesh)
    return _part(path, path.stat().st_mtime_ns if path.is_file() else 0)


def part_mesh(world: World, name: str) -> trimesh.Trimesh:
    """Make or load the true shape of an item of a world."""
    item = world.item(name)
    if not isinstance(item, ArtefactItem | MeshItem):
        raise ConfigError(f"world: 'items.{name}' is flat: only artefacts and parts have a mesh")
    return item_mesh(item)


@lru_cache(maxsize=8)
def _artefact(
    name: str, sizes: tuple[tuple[str, Lengths], ...], layer_mm: float | None, bead_mm: float
) -> trimesh.Trimesh:
    mesh = artefacts.make(name, dict(sizes))
    return mesh if layer_mm is None else slice_as_printed(mesh, layer_mm, bead_mm)


@lru_cache(maxsize=4)
def _part(path: Path, changed_ns: int) -> trimesh.Trimesh:
    return load_part(path)


def item_shape(world: World, name: str) -> tuple[Floats, NDArray[np.int64]]:
    # returns vertices (V, 3) mm, faces (F, 3)
    item = world.item(name)
    if isinstance(item, CardItem):
        return plate_corners(item.card_mm), _PLATE
    if isinstance(item, BoardItem):
        return sheet_corners(board_target(name, item).size_mm, item.margins_mm), _PLATE
    with _named(f"items.{name}.{'mesh' if isinstance(item, MeshItem) else 'artefact'}"):
        mesh = item_mesh(item)
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def item_surface(world: World, name: str, pose: RigidTransform) -> Surface:
    item = world.item(name)
    vertices, faces = item_shape(world, name)
    if isinstance(item, BoardItem):
        target = board_target(name, item)
        unpainted = target.model_copy(update={"foreground": 0.0, "background": 1.0})
        picture = _ground_mask(unpainted, _print_px_per_mm(world, pose))
        printed = Paint(target.background, ink=target.foreground)
        if any(item.margins_mm) or item.texture is not None:
            with _named(f"items.{name}.texture"):
                picture, white = drawn_sheet(picture, target, item.margins_mm, item.texture)
            printed = Paint(white, ink=0.0)
        return Surface(vertices, faces, pose.matrix, printed, picture, _PLATE_UV)
    return Surface(vertices, faces, pose.matrix, world.material_of(name).paint())


def standing_surfaces(world: World) -> tuple[Surface, ...]:
    """Make the surfaces of the items that stand in view whatever the fixture holds."""
    return tuple(item_surface(world, name, item_poses(world, name)[0]) for name in world.standing)


def rim_surface(world: World, name: str, pose: RigidTransform) -> Surface | None:
    """Make the dark frame of a board: a plate just behind it, of which the rim is seen."""
    item = world.item(name)
    if not isinstance(item, BoardItem) or not item.rim_mm:
        return None
    left, top, right, bottom = (margin + item.rim_mm for margin in item.margins_mm)
    corners = sheet_corners(board_target(name, item).size_mm, (left, top, right, bottom))
    behind = [0.0, 0.0, 0.1]  # mm
    return Surface(corners + behind, _PLATE, pose.matrix, Paint(item.rim_reflectance))


@lru_cache(maxsize=64)
def _ground_mask(target: Target, px_per_mm: float) -> NDArray[np.uint8]:
    """Draw a board's picture, 255 for the white of its ground; shared, so it must not be changed."""
    return target.image(px_per_mm)


def board_target(name: str, item: BoardItem) -> Target:
    """Load what is printed on a board, with the item's own reflectances."""
    with _named(f"items.{name}.target"):
        path = config.find_config(item.target, "target")
        target = _target(path, path.stat().st_mtime_ns)
    own = {"background": item.reflectance, "foreground": item.ink}
    return target.model_copy(update={field: value for field, value in own.items() if value is not None})


@lru_cache(maxsize=8)
def _target(path: Path, changed_ns: int) -> Target:
    return Target.load(path)


@contextmanager
def _named(field: str) -> Iterator[None]:
    """Prefix a `ConfigError` with the world's field that it is about."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"world: '{field}': {error}") from error


_PLATE = np.array([[0, 1, 2], [0, 2, 3]])
_PLATE_UV = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def _print_px_per_mm(world: World, pose: RigidTransform) -> float:
    """Choose pixels per mm of a board's picture: twice what the camera resolves or more, within limits."""
    # A power of two, so that a board that moves a little keeps its picture.
    camera = world.camera_model()
    resolved = camera.matrix[0, 0] / max(pose.translation[2], 1.0)
    return float(np.clip(2 ** np.ceil(np.log2(2 * resolved)), *PRINT_PX_PER_MM))
