"""Build the scene that Blender is sent from a world and the state of its moving parts."""

import math
from dataclasses import dataclass, replace

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole, RigidTransform
from sim.items import item_poses, item_shape, item_surface, rim_surface
from sim.scene import Aperture, Lamp, PinholeOptics, RenderScene, Surface
from sim.texture import MirrorTexture
from sim.world import World

NOTHING = "nothing"  # what the empty fixture holds
CIRCLE_STEP_TEXELS, CIRCLE_RATIO = 0.75, 1.3
"""Spacing of the circles of confusion that textures are made for: texels, or this factor if more."""


@dataclass(frozen=True)
class SceneState:
    """The state of everything that moves in the simulation."""

    item: str = NOTHING  # name of the mounted item, or "nothing"
    pose: int = 0  # index of the item's pose in the world
    stage_mm: float = 0.0  # position of the stage in mm
    vibration_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)  # displacement of the item by vibration
    held: RigidTransform | None = None  # T_camera_item in place of the world's pose
    convergence_deg: float = 0.0  # turn of the projector towards the camera, in degrees
    error_draw: int | None = None  # number by which errors of a board's points are drawn; None for no errors

    def T_projector_camera(self, world: World) -> RigidTransform:
        return world.T_projector_camera(self.stage_mm, self.convergence_deg)


def build_scene(
    world: World, setup: SceneState, around: tuple[Surface, ...] = ()
) -> tuple[RenderScene, MirrorTexture]:
    surfaces = _mounted(world, setup)
    if around:
        surfaces = (*surfaces, *_frame_surfaces(world, setup), *around)
    return _build_scene_around(world, setup, surfaces)


def build_background(
    world: World, setup: SceneState, around: tuple[Surface, ...]
) -> tuple[RenderScene, MirrorTexture]:
    """Build the scene in which all that stands still is seen behind the mounted item and in its shadow."""
    at_rest = replace(setup, vibration_mm=(0.0, 0.0, 0.0))
    surfaces = (*around, *_frame_surfaces(world, at_rest), *_mounted(world, at_rest))
    return _build_scene_around(world, setup, surfaces)


def _mounted(world: World, setup: SceneState) -> tuple[Surface, ...]:
    return () if setup.item == NOTHING else (item_surface(world, setup.item, _pose(world, setup)),)


def _frame_surfaces(world: World, setup: SceneState) -> tuple[Surface, ...]:
    rim = None if setup.item == NOTHING else rim_surface(world, setup.item, _pose(world, setup))
    return () if rim is None else (rim,)


def _pose(world: World, setup: SceneState) -> RigidTransform:
    held = setup.held or item_poses(world, setup.item)[setup.pose]
    return held.moved(np.array(setup.vibration_mm))


def _build_scene_around(
    world: World, setup: SceneState, surfaces: tuple[Surface, ...]
) -> tuple[RenderScene, MirrorTexture]:
    """Build a scene whose window and textures suffice for its surfaces."""
    enclosed_points = np.concatenate([_bounding_box(surface) for surface in surfaces])
    camera = world.camera_model()
    aperture = Aperture(world.camera.aperture_mm, world.camera.focus_mm or 1.0)
    lamp, texture = _build_lamp(world, setup.T_projector_camera(world), enclosed_points)
    window = _window_around(camera, aperture, enclosed_points)
    return RenderScene(_optics(camera), aperture, lamp, surfaces, window), texture


def is_lit_in_view(world: World, setup: SceneState) -> bool:
    """Return whether some point of the item is in the images of both camera and projector; shadows aside."""
    vertices, faces = item_shape(world, setup.item)
    held = setup.held or item_poses(world, setup.item)[setup.pose]
    points = held.apply(_spread_points(vertices[faces]))
    in_view = world.camera_model().sees(points)
    lit = world.projector_model().sees(points, setup.T_projector_camera(world))
    return bool(np.any(in_view & lit))


def _optics(model: Pinhole) -> PinholeOptics:
    return PinholeOptics(model.size, model.matrix, model.distortion)


