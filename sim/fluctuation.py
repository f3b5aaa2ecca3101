"""Light that changes from frame to frame: flicker of the projector, and rolling bands of light on the mains.

The projector's light has another factor in each frame. Light of the room that ripples with the mains makes
bands in the rows of a rolling shutter. Frames at regular intervals see them move by the same share of a
period from frame to frame; otherwise they are at another place in each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.light import PatternLevels
from sim.world import World

STREAM = 1
"""Tells the random numbers of these changes from those of vibration."""


@dataclass(frozen=True)
class Fluctuation:
    """How light changes from frame to frame."""

    flicker: float  # standard deviation of the projector's light, relative
    ripple: float  # amplitude of the ripple of the room's light, as a share of it
    period: float  # rows of the frame from band to band
    seed: int  # of the random numbers
    advance: float | None = None  # periods by which bands move from frame to frame
    start: float = 0.0  # where those that move begin, in periods

    @classmethod
    def of(cls, world: World, *numbers: int) -> Fluctuation | None:
        """Take the changes of light from a world."""
        bands, flicker = world.ambient_bands, world.projector.flicker
        ripple = bands.ripple if bands and world.has_room_light else 0.0
        if not (flicker or ripple):
            return None
        period = bands.period_px / world.camera.binning if bands else 1.0
        start = float(np.random.default_rng([world.seed, *numbers, STREAM]).uniform())
        advance = bands.cycles_per_frame if bands else None
        return cls(flicker, ripple, period, world.seed, advance, start)

    def applied(
        self, picture: PatternLevels, ambient: PatternLevels, rows: NDArray[np.intp], frame: int
    ) -> PatternLevels:
        """Change the light of one frame."""
        # picture (R, width); rows (R,); returns (R, width)
        random = np.random.default_rng([self.seed, frame, STREAM])
        factor, phase = 1.0 + self.flicker * random.standard_normal(), random.uniform()
        if self.advance is not None:
            phase = self.start + self.advance * frame
        wave = 1.0 + self.ripple * np.sin(2 * np.pi * (rows / self.period + phase))
        changed: PatternLevels = np.float32(factor) * (picture - ambient)
        changed += wave.astype(np.float32)[:, None] * ambient
        return np.maximum(changed, 0, out=changed)
