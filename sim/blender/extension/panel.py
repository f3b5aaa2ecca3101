"""The panel in the sidebar of the 3D view."""

from typing import Any

import bpy

from .settings import rig_summary, settings_of


class RigPanel(bpy.types.Panel):  # type: ignore[misc]
    """Everything that the extension does, from top to bottom in the order of a measurement."""

    bl_idname = "FPPLAB_PT_rig"
    bl_label = "fpplab"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "fpplab"

    def draw(self, context: Any) -> None:
        settings, summary = settings_of(context), rig_summary()
        shown = self._box(
            settings, "Rig", "rig", "item", "pose", "axis", "stripes", "steps", "step", "baseline", "exposure"
        )
        if summary:
            low, high = summary["baseline_range_mm"]
            shown.label(text=f"Baseline {summary['baseline_mm']:.2f} mm of {low:.1f} to {high:.1f}")
            shown.label(
                text=f"Poses 0 to {summary['poses'] - 1}, camera {summary['size'][0]} x {summary['size'][1]}"
            )
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
