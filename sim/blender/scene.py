"""A scene in Blender, rebuilt for every texture, so that no stale data can be rendered; Cycles' devices."""

from typing import Any

import bpy
import cycles
import numpy as np
from numpy.typing import NDArray

from sim.blender.building import add_scene, make_linear
from sim.blender.camera import aim, compile_shader
from sim.scene import (
    ALBEDO,
    COLOURS,
    DIRECT,
    POSITION,
    REFLECTANCE,
    RenderRefused,
    RenderScene,
    RenderSettings,
    SubpixelView,
    X,
    Z,
)

PixelBuffer = NDArray[np.float32]  # pictures or textures


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
        effort: RenderSettings,
        out: PixelBuffer,
    ) -> None:
        # textures (circles, rows, columns, 3)
        out[...] = 0
        left, top, right, bottom = scene.window
        if left >= right or top >= bottom:
            return
        bpy.ops.wm.read_factory_settings(use_empty=True)
        blender_scene = bpy.context.scene
        make_linear(blender_scene, effort)
        choose_cycles_device(blender_scene, effort.device)
        shaders = self._bytecode if runs_osl(effort.device) else None
        camera = add_scene(blender_scene, scene, textures, shaders)
        self._passes.clear()
        for view, picture in zip(views, out, strict=True):
            aim(camera, scene.camera, view)
            bpy.ops.render.render()
            self._copy_render_passes(picture[top:bottom, left:right])

    def _copy_render_passes(self, out: PixelBuffer) -> None:
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


CPU, OPTIX = "CPU", "OPTIX"  # the kinds of device that run Open Shading Language


def runs_osl(device: str) -> bool:
    """Return whether a kind of device runs Open Shading Language, in which the camera is written."""
    return device in (CPU, OPTIX)


def choose_cycles_device(blender_scene: Any, device: str) -> None:
    """Set a scene to render on every device of a kind."""
    if device == CPU:
        blender_scene.cycles.device = CPU
        return
    preferences = _preferences()
    devices = _devices(preferences, device)
    if not devices:
        raise RenderRefused(
            f"'render.device' is {device}, but there is no {device} device that Cycles can use; "
            "set it to CPU, or install the device's driver"
        )
    preferences.compute_device_type = device
    preferences.refresh_devices()
    for entry in preferences.devices:
        entry.use = entry.type == device
    blender_scene.cycles.device = "GPU"


def _preferences() -> Any:
    addons = bpy.context.preferences.addons
    if "cycles" not in addons:
        bpy.ops.preferences.addon_enable(module="cycles")
    return addons["cycles"].preferences


def _devices(preferences: Any, device: str) -> list[Any]:
    try:
        return [entry for entry in preferences.get_devices_for_type(device) if entry.type == device]
    except (ValueError, TypeError):  # this build of Blender does not know that kind
        return []
