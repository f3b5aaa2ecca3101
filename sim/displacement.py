"""An item that effects displace from frame to frame, and what the camera sees of it, to first order.

Pictures of the item at rest and displaced along each axis once serve any number of frames; otherwise every
frame would need a render of its own. Displacements are a small part of a pixel.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from sim.build import SceneState
from sim.effects import EFFECTS, FrameOfSequence
from sim.light import Light, PatternLevels, ShownPattern
from sim.world import World


def displacement_mm(world: World, random: np.random.Generator, number: int, *sequence: int) -> Floats:
    """Draw by how much all effects displace the item in a frame; sequence: numbers of what it belongs to."""
    # returns (3,) mm
    frame = FrameOfSequence(number, sequence)
    moves = [effect.displacement_mm(world, frame, random) for effect in EFFECTS]
    return np.asarray(np.sum(moves, axis=0))


def displaced(setup: SceneState, pose: RigidTransform, step_mm: float) -> tuple[SceneState, ...]:
    """Displace the item of a set-up along each of the camera's axes."""
    # Callers should reuse the result for later frames, because `Light` caches pictures by these set-ups.
    return tuple(replace(setup, held=pose.moved(step_mm * axis)) for axis in np.eye(3))


def displaced_irradiance(
    light: Light,
    still: SceneState,
    moved: Sequence[SceneState],
    steps: Floats,
    show: ShownPattern | None,
    row_weights: Floats | None = None,
) -> PatternLevels:
    """Compute the irradiance of a displaced item to first order, from pictures of four set-ups."""
    # steps (3,); returns (height, width)
    picture = np.float32(1 - steps.sum()) * light.irradiance(still, show, row_weights)
    for step, place in zip(steps.tolist(), moved, strict=True):
        picture += np.float32(step) * light.irradiance(place, show, row_weights)
    return np.maximum(picture, 0, out=picture)
