"""What the panel lets an operator choose."""

from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ...preview_file import Preview

_shown: dict[str, Any] = {}
"""What is shown, and fpplab's summary of its rig; until the extension or Blender ends."""


def remember(preview: Preview, summary: dict[str, Any]) -> None:
    """Remember what is shown, without its textures, which are in the scene."""
    render = replace(preview.render, textures=np.zeros((0, 0, 0), np.float32))
    _shown.update(preview=replace(preview, render=render), summary=summary)


def shown_preview() -> Preview | None:
    return _shown.get("preview")


def rig_summary() -> dict[str, Any]:
    """Give fpplab's summary of the rig on show."""
    return dict(_shown.get("summary", {}))


def forget_shown() -> None:
    _shown.clear()


def _items(settings: Any, context: Any, typed: str) -> list[str]:
    return [name for name in rig_summary().get("items", []) if typed.lower() in name.lower()]


class RigSettings(bpy.types.PropertyGroup):  # type: ignore[misc]
    """Settings of the panel, kept while Blender runs."""

    # Blender reads properties from annotations.
    __annotations__ = {
        "rig": StringProperty(
            name="Rig",
            description="Rig file of a simulation or of a matched twin, or the name of one of fpplab's own",
            default="rig_demo",
            subtype="FILE_PATH",
        ),
        "item": StringProperty(
            name="Item", description="What is measured; empty for what is mounted at first", search=_items
        ),
        "pose": IntProperty(name="Pose", description="Number of the item's pose", min=0),
        "axis": EnumProperty(
            name="Axis",
            description="Axis of the projector along which the phase rises",
            items=[("x", "x", "Vertical stripes"), ("y", "y", "Horizontal stripes")],
        ),
        "stripes": FloatProperty(
            name="Stripes", description="Periods across the projector's image", default=64.0, min=0.5
        ),
        "steps": IntProperty(name="Steps", description="Images of the phase shift", default=12, min=3),
        "step": IntProperty(name="Step on show", description="Which of the images is shown", min=0),
        "baseline": FloatProperty(
            name="Baseline (mm)",
            description="Distance of the projector from the camera; 0 leaves the stage at its zero",
            min=0.0,
            precision=2,
        ),
        "exposure": FloatProperty(
            name="Exposure (ms)", description="Exposure of every frame", default=20.0, min=0.01
        ),
        "picture": StringProperty(
            name="Picture", description="PNG file that a picture is also saved to", subtype="FILE_PATH"
        ),
        "session": StringProperty(
            name="Session", description="Folder that a virtual scan is recorded into", subtype="DIR_PATH"
        ),
        "cloud": StringProperty(name="Cloud", description="Measured points", subtype="FILE_PATH"),
        "truth": StringProperty(
            name="True shape", description="Mesh of the true shape: .stl, .ply or .obj", subtype="FILE_PATH"
        ),
        "align": BoolProperty(
            name="Align", description="Move the true shape onto the cloud first", default=True
        ),
        "reference": StringProperty(
            name="Recordings", description="Folder of the bench's sessions of a board", subtype="DIR_PATH"
        ),
        "matched": StringProperty(
            name="Matched twin", description="Folder for the matched twin", subtype="DIR_PATH"
        ),
        "epochs": IntProperty(name="Epochs", description="Maximum number of epochs", default=25, min=1),
    }


def attach_settings() -> None:
    bpy.types.WindowManager.fpplab = PointerProperty(type=RigSettings)


def detach_settings() -> None:
    """Take the settings and their values out again."""
    forget_shown()
    for manager in bpy.data.window_managers:
        manager.property_unset("fpplab")
    del bpy.types.WindowManager.fpplab


def settings_of(context: Any) -> Any:
    return context.window_manager.fpplab
