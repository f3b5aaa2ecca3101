"""What the extension adds to the open file: tagged, in a scene of its own, and removed as a whole."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

TAG = "fpplab"  # custom property of all data that the extension has made; its value says what it belongs to

SCENE, RIG, CLOUD, PICTURE = "scene", "rig", "cloud", "picture"  # what tagged data belongs to

NAME = "fpplab"  # name of the extension's scene

_PREVIOUS = "fpplab_previous"


def all_data() -> dict[int, Any]:
    """List every data-block of the open file."""
    kinds = (p.identifier for p in bpy.data.bl_rna.properties if p.type == "COLLECTION")
    return {block.session_uid: block for kind in kinds for block in getattr(bpy.data, kind)}


@contextmanager
def tag_new_data(owner: str) -> Iterator[None]:
    before = set(all_data())
    try:
        yield
    finally:
        for number, block in all_data().items():
            if number not in before:
                block[TAG] = owner


def rig_scene() -> Any:
    return next((scene for scene in bpy.data.scenes if scene.get(TAG) == SCENE), None)


def enter_rig_scene() -> Any:
    """Make the extension's scene unless it is there, and switch the window to it."""
    # The scenes of the file keep their settings like that.
    scene, window = rig_scene(), bpy.context.window
    if scene is None:
        with tag_new_data(SCENE):
            scene = bpy.data.scenes.new(NAME)
        scene[_PREVIOUS] = window.scene.name if window else ""
    if window and window.scene != scene:
        window.scene = scene
    return scene


def remove(*owners: str) -> None:
    """Remove tagged data, but not the scene."""
    bpy.data.batch_remove([block for block in all_data().values() if block.get(TAG) in owners])


def remove_all() -> None:
    """Remove all that the extension has added to the file, and return to the scene before."""
    remove(RIG, CLOUD, PICTURE)
    scene, window = rig_scene(), bpy.context.window
    if scene is None:
        return
    others = [other for other in bpy.data.scenes if other != scene] or [bpy.data.scenes.new("Scene")]
    if window and window.scene == scene:
        window.scene = bpy.data.scenes.get(scene[_PREVIOUS]) or others[0]
    bpy.data.scenes.remove(scene)
