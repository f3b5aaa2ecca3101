"""A preview as a scene in Blender: built, set up for viewing, and rendered as the twin's camera sees it."""

from __future__ import annotations

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

VIEWING_SAMPLES = 16
"""Light paths for each pixel of the rendered view."""

PreviewPixels = NDArray[np.float32]
"""Pictures (height, width)."""


def show_preview(stage: Any, preview: Preview) -> None:
    """Add camera, projector and item to a scene in Blender that holds none, and set it up for viewing.

    The rendered view then shows grey levels over full scale, but for the sensor's black level.
    """
    pattern = preview.render
    camera = add_scene(stage, pattern.scene, pattern.textures, compile_shader(), pattern.ambient)
    add_room_lamps(stage, pattern.room_lamps)
    aim(camera, pattern.scene.camera, _middle(pattern))
    make_linear(stage, pattern.settings)
    stage.cycles.device = "CPU" if pattern.settings.device == "CPU" else "GPU"
    stage.cycles.samples = stage.cycles.preview_samples = VIEWING_SAMPLES * pattern.settings.samples
    stage.cycles.filter_width = 1.0
    stage.cycles.use_preview_denoising = stage.cycles.use_preview_adaptive_sampling = False
    _show_grey_levels(stage, preview.grey_scale)
    stage.unit_settings.system, stage.unit_settings.scale_length = "METRIC", 1e-3
    stage.unit_settings.length_unit = "MILLIMETERS"


def take_picture(stage: Any, preview: Preview) -> PreviewPixels:
    """Render what the twin's camera sees on average, without noise, through the twin's own sub-pixels."""
    # returns (height, width)
    pattern = preview.render
    left, top, right, bottom = pattern.scene.window
    width, height = pattern.scene.camera.size
    irradiance = np.zeros((height, width), np.float32)
    seen = irradiance[top:bottom, left:right]
    if seen.size:
        with _for_pictures(stage, pattern), tempfile.TemporaryDirectory(prefix="fpplab-") as folder:
            stage.render.filepath = str(Path(folder) / "view.exr")
            for view in pattern.views:
                aim(stage.camera.data, pattern.scene.camera, view)
                seen += _under_all_lights(stage)
            aim(stage.camera.data, pattern.scene.camera, _middle(pattern))
        seen /= np.float32(len(pattern.views))
    if pattern.falloff is not None:
        irradiance *= pattern.falloff
    return preview.grey_scale.levels(irradiance)


def _under_all_lights(stage: Any) -> PreviewPixels:
    """Add up pictures under one light each, since Cycles takes one of several at random for each sample.

    Each of them holds what glows by itself, which must count once.
    """
    lights = [light for light in stage.objects if light.type == "LIGHT"]
    if len(lights) == 1:
        return _rendered(stage)
    total: PreviewPixels = (1 - len(lights)) * _with_only(stage, lights, None)
    for light in lights:
        total += _with_only(stage, lights, light)
    return total


def _with_only(stage: Any, lights: list[Any], shown: Any) -> PreviewPixels:
    try:
        for light in lights:
            light.hide_render = light is not shown
        return _rendered(stage)
    finally:
        for light in lights:
            light.hide_render = False


def _rendered(stage: Any) -> PreviewPixels:
    bpy.ops.render.render(write_still=True, scene=stage.name)
    return _red(stage.render.filepath)


def _middle(pattern: PatternRender) -> SubpixelView:
    """The pixel's middle; Blender's own sampling spreads from there. The lens is a pinhole then."""
    return SubpixelView((0.0, 0.0))


def _show_grey_levels(stage: Any, grey_scale: GreyScale) -> None:
    stage.display_settings.display_device = "sRGB"
    stage.view_settings.view_transform = "Raw"
    stage.view_settings.exposure = math.log2(grey_scale.slope / grey_scale.full_scale)
    stage.view_settings.gamma = 1.0


@contextmanager
def _for_pictures(stage: Any, pattern: PatternRender) -> Iterator[None]:
    """Set the scene to render linear light at one point of every pixel, into a file of floats."""
    cycles, render = stage.cycles, stage.render
    before = [(of, name, getattr(of, name)) for of, name in _changed(stage)]
    try:
        cycles.samples, cycles.filter_width = pattern.settings.samples, 0.01
        render.image_settings.file_format = "OPEN_EXR"
        render.image_settings.color_depth, render.image_settings.exr_codec = "32", "ZIP"
        yield
    finally:
        for of, name, value in before:
            setattr(of, name, value)


def _changed(stage: Any) -> list[tuple[Any, str]]:
    image = stage.render.image_settings
    return [
        *((stage.cycles, name) for name in ("samples", "filter_width")),
        *((image, name) for name in ("file_format", "color_mode", "color_depth", "exr_codec")),
        (stage.render, "filepath"),
    ]


def _red(path: str) -> PreviewPixels:
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
