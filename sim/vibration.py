"""A vibrating item: what the camera sees of it, to first order in the displacement.

Pictures of the item at rest and displaced along each axis once serve any number of frames; otherwise every
frame would need a render of its own. Displacements are a small part of a pixel.
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
    """Displace the item of a set-up along each of the camera's axes.

    Callers should reuse the result for later frames, because `Light` caches pictures by these set-ups.

    Parameters
    ----------
    setup : Setup
        The item at rest.
    pose : RigidTransform
        Its pose T_camera_item in mm.
    step_mm : float
        Displacement along each axis in mm.

    Returns
    -------
    tuple of Setup
        Three, displaced along x, y and z.
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
    """Compute the irradiance of a displaced item to first order, from pictures of four set-ups.

    Parameters
    ----------
    light : Light
        Of the world.
    still : Setup
        The item at rest.
    moved : sequence of Setup
        Three, from `displaced`.
    steps : Floats
        Displacement (3,) as multiples of those in `moved`.
    show : Show or None
        Pattern on show; None where the lamp is off.
    row_weights : Floats or None
        As for `Light.irradiance`.

    Returns
    -------
    PatternLevels
        (height, width), 1 for white, not negative.
    """
    picture = np.float32(1 - steps.sum()) * light.irradiance(still, show, row_weights)
    for step, place in zip(steps.tolist(), moved, strict=True):
        picture += np.float32(step) * light.irradiance(place, show, row_weights)
    return np.maximum(picture, 0, out=picture)
