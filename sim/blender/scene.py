"""A scene in Blender, rebuilt for every texture, so that no stale data can be rendered."""

from __future__ import annotations

from typing import Any

import bpy
import cycles
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from sim.blender.camera import add_camera, aim, compile_shader
from sim.blender.materials import add_paint
from sim.blender.processors import choose_device, runs_osl
from sim.blender.projector import add_projector
from sim.scene import (
    ALBEDO,
    COLOURS,
    DIRECT,
    POSITION,
    REFLECTANCE,
    Effort,
    RenderScene,
    SubpixelView,
    Surface,
    X,
    Z,
)

PixelBuffer = NDArray[np.float32]
"""Pictures or textures."""


class BlenderScene:
    """Builds scenes in Blender and renders them, one at a time."""

    def __init__(self) -> None:
        self._bytecode = compile_shader()
        self._passes: dict[str, PixelBuffer] = {}
        _keep_passes(self._passes)

    def render(
        self,
        scene: RenderScene,
        textures: PixelBuffer | None,
        views: list[SubpixelView],
        effort: Effort,
        out: PixelBuffer,
    ) -> None:
        """Render a scene once for every view.

        Parameters
        ----------
        scene : RenderScene
            Camera, lamp and surfaces.
        textures : PixelBuffer or None
            Of the lamp, (circles, rows, columns, 3); None for uniform white light.
        views : list of SubpixelView
            Points of the pixels and of the lens to look through.
        effort : Effort
            Samples, bounces, device and channels.
        out : PixelBuffer
            Where to write the result, (views, height, width, effort.channels).
        """
        out[...] = 0
        left, top, right, bottom = scene.window
        if left >= right or top >= bottom:
            return
        bpy.ops.wm.read_factory_settings(use_empty=True)
        stage = bpy.context.scene
        _linear_and_exact(stage, effort)
        choose_device(stage, effort.device)
        shaders = self._bytecode if runs_osl(effort.device) else None
        camera = add_camera(stage, scene.camera, scene.aperture, shaders)
        add_projector(stage, scene.lamp, textures)
        for surface in scene.surfaces:
            _add_surface(stage, surface)
        _restrict(stage, scene)
        self._passes.clear()
        for view, picture in zip(views, out, strict=True):
            aim(camera, scene.camera, view)
            bpy.ops.render.render()
            self._take(picture[top:bottom, left:right])

    def _take(self, out: PixelBuffer) -> None:
        """Copy the passes of the last render in the order of `sim.scene`'s channels."""
        passes = self._passes
        out[..., :COLOURS] = passes["Combined"][..., :COLOURS]
        if out.shape[-1] == COLOURS:
            return
        if "Diffuse Direct" in passes:
            out[..., DIRECT] = passes["Diffuse Direct"][..., 0] * passes["Diffuse Color"][..., 0]
            out[..., DIRECT] += passes["Glossy Direct"][..., 0] * passes["Glossy Color"][..., 0]
        else:
            out[..., DIRECT] = out[..., 0]
        out[..., ALBEDO] = passes[REFLECTANCE][..., 0]
        out[..., X : Z + 1] = passes[POSITION][..., :3]


def _keep_passes(passes: dict[str, PixelBuffer]) -> None:
    """Keep the passes as floats from Cycles itself: without a window Blender only writes them to files."""
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
    """Switch off tone curve, dither, denoising, clamping and heuristics; sample one point of every pixel."""
    stage.render.engine = "CYCLES"
    stage.render.resolution_percentage = 100
    stage.render.dither_intensity = 0.0
    stage.render.use_persistent_data = False  # otherwise the first texture is rendered again
    stage.view_settings.view_transform = "Raw"
    if effort.survey:
        layer = stage.view_layers[0]
        layer.aovs.add().name = POSITION
        layer.aovs.add().name = REFLECTANCE
        if effort.bounces:  # otherwise all light is direct
            layer.use_pass_diffuse_color = layer.use_pass_glossy_color = True
            layer.use_pass_diffuse_direct = layer.use_pass_glossy_direct = True
    settings = stage.cycles
    settings.use_adaptive_sampling = settings.use_denoising = False
    settings.samples, settings.seed = effort.samples, effort.seed
    settings.pixel_filter_type, settings.filter_width = "BOX", 0.01
    settings.max_bounces = settings.diffuse_bounces = effort.bounces
    settings.light_sampling_threshold = 0.0  # otherwise dim light is dropped at random
    settings.sample_clamp_direct = settings.sample_clamp_indirect = 0.0
    settings.use_light_tree = False


def _restrict(stage: Any, scene: RenderScene) -> None:
    """Limit the render to the window."""
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
    add_paint(mesh, surface.paint, surface.picture, surface.uv)
    item = bpy.data.objects.new("item", mesh)
    item.matrix_world = Matrix(surface.T_camera_item.tolist())
    stage.collection.objects.link(item)
