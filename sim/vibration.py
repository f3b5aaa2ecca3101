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
from sim.build import SceneState
from sim.light import Light, PatternLevels, ShownPattern
from sim.world import World

STREAM = 2
"""Separates the random numbers of phases from those of other changes."""


def displacement_mm(world: World, random: np.random.Generator, frame: float, phase: float) -> Floats:
    """Draw by how much vibration displaces the item in one frame."""
    # returns (3,) mm
    moved, line = world.vibration_mm * random.standard_normal(3), world.vibration_line
    if line is None:
        return moved
    swing = np.sqrt(2.0 * line.periodic) * np.sin(2 * np.pi * (line.cycles_per_frame * frame + phase))
    alone = np.sqrt(1.0 - line.periodic) * random.standard_normal()
    return np.asarray(moved + (swing + alone) * np.array(line.rms_mm))


def wave_phase(world: World, *numbers: int) -> float:
    """Draw where a vibration of one frequency begins."""
    return float(np.random.default_rng([world.seed, *numbers, STREAM]).uniform())


def displaced(setup: SceneState, pose: RigidTransform, step_mm: float) -> tuple[SceneState, ...]:
    """Displace the item of a set-up along each of the camera's axes.

    Callers should reuse the result for later frames, because `Light` caches pictures by these set-ups.
    """
    return tuple(replace(setup, held=pose.moved(step_mm * axis)) for axis in np.eye(3))


def with_vibration(
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
