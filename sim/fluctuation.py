"""What changes from frame to frame, by all effects of a world together: light, and the place of the item.

The random numbers of a frame's light follow from the world's seed and the number of the frame; all effects
draw from them, one after another in their order. Pictures of the item at rest and displaced along each axis
once serve any number of frames, since displacements are a small part of a pixel: to first order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from sim.build import SceneState
from sim.effects import EFFECTS, FrameOfSequence
from sim.light import Light, PatternLevels, ShownPattern
from sim.world import World


@dataclass(frozen=True)
class Fluctuation:
    """How light changes from frame to frame."""

    world: World
    sequence: tuple[int, ...]  # numbers of the sequence of frames; none on a bench

    @classmethod
    def of(cls, world: World, *numbers: int) -> Fluctuation | None:
        """Take the changes of light from a world; None where light is steady."""
        return cls(world, numbers) if any(effect.changes_light(world) for effect in EFFECTS) else None

    def in_whole_frames(
        self, light: Light, setup: SceneState
    ) -> Callable[[PatternLevels, int], PatternLevels]:
        """Give the function that changes a picture of a set-up, by the number of its frame."""
        room_light, lamp_share = light.irradiance(setup, None), light.lamp_share(setup)
        rows = np.arange(len(room_light))
        return lambda picture, frame: self.applied(picture, room_light, lamp_share, rows, frame)

    def applied(
        self,
        picture: PatternLevels,
        room_light: PatternLevels,
        lamp_share: PatternLevels | np.float32,
        rows: NDArray[np.intp],
        frame: int,
    ) -> PatternLevels:
        """Change a picture; `lamp_share` of `room_light`, its part without the projector, is by lamps."""
        # picture (R, width); rows (R,); returns (R, width)
        # 1 separates the random numbers of light from those of displacements.
        random = np.random.default_rng([self.world.seed, frame, 1])
        of = FrameOfSequence(frame, self.sequence)
        projector = 1.0
        even, lamps = np.ones((2, len(rows)))
        for effect in EFFECTS:
            change = effect.light_change(self.world, of, rows, random)
            projector *= change.projector
            even = even * change.room
            lamps = lamps * (change.room if change.lamps is None else change.lamps)
        changed: PatternLevels = np.float32(projector) * (picture - room_light)
        even, more = (factors.astype(np.float32)[:, None] for factors in (even, lamps - even))
        changed += (even + more * lamp_share) * room_light
        return np.maximum(changed, 0, out=changed)


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
