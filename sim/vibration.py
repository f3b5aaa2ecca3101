"""An item that trembles: what the camera sees of it, to first order in the displacement.

Pictures of the item at rest and displaced along each axis once serve any number of frames, where every frame
by itself would need a render. Displacements are a small part of a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from sim.build import Setup
from sim.light import Light, PatternLevels, Show


def displaced(setup: Setup, pose: RigidTransform, step_mm: float) -> tuple[Setup, ...]:
    """The item of a set-up, whose pose is T_camera_item, moved by so much along each of the camera's axes.

    To be kept for the next frame: the light keeps pictures by these.
    """
    return tuple(replace(setup, held=pose.moved(step_mm * axis)) for axis in np.eye(3))


def with_vibration(
    light: Light,
    still: Setup,
    moved: Sequence[Setup],
    steps: Floats,
    show: Show | None,
    row_weights: Floats | None = None,
) -> PatternLevels:
    """What `Light.irradiance` gives of the item displaced by `steps` (3,) times what `moved` is."""
    picture = np.float32(1 - steps.sum()) * light.irradiance(still, show, row_weights)
    for step, place in zip(steps.tolist(), moved, strict=True):
        picture += np.float32(step) * light.irradiance(place, show, row_weights)
    return np.maximum(picture, 0, out=picture)
