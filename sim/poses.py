"""Random poses of a board, from a seed, in which camera and projector see it whole."""

from functools import lru_cache
from itertools import count

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform
from sim.world import PoseRules, World


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
