"""Falloff of the projector: how much light each mirror gets, relative to the middle of the image."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from fpplab.core.config import Document
from fpplab.core.conventions import Lattice, mirror_centres
from sim.effects.base import Effect, EffectProjector
from sim.effects.step import ParametersT, StepContext
from sim.parameter_entry import FitRange, table_entry

FALLOFF = ("falloff_x", "falloff_y", "falloff_xx", "falloff_xy", "falloff_yy")  # names of the coefficients


class FalloffField(Document):
    """Of the section `projector`."""

    falloff: tuple[float, float, float, float, float] = (0.0,) * 5
    """Coefficients of x, y, x², xy and y² of the light relative to the middle of the image; x and y are from
    there, in halves of the image's width."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FalloffParameter:
    """What a matching may change."""

    projector_falloff: tuple[float, float, float, float, float] = field(
        default=(0.0,) * 5,
        metadata=table_entry(
            "Coefficients of x, y, x², xy and y² of the projector's light over its image.",
            "projector.falloff",
            FitRange(0.02, -2.0, 2.0),
            parts=FALLOFF,
        ),
    )


class ProjectorFalloff(Effect[FalloffField]):
    """Light that the projector gives unevenly."""

    name = "projector falloff"
    explains = "light that the projector gives unevenly"
    order = 10
    parameters = FalloffParameter
    strength = ("projector_falloff",)
    fitted = FALLOFF
    projector_fields = FalloffField

    @override
    def clear(self, data: dict[str, Any]) -> None:
        data["projector"]["falloff"] = [0.0] * 5

    @override
    def mirror_light(self, projector: EffectProjector) -> NDArray[np.float32] | None:
        falloff = self.own(projector).falloff
        return _falloff_over_mirrors(projector.size, projector.lattice, falloff) if any(falloff) else None

    @override
    def propose(self, at: StepContext[ParametersT]) -> ParametersT:
        return at.fit(at.white, "vignetting", *FALLOFF)

    @override
    def misfit(self, at: StepContext[ParametersT]) -> float | None:
        return at.criterion(len(FALLOFF) if self.is_in(at.parameters) else 0)


@lru_cache(maxsize=8)
def _falloff_over_mirrors(
    size: tuple[int, int], lattice: Lattice, coefficients: tuple[float, ...]
) -> NDArray[np.float32]:
    u, v = mirror_centres(size, lattice)
    half = 0.5 * size[0]
    rows_per_column = 2.0 if lattice is Lattice.DIAMOND else 1.0
    x = (u - 0.5 * (size[0] - 1)) / half
    y = (v - 0.5 * (size[1] - 1)) / (rows_per_column * half)
    terms = (x, y, x * x, x * y, y * y)
    light = 1.0 + sum(c * term for c, term in zip(coefficients, terms, strict=True))
    return np.maximum(light, 0.01).astype(np.float32)  # a polynomial may fall below zero, light does not
