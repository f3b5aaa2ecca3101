"""A scene in Blender, built afresh for every texture: nothing stale can be shown."""

from __future__ import annotations

from typing import Any

import bpy
import cycles
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from sim.blender.camera import add_camera, aim, compile_shader
from sim.blender.projector import add_projector
from sim.scene import Effort, Scene, Surface

Pixels = NDArray[np.float32]


class Studio:
    """Holds one scene and renders it."""

    def __init__(self) -> None:
        self._bytecode = compile_shader()
        self._passes: dict[str, Pixels] = {}
        _keep_passes(self._passes)

    def render(
        self,
        scene: Scene,
        texture: Pixels | None,
        shifts: list[tuple[float, float]],
        effort: Effort,
        out: Pixels,
    ) -> None:
        """Render once for every shift of the pixels' centres into `out` (shifts, height, width, CHANNELS)."""
        out[...] = 0
        left, top, right, bottom = scene.window
        if left >= right or top >= bottom:
            return
        bpy.ops.wm.read_factory_settings(use_empty=True)
        stage = bpy.context.scene
        _linear_and_exact(stage, effort)
        camera = add_camera(stage, scene.camera, self._bytecode)
        add_projector(stage, scene.lamp, texture)
        for surface in scene.surfaces:
            _add_surface(stage, surface)
        _restrict(stage, scene)
        for shift, picture in zip(shifts, out, strict=True):
            aim(camera, shift)
            bpy.ops.render.render()
            picture[top:bottom, left:right, :3] = self._passes["Combined"][..., :3]
            picture[top:bottom, left:right, 3:] = self._passes["Diffuse Color"][..., :1]
        self._passes.clear()


def _keep_passes(passes: dict[str, Pixels]) -> None:
    """Take the passes as floats from Cycles itself: without a window Blender gives them to files alone."""
    render = cycles.CyclesRender.render

    def render_and_keep(engine: Any, depsgraph: Any) -> None:
        render(engine, depsgraph)
        result = engine.get_result()
        for layer_pass in result.layers[0].passes:
            pixels = np.empty((result.resolution_y, result.resolution_x, layer_pass.channels), np.float32)
            layer_pass.rect.foreach_get(pixels.ravel())
            passes[layer_pass.name] = pixels[::-1]  # Blender's bottom row is first

    cycles.CyclesRender.render = render_and_keep


def _linear_and_exact(stage: Any, effort: Effort) -> None:
    """No tone curve, dither, denoising, clamping or guessing; every path of a pixel through one point."""
    stage.render.engine = "CYCLES"
    stage.render.resolution_percentage = 100
    stage.render.dither_intensity = 0.0
    stage.render.use_persistent_data = False  # it would go on showing the first texture
    stage.view_settings.view_transform = "Raw"
    stage.view_layers[0].use_pass_diffuse_color = True
    settings = stage.cycles
    settings.device = "CPU"
    settings.use_adaptive_sampling = settings.use_denoising = False
    settings.samples, settings.seed = effort.samples, effort.seed
    settings.pixel_filter_type, settings.filter_width = "BOX", 0.01
    settings.max_bounces = settings.diffuse_bounces = effort.bounces
    settings.light_sampling_threshold = 0.0  # or dim light is dropped at random
    settings.sample_clamp_direct = settings.sample_clamp_indirect = 0.0
    settings.use_light_tree = False


def _restrict(stage: Any, scene: Scene) -> None:
    """Render the window alone."""
    (width, height), (left, top, right, bottom) = scene.camera.size, scene.window
    render = stage.render
    render.use_border = render.use_crop_to_border = True
    # Blender cuts the border to whole pixels in single precision: aim at the inside of a pixel.
    render.border_min_x, render.border_max_x = (left + 0.25) / width, (right + 0.25) / width
    render.border_min_y, render.border_max_y = (
        (height - bottom + 0.25) / height,
        (height - top + 0.25) / height,
    )


def _add_surface(stage: Any, surface: Surface) -> None:
    mesh = bpy.data.meshes.new("item")
    mesh.from_pydata(surface.vertices.tolist(), [], surface.faces.tolist())
    material = bpy.data.materials.new("paint")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    diffuse, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    diffuse.inputs["Roughness"].default_value = 0.0
    diffuse.inputs["Color"].default_value = (*[surface.reflectance] * 3, 1.0)
    if surface.picture is not None and surface.uv is not None:
        _paint(tree, mesh, surface.picture * np.float32(surface.reflectance / 255), surface.uv, diffuse)
    mesh.materials.append(material)
    item = bpy.data.objects.new("item", mesh)
    item.matrix_world = Matrix(surface.T_camera_item.tolist())
    stage.collection.objects.link(item)


def _paint(tree: Any, mesh: Any, reflectance: Pixels, uv: NDArray[np.float64], diffuse: Any) -> None:
    height, width = reflectance.shape
    image = bpy.data.images.new("picture", width, height, float_buffer=True, is_data=True)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = reflectance[::-1, :, None]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    layer = mesh.uv_layers.new(name="picture")
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    upward = np.column_stack([uv[corners, 0], 1.0 - uv[corners, 1]])
    layer.data.foreach_set("uv", upward.ravel().astype(np.float32))
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation, node.extension = image, "Linear", "EXTEND"
    tree.links.new(node.outputs["Color"], diffuse.inputs["Color"])
