"""The Blender extension: a simulated rig in the scene, its scans, its clouds, and twins of real benches."""

import bpy

from . import data, jobs
from .operators import OPERATORS
from .panel import RigPanel
from .preferences import ExtensionPreferences
from .settings import RigSettings, attach_settings, detach_settings

CLASSES = (ExtensionPreferences, RigSettings, *OPERATORS, RigPanel)


def register() -> None:
    for class_ in CLASSES:
        bpy.utils.register_class(class_)
    attach_settings()


def unregister() -> None:
    """Take everything out again: running commands, what was added to the file, and the classes."""
    jobs.end_all()
    data.remove_all()
    detach_settings()
    for class_ in reversed(CLASSES):
        bpy.utils.unregister_class(class_)
