"""The devices that Cycles computes on."""

from typing import Any

import bpy

from ..scene import RenderRefused

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
