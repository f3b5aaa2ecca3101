"""Flicker: the projector's light has another factor in each frame."""

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from typing_extensions import override

from fpplab.core.config import Document
from sim.effects.base import Effect, EffectWorld, FrameOfSequence, LightChange
from sim.effects.step import ParametersT, StepContext
from sim.parameter_entry import table_entry


class FlickerField(Document):
    """Of the section `projector`."""

    flicker: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """Standard deviation of the light from frame to frame, relative."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FlickerParameter:
    """What a matching may change."""

    projector_flicker: float = field(
        default=0.0,
        metadata=table_entry(
            "Standard deviation of the projector's light from frame to frame, relative.", "projector.flicker"
        ),
    )


class Flicker(Effect[FlickerField]):
    """Light of the projector that changes from frame to frame."""

    name = "flicker"
    explains = "light of the projector that changes from frame to frame"
    order = 30
    parameters = FlickerParameter
    strength = ("projector_flicker",)
    projector_fields = FlickerField
    varies = True

    @override
    def clear(self, data: dict[str, Any]) -> None:
        data["projector"]["flicker"] = 0.0

    @override
    def changes_light(self, world: EffectWorld) -> bool:
        return self.own(world.projector).flicker > 0

    @override
    def light_change(
        self, world: EffectWorld, frame: FrameOfSequence, rows: NDArray[np.intp], random: np.random.Generator
    ) -> LightChange:
        flicker = self.own(world.projector).flicker
        return LightChange(projector=1.0 + flicker * random.standard_normal())

    @override
    def propose(self, at: StepContext[ParametersT]) -> ParametersT:
        change = at.fluctuation("projector", oscillates=False)
        flicker = change.random.isotropic
        return at.parameters.with_effect(
            FlickerParameter(projector_flicker=flicker), projector_flicker=flicker * change.sigma
        )
