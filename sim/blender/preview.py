"""A preview as a scene in Blender: built, set up for viewing, and rendered as the twin's camera sees it."""

import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..preview_file import Preview
from ..scene import GreyScale, PatternRender, SubpixelView
from .building import add_room_lamps, add_scene, make_linear
from .camera import aim, compile_shader

VIEWING_SAMPLES = 16  # light paths for each pixel of the rendered view

PreviewPixels = NDArray[np.float32]  # pictures (height, width)


def show_preview(blender_scene: Any, preview: Preview) -> None:
    """Add camera, projector and item to a scene in Blender that holds none, and set it up for viewing."""
    # The rendered view then shows grey levels over full scale, but for the sensor's black level.
    pattern = preview.render
    camera = add_scene(blender_scene, pattern.scene, pattern.textures, compile_shader(), pattern.ambient)
    add_room_lamps(blender_scene, pattern.room_lamps)
    aim(camera, pattern.scene.camera, _middle(pattern))
    make_linear(blender_scene, pattern.settings)
    blender_scene.cycles.device = "CPU" if pattern.settings.device == "CPU" else "GPU"
    blender_scene.cycles.samples = blender_scene.cycles.preview_samples = (
        VIEWING_SAMPLES * pattern.settings.samples
    )
    blender_scene.cycles.filter_width = 1.0
    blender_scene.cycles.use_preview_denoising = blender_scene.cycles.use_preview_adaptive_sampling = False
    _show_grey_levels(blender_scene, preview.grey_scale)
    blender_scene.unit_settings.system, blender_scene.unit_settings.scale_length = "METRIC", 1e-3
    blender_scene.unit_settings.length_unit = "MILLIMETERS"


def take_picture(blender_scene: Any, preview: Preview) -> PreviewPixels:
    """Render what the twin's camera sees on average, without noise, through the twin's own sub-pixels."""
    # returns (height, width)
    pattern = preview.render
    left, top, right, bottom = pattern.scene.window
    width, height = pattern.scene.camera.size
    irradiance = np.zeros((height, width), np.float32)
    picture = irradiance[top:bottom, left:right]
    if picture.size:
        with _for_pictures(blender_scene, pattern), tempfile.TemporaryDirectory(prefix="fpplab-") as folder:
            blender_scene.render.filepath = str(Path(folder) / "view.exr")
            for view in pattern.views:
                aim(blender_scene.camera.data, pattern.scene.camera, view)
                picture += _under_all_lights(blender_scene)
            aim(blender_scene.camera.data, pattern.scene.camera, _middle(pattern))
        picture /= np.float32(len(pattern.views))
    if pattern.falloff is not None:
        irradiance *= pattern.falloff
    return preview.grey_scale.levels(irradiance)


def _under_all_lights(blender_scene: Any) -> PreviewPixels:
    """Add up pictures under one light each, since Cycles takes one of several at random for each sample."""
    # Each of them holds what glows by itself, which must count once.
    lights = [light for light in blender_scene.objects if light.type == "LIGHT"]
    if len(lights) == 1:
        return _rendered(blender_scene)
    total: PreviewPixels = (1 - len(lights)) * _with_only(blender_scene, lights, None)
    for light in lights:
        total += _with_only(blender_scene, lights, light)
    return total


def _with_only(blender_scene: Any, lights: list[Any], shown: Any) -> PreviewPixels:
    try:
        for light in lights:
            light.hide_render = light is not shown
        return _rendered(blender_scene)
    finally:
        for light in lights:
            light.hide_render = False


def _rendered(blender_scene: Any) -> PreviewPixels:
    bpy.ops.render.render(write_still=True, scene=blender_scene.name)
    return _read_first_channel(blender_scene.render.filepath)


def _middle(pattern: PatternRender) -> SubpixelView:
    """The pixel's middle; Blender's own sampling spreads from there. The lens is a pinhole then."""
    return SubpixelView((0.0, 0.0))


def _show_grey_levels(blender_scene: Any, grey_scale: GreyScale) -> None:
    blender_scene.display_settings.display_device = "sRGB"
    blender_scene.view_settings.view_transform = "Raw"
    blender_scene.view_settings.exposure = math.log2(grey_scale.slope / grey_scale.full_scale)
    blender_scene.view_settings.gamma = 1.0


@contextmanager
def _for_pictures(blender_scene: Any, pattern: PatternRender) -> Iterator[None]:
    """Set the scene to render linear light at one point of every pixel, into a file of floats."""
    cycles, render = blender_scene.cycles, blender_scene.render
    before = [(of, name, getattr(of, name)) for of, name in _changed(blender_scene)]
    try:
        cycles.samples, cycles.filter_width = pattern.settings.samples, 0.01
        render.image_settings.file_format = "OPEN_EXR"
        render.image_settings.color_depth, render.image_settings.exr_codec = "32", "ZIP"
        yield
    finally:
        for of, name, value in before:
            setattr(of, name, value)


def _changed(blender_scene: Any) -> list[tuple[Any, str]]:
    image = blender_scene.render.image_settings
    return [
        *((blender_scene.cycles, name) for name in ("samples", "filter_width")),
        *((image, name) for name in ("file_format", "color_mode", "color_depth", "exr_codec")),
        (blender_scene.render, "filepath"),
    ]


def _read_first_channel(path: str) -> PreviewPixels:
    """The first channel of a picture, row 0 on top."""
    image = bpy.data.images.load(path)
    try:
        image.colorspace_settings.name = "Non-Color"
        columns, rows = image.size
        pixels = np.empty(rows * columns * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    return pixels.reshape(rows, columns, -1)[::-1, :, 0]
