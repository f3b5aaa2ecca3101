"""The extension's preferences: the Python that has fpplab."""

from typing import Any

import bpy
from bpy.props import StringProperty

from .jobs import JobFailedError

ROOT = __package__.removesuffix(".sim.blender.extension")  # name under which Blender has loaded the archive


class ExtensionPreferences(bpy.types.AddonPreferences):  # type: ignore[misc]
    """What the preferences show under the extension's name."""

    bl_idname = ROOT
    # Blender reads properties from annotations.
    __annotations__ = {
        "interpreter": StringProperty(
            name="Python with fpplab",
            description="The interpreter of the environment that fpplab is installed in: python3, python.exe",
            subtype="FILE_PATH",
        )
    }

    def draw(self, context: Any) -> None:
        self.layout.prop(self, "interpreter")


def interpreter_of(context: Any) -> str:
    named: str = bpy.path.abspath(context.preferences.addons[ROOT].preferences.interpreter)
    if not named:
        raise JobFailedError(
            "no Python with fpplab is named; name it in Edit > Preferences > Add-ons > fpplab"
        )
    return named
