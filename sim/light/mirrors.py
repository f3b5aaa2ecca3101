"""The light of the projector's mirrors under patterns, and the textures that it becomes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fpplab.core.conventions import full_scale
from fpplab.patterns.fringes import Pattern
from sim.effects import EFFECTS
from sim.light.basis import Basis, PatternLevels, smallest_basis
from sim.light.cache import ByteLimitedCache
from sim.texture import MirrorTexture, Part, PatternTextures
from sim.world import ProjectorWorld

KEPT_BYTES = 1 << 27  # of the light of mirrors that is kept: of 32 patterns (chosen)
TEXTURE_BYTES = 1 << 26  # of textures that are kept: of what six poses are compared by (chosen)


@dataclass(frozen=True, eq=False)
class MirrorStates:
    """Light of the mirrors, relative to the brightest, in each of several states."""

    count: int  # number of states
    of: Callable[[int], PatternLevels]  # gives the light of one state, (rows, columns) float32
    rounding: float  # RMS of the quantisation error of the light


def product_of_mirror_effects(projector: ProjectorWorld) -> PatternLevels | None:
    """Factor by which all effects together change the light of each mirror; None where they do nothing."""
    # returns (rows, columns)
    product: PatternLevels | None = None
    for effect in EFFECTS:
        factor = effect.mirror_light(projector)
        if factor is not None:
            product = factor if product is None else product * factor
    return product


class Mirrors:
    """Mirrors of a projector, with its response and the effects on each mirror."""

    def __init__(self, projector: ProjectorWorld) -> None:
        self._projector, self._factor = projector, product_of_mirror_effects(projector)
        self._kept: ByteLimitedCache[PatternLevels] = ByteLimitedCache(KEPT_BYTES)
        self._textures: ByteLimitedCache[PatternTextures] = ByteLimitedCache(TEXTURE_BYTES)
        self._loaded: tuple[tuple[Pattern, ...], MirrorStates] | None = None
        self._planes: tuple[Pattern, MirrorStates] | None = None
        self._basis: tuple[MirrorStates, Basis] | None = None

    def level(self, pattern: Pattern) -> PatternLevels:
        # returns (rows, columns)
        return self._kept.get(pattern, lambda: self._with_effects(self._even(pattern)))

    def textures(
        self, patterns: Sequence[Pattern], texture: MirrorTexture, circles: tuple[float, ...], part: Part
    ) -> PatternTextures:
        """Make the textures of patterns, or take those of last time."""
        return self._textures.get(
            (tuple(patterns), texture, circles, part),
            lambda: texture.textures([self.level(pattern) for pattern in patterns], circles, part),
        )

    def states(self, patterns: tuple[Pattern, ...]) -> MirrorStates:
        if self._loaded is None or self._loaded[0] is not patterns:
            response = self._projector.response
            depth = min(p.bit_depth for p in patterns)
            steepest = 255.0 * float(np.diff(response.shape(np.arange(256) / 255)).max())
            rounding = response.a * max(steepest, 1.0) / (np.sqrt(12) * full_scale(depth))
            self._loaded = (
                patterns,
                MirrorStates(len(patterns), lambda n: self.level(patterns[n]), rounding),
            )
        return self._loaded[1]

    def planes(self, pattern: Pattern) -> MirrorStates:
        """Give the light that closed mirrors leak, and that of the binary planes of a pattern."""
        if self._planes is None or self._planes[0] is not pattern:
            response, bits = self._projector.response, pattern.bit_depth
            greys = full_scale(bits)
            codes = np.rint((self._even(pattern) - response.b) / response.a * greys).astype(np.int64)

            def of(n: int) -> PatternLevels:
                if n == 0:
                    return self._with_effects(np.full(codes.shape, response.b, np.float32))
                bit = n - 1
                share = np.asarray((codes >> bit & 1) * (response.a * 2**bit / greys), np.float32)
                return self._with_effects(share)

            self._planes = (pattern, MirrorStates(bits + 1, of, 0.0))
        return self._planes[1]

    def basis(self, levels: MirrorStates) -> Basis:
        if self._basis is None or self._basis[0] is not levels:
            basis = smallest_basis(np.stack([levels.of(n) for n in range(levels.count)]), levels.rounding)
            self._basis = (levels, basis)
        return self._basis[1]

    def inherit(self, other: Mirrors) -> None:
        """Take over what other mirrors keep, where their light is the same."""
        if self._projector.response == other._projector.response and _equal(self._factor, other._factor):
            self._kept.take(other._kept)
            self._textures.take(other._textures)

    def forget(self) -> None:
        self._kept.clear()
        self._textures.clear()
        self._loaded = self._planes = self._basis = None

    def _even(self, pattern: Pattern) -> PatternLevels:
        table = self._projector.response.apply(np.linspace(0, 1, 256))
        return table.astype(np.float32)[pattern.image]

    def _with_effects(self, light: PatternLevels) -> PatternLevels:
        return light if self._factor is None else light * self._factor


def _equal(first: PatternLevels | None, second: PatternLevels | None) -> bool:
    if first is None or second is None:
        return first is second
    return np.array_equal(first, second)
