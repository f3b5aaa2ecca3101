"""The panel in the sidebar of the 3D view."""

from typing import Any

import bpy

from .settings import settings_of, told_of_rig


class RigPanel(bpy.types.Panel):  # type: ignore[misc]
    """Everything that the extension does, from top to bottom in the order of a measurement."""

    bl_idname = "FPPLAB_PT_rig"
    bl_label = "fpplab"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "fpplab"

    def draw(self, context: Any) -> None:
        """Draw the panel."""
        settings, told = settings_of(context), told_of_rig()
        shown = self._box(
            settings, "Rig", "rig", "item", "pose", "axis", "stripes", "steps", "step", "baseline", "exposure"
        )
        if told:
            low, high = told["baseline_range_mm"]
            shown.label(text=f"Baseline {told['baseline_mm']:.2f} mm of {low:.1f} to {high:.1f}")
            shown.label(text=f"Poses 0 to {told['poses'] - 1}, camera {told['size'][0]} x {told['size'][1]}")
        shown.operator("fpplab.show_rig")
        shown.operator("fpplab.remove_rig")
        self._box(settings, "Picture", "picture").operator("fpplab.take_picture")
        self._box(settings, "Virtual scan", "session").operator("fpplab.record_scan")
        self._box(settings, "Errors", "cloud", "truth", "align").operator("fpplab.import_errors")
        self._box(settings, "Twin of a bench", "reference", "matched", "epochs").operator("fpplab.fit_twin")

    def _box(self, settings: Any, title: str, *names: str) -> Any:
        box = self.layout.box()
        box.label(text=title)
        for name in names:
            box.prop(settings, name)
        return box