def _build_lamp(
    world: World, T_projector_camera: RigidTransform, enclosed_points: Floats
) -> tuple[Lamp, MirrorTexture]:
    section, projector = world.projector, world.projector_model()
    texture = section.texture()
    scale = texture.texels_per_column * float(projector.matrix[0, 0])
    aperture = Aperture()
    circles: tuple[float, ...] = (0.0,)
    if section.focus_mm is not None:
        aperture = Aperture(section.aperture_mm, section.focus_mm)
        circles = _circle_diameters(aperture, scale, T_projector_camera.apply(enclosed_points)[:, 2])
        texture = replace(texture, widest=circles[-1])
    fine = texture.places_per_mirror
    lamp = Lamp(
        optics=_optics(projector),
        T_camera_projector=T_projector_camera.inverse().matrix,
        affine=texture.affine,
        texture_shape=(fine * texture.shape[0], fine * texture.shape[1]),
        places_per_mirror=fine,
        exact=texture.exact,
        fill=texture.fill,
        distance_mm=section.distance_mm,
        half_angle=_half_angle(projector),
        aperture=aperture,
        texels_per_slope=scale,
        circles=circles,
    )
    return lamp, texture


def _circle_diameters(aperture: Aperture, scale: float, depths: Floats) -> tuple[float, ...]:
    """List diameters in texels that suffice for these depths, rising."""
    near, far = max(float(depths.min()), 1.0), max(float(depths.max()), 1.0)
    ends = scale * aperture.circle_per_px(np.array([near, far]))
    smallest, largest = float(ends.min()), float(ends.max())
    if near < aperture.focus_mm < far:
        smallest = 0.0
    drawn = [smallest]
    while drawn[-1] < largest:
        drawn.append(max(drawn[-1] + CIRCLE_STEP_TEXELS, drawn[-1] * CIRCLE_RATIO))
    return tuple(drawn)


def _half_angle(projector: Pinhole) -> float:
    """Of the cone around the axis that holds the image and a margin, as far as the lens reaches, rad."""
    width, height = projector.size
    corners = np.array([[-8.0, -8.0], [width + 8, -8], [width + 8, height + 8], [-8, height + 8]])
    widest = np.arctan(np.linalg.norm(projector.normalise(corners), axis=-1)).max() + 0.01
    # A corner beyond the reach of the distortion model is NaN.
    return float(np.fmin(widest, np.arctan(projector.reach)))


def _bounding_box(surface: Surface) -> Floats:
    """Sample points (729, 3) in and on the box that holds a surface, in the camera's frame."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    share = np.linspace(0, 1, 9)
    grid = np.stack(np.meshgrid(share, share, share), axis=-1).reshape(-1, 3)
    return _placed(surface, low + grid * (high - low))


def _placed(surface: Surface, points: Floats) -> Floats:
    matrix = surface.T_camera_item
    return RigidTransform(matrix[:3, :3], matrix[:3, 3]).apply(points)


def _window_around(camera: Pinhole, aperture: Aperture, box: Floats) -> tuple[int, int, int, int]:
    """Find the pixels (left, top, right, bottom) that hold a box, with a margin."""
    width, height = camera.size
    if box[:, 2].min() <= 0:
        return 0, 0, width, height
    pixels = camera.project(box)
    blur = float(camera.matrix[0, 0]) * aperture.circle_per_px(box[:, 2]).max()
    margin = 4 + 0.02 * max(camera.size) + math.ceil(blur)
    left, top = np.floor(pixels.min(axis=0) - margin)
    right, bottom = np.ceil(pixels.max(axis=0) + margin)
    across, down = np.clip([left, right], 0, width), np.clip([top, bottom], 0, height)
    return int(across[0]), int(down[0]), int(across[1]), int(down[1])


def _spread_points(triangles: Floats) -> Floats:
    """Sample points on triangles (F, 3, 3): a lattice over each, coarse where there are many."""
    steps = 12 if len(triangles) < 500 else 1
    i, j = (k.ravel() for k in np.mgrid[0 : steps + 1, 0 : steps + 1])
    inside = i + j <= steps
    a, b = i[inside] / steps, j[inside] / steps
    shares = np.stack([1 - a - b, a, b], axis=-1)
    return np.asarray(np.einsum("kc,fcx->fkx", shares, triangles).reshape(-1, 3))
