"""Fringe patterns of a plan: the images that a projector is asked to show."""

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Lattice, full_scale
from fpplab.patterns.fringe_sets import MAX_PATTERN_BITS
from fpplab.patterns.plan import Plan

Level = TypeVar("Level", bound=np.generic)


@dataclass(frozen=True, eq=False)
class Pattern:
    """One image for a projector."""

    id: str  # names the pattern in frames and journals
    image: NDArray[np.uint8]  # grey levels [row
    bit_depth: int = MAX_PATTERN_BITS  # bits per mirror that the projector shows
    led: str | None = None  # colour of the one LED that lights it; None for all that are on


def quantise(level: NDArray[np.float64], bit_depth: int = MAX_PATTERN_BITS) -> NDArray[np.uint8]:
    """Round levels to the nearest grey level of a projector."""
    greys = full_scale(bit_depth)
    return np.asarray(np.rint(np.rint(level * greys) * (255.0 / greys)), np.uint8)


def pattern_image(
    plan: Plan, index: int, step: int, size: tuple[int, int], lattice: Lattice
) -> NDArray[np.uint8]:
    # It is corrected for the plan's response before it is quantised, so that each grey level is the nearest
    # to the light that is wanted.
    # returns (height, width)
    shown, (width, height) = plan.sets[index], size
    # Along x two rows hold all there is, on either lattice; along y one column does.
    repeated = (1, height) if shown.coded_axis == "y" else (width, min(height, 2))
    level = shown.level(step, repeated, lattice)
    light = level if plan.response is None else plan.response.correct(level)
    if shown.bit_depth < MAX_PATTERN_BITS:
        from fpplab.patterns.dither import diffuse

        light = diffuse(_over_projector(light, size), full_scale(shown.bit_depth), lattice, step)
    return _over_projector(quantise(light, shown.bit_depth), size)


def _over_projector(repeated: NDArray[Level], size: tuple[int, int]) -> NDArray[Level]:
    width, height = size
    if repeated.shape[1] < width:
        return np.repeat(repeated, width, axis=1)
    return np.resize(repeated, (height, width))


def make_patterns(plan: Plan, size: tuple[int, int], lattice: Lattice) -> tuple[Pattern, ...]:
    # A plan with a response gives the patterns whose light is sinusoidal, see `pattern_image`. The same
    # arguments give the same, read-only, patterns again, so that a backend can tell them by identity.
    plan.check_projector(size, "plan")
    return _make_patterns_cached(plan, size, lattice)


@lru_cache(maxsize=4)
def _make_patterns_cached(plan: Plan, size: tuple[int, int], lattice: Lattice) -> tuple[Pattern, ...]:
    patterns = []
    for i, n, name in plan.steps():
        image = pattern_image(plan, i, n, size, lattice)
        image.flags.writeable = False
        shown = plan.sets[i]
        patterns.append(Pattern(name, image, shown.bit_depth, shown.one_led))
    return tuple(patterns)


def uniform_patterns(
    greys: list[int], size: tuple[int, int], bit_depth: int = MAX_PATTERN_BITS
) -> list[Pattern]:
    """Make uniform grey-level images, for measuring the response and for alignment."""
    width, height = size
    return [Pattern(f"grey-{g:03d}", np.full((height, width), g, np.uint8), bit_depth) for g in greys]
