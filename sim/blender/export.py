"""Write a preview as a .blend file: `python -m sim.blender.export PREVIEW OUT`."""

import sys

import bpy

from sim.blender.preview import show_preview
from sim.preview_file import read_preview


def main(arguments: list[str]) -> None:
    """Build the scene and save it, with its images inside."""
    described, out = arguments
    preview = read_preview(described)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    blender_scene = bpy.context.scene
    blender_scene.name = preview.rig
    show_preview(blender_scene, preview)
    for image in bpy.data.images:
        image.pack()
    bpy.ops.wm.save_as_mainfile(filepath=out, compress=True)


if __name__ == "__main__":
    main(sys.argv[1:])
