"""The scene of `sim.scene` as objects in Blender, and how Cycles renders it."""

import math
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ..scene import POSITION, REFLECTANCE, PointLamp, RenderScene, RenderSettings, Surface
from .camera import add_camera
from .materials import add_paint
from .projector import add_projector

SHADES_ROOM = "shades_room"  # property of an object, `Surface.shades_room`


def add_scene(
    blender_scene: Any,
    scene: RenderScene,
    textures: NDArray[np.float32] | None,
    bytecode: str | None,
    ambient: float = 0.0,
) -> Any:
    """Add camera, projector and surfaces to a scene in Blender that holds none."""
    # textures (circles, rows, columns)
    camera = add_camera(blender_scene, scene.camera, scene.aperture, bytecode)
    add_projector(blender_scene, scene.lamp, textures)
    for surface in scene.surfaces:
        _add_surface(blender_scene, surface, ambient)
    _restrict_to_window(blender_scene, scene)
    return camera


def add_room_lamps(blender_scene: Any, lamps: Sequence[PointLamp]) -> None:
    """Add lamps of the room, whose light is seen once reflected, and not as a gloss."""
    # Blender spreads the power of a point over 4π, and what a matt surface reflects over π once more.
    # Surfaces that are to throw no shadow of them must be there already.
    without_shadow = bpy.data.collections.new("no shadow of room lamps")
    for shape in blender_scene.collection.objects:
        if not shape.get(SHADES_ROOM, True):
            without_shadow.objects.link(shape)
    for linked in without_shadow.collection_objects:
        linked.light_linking.link_state = "EXCLUDE"
    for lamp in lamps:
        light = bpy.data.lights.new("room lamp", "POINT")
        light.energy, light.shadow_soft_size = 4 * math.pi**2 * lamp.irradiance, 0.0
        light.cycles.max_bounces = 0
        placed = bpy.data.objects.new("room lamp", light)
        placed.location, placed.visible_glossy = lamp.place, False
        placed.light_linking.blocker_collection = without_shadow
        blender_scene.collection.objects.link(placed)


def make_linear(blender_scene: Any, effort: RenderSettings) -> None:
    """Switch off tone curve, dither, denoising, clamping and heuristics; sample one point of every pixel."""
    blender_scene.render.engine = "CYCLES"
    blender_scene.render.resolution_percentage = 100
    blender_scene.render.dither_intensity = 0.0
    blender_scene.render.use_persistent_data = False  # otherwise the first texture is rendered again
    blender_scene.view_settings.view_transform = "Raw"
    if effort.survey:
        layer = blender_scene.view_layers[0]
        layer.aovs.add().name = POSITION
        layer.aovs.add().name = REFLECTANCE
        if effort.bounces:  # otherwise all light is direct
            layer.use_pass_diffuse_color = layer.use_pass_glossy_color = True
            layer.use_pass_diffuse_direct = layer.use_pass_glossy_direct = True
    settings = blender_scene.cycles
    settings.use_adaptive_sampling = settings.use_denoising = False
    settings.samples, settings.seed = effort.samples, effort.seed
    settings.pixel_filter_type, settings.filter_width = "BOX", 0.01
    settings.max_bounces = settings.diffuse_bounces = effort.bounces
    settings.light_sampling_threshold = 0.0  # otherwise dim light is dropped at random
    settings.sample_clamp_direct = settings.sample_clamp_indirect = 0.0
    settings.use_light_tree = False


def _restrict_to_window(blender_scene: Any, scene: RenderScene) -> None:
    (width, height), (left, top, right, bottom) = scene.camera.size, scene.window
    render = blender_scene.render
    render.use_border = render.use_crop_to_border = True
    # Blender cuts the border to whole pixels in single precision: aim at the inside of a pixel.
    render.border_min_x, render.border_max_x = (left + 0.25) / width, (right + 0.25) / width
    render.border_min_y = (height - bottom + 0.25) / height
    render.border_max_y = (height - top + 0.25) / height


def _add_surface(blender_scene: Any, surface: Surface, ambient: float) -> None:
    mesh = bpy.data.meshes.new("item")
    mesh.from_pydata(surface.vertices.tolist(), [], surface.faces.tolist())
    add_paint(mesh, surface.paint, surface.picture, surface.uv, ambient)
    item = bpy.data.objects.new("item", mesh)
    item[SHADES_ROOM] = surface.shades_room
    item.matrix_world = Matrix(surface.T_camera_item.tolist())
    blender_scene.collection.objects.link(item)
