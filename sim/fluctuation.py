"""Light that changes from frame to frame, by all effects of a world together.

The random numbers of a frame's light follow from the world's seed and the number of the frame; all effects
draw from them, one after another in their order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from sim.effects import EFFECTS, FrameOfSequence
from sim.light import PatternLevels
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

    def applied(
        self, picture: PatternLevels, ambient: PatternLevels, rows: NDArray[np.intp], frame: int
    ) -> PatternLevels:
        # picture (R, width); rows (R,); returns (R, width)
        # 1 separates the random numbers of light from those of displacements.
        random = np.random.default_rng([self.world.seed, frame, 1])
        of = FrameOfSequence(frame, self.sequence)
        projector = 1.0
        room: Floats = np.ones(len(rows))
        for effect in EFFECTS:
            change = effect.light_change(self.world, of, rows, random)
            projector *= change.projector
            room = room * change.room
        changed: PatternLevels = np.float32(projector) * (picture - ambient)
        changed += room.astype(np.float32)[:, None] * ambient
        return np.maximum(changed, 0, out=changed)
