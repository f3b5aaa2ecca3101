"""Vibration: the item is displaced from frame to frame, in all directions and along a line.

An oscillation in step with the fringes' phase steps makes ripples of the phase that random displacements of
the same size do not, so it matters how vibration continues from frame to frame.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator
from typing_extensions import override

from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from sim.effects.base import Effect, EffectWorld, FrameOfSequence
from sim.effects.step import FrameFluctuation, ParametersT, StepContext
from sim.parameter_entry import table_entry

MAX_VIBRATION_MM = 10  # greatest displacement by vibration (chosen)

NO_LINE = (0.0, 0.0, 0.0)  # of a vibration that has no direction


class VibrationLine(Document):
    """Vibration to and fro along a line, as of a table; a share of it may have one frequency, as of a fan."""

    rms_mm: tuple[float, float, float]
    """Root mean square displacement along the camera's axes, in mm, with signs that give the direction."""
    periodic: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of the variance that has one frequency; the rest is another in each frame."""
    cycles_per_frame: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """That frequency as the frames sample it; it holds for frames at regular intervals."""

    @field_validator("rms_mm")
    @classmethod
    def _is_small(cls, rms_mm: tuple[float, float, float]) -> tuple[float, float, float]:
        if max(map(abs, rms_mm)) > MAX_VIBRATION_MM:
            raise ValueError(f"is {list(rms_mm)}: must be between -{MAX_VIBRATION_MM} and {MAX_VIBRATION_MM}")
        return rms_mm


class VibrationFields(Document):
    """Of a world file."""

    vibration_mm: Annotated[float, Field(ge=0, le=MAX_VIBRATION_MM)] = 0.0
    """Standard deviation of the item's displacement along each axis from frame to frame, in mm."""
    vibration_line: VibrationLine | None = None
    """Vibration along a line in addition; None where there is none."""


@dataclass(frozen=True, eq=False, kw_only=True)
class VibrationParameters:
    """What a matching may change."""

    vibration_mm: float = field(
        metadata=table_entry(
            "Standard deviation of the item's position from frame to frame in mm, equal in all directions.",
            "vibration_mm",
        )
    )
    vibration_line_mm: tuple[float, float, float] = field(
        default=NO_LINE,
        metadata=table_entry(
            "RMS displacement along the camera's axes in mm by vibration along a line.",
            "vibration_line.rms_mm",
            parts=("vibration_line_x_mm", "vibration_line_y_mm", "vibration_line_z_mm"),
            effect="vibration_line_mm",
        ),
    )
    vibration_periodic: float = field(
        default=0.0,
        metadata=table_entry(
            "Share of the variance of that vibration that has one frequency.",
            "vibration_line.periodic",
            effect="vibration_line_mm",
        ),
    )
    vibration_cycles_per_frame: float = field(
        default=0.0,
        metadata=table_entry(
            "That frequency, as frames at regular intervals sample it, in cycles per frame.",
            "vibration_line.cycles_per_frame",
            effect="vibration_line_mm",
        ),
    )

    @property
    def displacement_mm(self) -> float:
        """RMS displacement of the item along an axis by all of its vibration."""
        return float(np.sqrt(self.vibration_mm**2 + np.mean(np.square(self.vibration_line_mm))))


class Vibration(Effect[VibrationFields]):
    """Displacements of the item from frame to frame."""

    name = "vibration"
    explains = "displacements of the item from frame to frame"
    order = 50
    parameters = VibrationParameters
    strength = ("vibration_mm", "vibration_line_mm")
    world_fields = VibrationFields
    varies = True

    @override
    def clear(self, data: dict[str, Any]) -> None:
        data |= {"vibration_mm": 0.0, "vibration_line": None}

    @override
    def displacement_size_mm(self, world: EffectWorld) -> float:
        own = self.own(world)
        line = own.vibration_line
        return float(np.hypot(own.vibration_mm, np.linalg.norm(line.rms_mm) if line else 0.0))

    @override
    def displacement_mm(
        self, world: EffectWorld, frame: FrameOfSequence, random: np.random.Generator
    ) -> Floats:
        phase = wave_phase(world, *frame.sequence)
        return vibration_displacement_mm(self.own(world), random, frame.number, phase)

    @override
    def propose(self, at: StepContext[ParametersT]) -> ParametersT:
        return with_vibration_of(at.parameters, at.fluctuation("position"))


def vibration_displacement_mm(
    fields: VibrationFields, random: np.random.Generator, frame: float, phase: float
) -> Floats:
    """Draw by how much vibration displaces the item in one frame."""
    # returns (3,) mm
    moved, line = fields.vibration_mm * random.standard_normal(3), fields.vibration_line
    if line is None:
        return moved
    swing = np.sqrt(2.0 * line.periodic) * np.sin(2 * np.pi * (line.cycles_per_frame * frame + phase))
    alone = np.sqrt(1.0 - line.periodic) * random.standard_normal()
    return np.asarray(moved + (swing + alone) * np.array(line.rms_mm))


def wave_phase(world: EffectWorld, *numbers: int) -> float:
    """Draw where a vibration of one frequency begins."""
    # 2 separates the random numbers of phases from those of other effects.
    return float(np.random.default_rng([world.seed, *numbers, 2]).uniform())


def with_vibration_of(now: ParametersT, change: FrameFluctuation) -> ParametersT:
    """Give a twin the vibration by which a bench's item was displaced."""
    line, oscillation = _rms_along_line(change), change.oscillation
    x, y, z = line.tolist()
    variance = float(line @ line)
    vibration = VibrationParameters(
        vibration_mm=change.random.isotropic,
        vibration_line_mm=(x, y, z) if variance else NO_LINE,
        vibration_periodic=min(float(oscillation @ oscillation) / variance, 1.0) if variance else 0.0,
        vibration_cycles_per_frame=change.cycles_per_frame,
    )
    return now.with_effect(
        vibration,
        vibration_mm=change.random.isotropic * change.sigma,
        vibration_cycles_per_frame=change.cycles_sigma,
    )


def _rms_along_line(change: FrameFluctuation) -> Floats:
    """RMS displacement (3,) along the line, of random numbers and oscillation together."""
    random, oscillation = change.random.axis, change.oscillation
    whole = np.outer(random, random) + np.outer(oscillation, oscillation)
    strength, directions = np.linalg.eigh(whole)
    return np.asarray(np.sqrt(max(float(strength.sum()), 0.0)) * directions[:, -1])
