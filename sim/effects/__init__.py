"""Effects of the twin, one module each; a module that is added here is found by listing the package.

A module owns all there is of its effect; see `sim.effects.base.Effect`. World files and the table of
parameters have the fields of all effects, in their order.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import create_model

from fpplab.core.config import Document
from fpplab.core.tagged_union import concrete_subclasses, import_members
from sim.effects.base import Effect, FrameOfSequence, LightChange

import_members(__name__, __path__)

EFFECTS: tuple[Effect[Document], ...] = tuple(
    sorted((member() for member in concrete_subclasses(Effect)), key=lambda member: member.order)  # type: ignore[type-abstract]
)
"""All effects, in their order."""


def _joined(name: str, parts: list[type[Document] | None]) -> type[Document]:
    """A model with the fields of all parts; the last base class of a class has its first fields."""
    bases = tuple(reversed([part for part in parts if part is not None]))
    return create_model(name, __base__=bases or Document, __module__=__name__)


if TYPE_CHECKING:  # effects that other modules read fields of, for type checkers alone
    from sim.effects.ambient_bands import BandsField, BandsParameters
    from sim.effects.falloff import FalloffField, FalloffParameter
    from sim.effects.flicker import FlickerField, FlickerParameter
    from sim.effects.point_errors import PointErrorsField, PointErrorsParameters
    from sim.effects.room_lamp import LampParameters, LampsField
    from sim.effects.vibration import VibrationFields, VibrationParameters

    class ProjectorEffects(FlickerField, FalloffField):
        """Fields of the section `projector` of a world file."""

    class WorldEffects(PointErrorsField, VibrationFields, BandsField, LampsField):
        """Fields of a world file."""

    @dataclass(frozen=True, eq=False, kw_only=True)
    class EffectParameters(
        PointErrorsParameters,
        VibrationParameters,
        BandsParameters,
        FlickerParameter,
        LampParameters,
        FalloffParameter,
    ):
        """Parameters of all effects."""

else:
    ProjectorEffects = _joined("ProjectorEffects", [effect.projector_fields for effect in EFFECTS])
    WorldEffects = _joined("WorldEffects", [effect.world_fields for effect in EFFECTS])
    _parameters: tuple[type[Any], ...] = tuple(effect.parameters for effect in reversed(EFFECTS))
    EffectParameters = dataclass(frozen=True, eq=False, kw_only=True)(
        type("EffectParameters", _parameters, {})
    )

__all__ = [
    "EFFECTS",
    "Effect",
    "EffectParameters",
    "FrameOfSequence",
    "LightChange",
    "ProjectorEffects",
    "WorldEffects",
]
