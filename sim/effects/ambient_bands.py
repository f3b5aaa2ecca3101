"""Rolling bands: light of the room that ripples with the mains, in the rows of a rolling shutter.

One lamp may ripple while daylight is steady, so that even light and that of lamps have shares of their own.

Frames at regular intervals see the bands move by the same share of a period from frame to frame; otherwise
they are at another place in each.
"""

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


class AmbientBands(Document):
    """Bands of ambient light that ripples with the mains, in the rows of a rolling shutter."""

    ripple: Annotated[float, Field(ge=0, le=1)]
    """Amplitude, as a share of the light that ripples."""
    even_light_share: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Share of the even ambient light that ripples."""
    lamp_light_share: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Share of the lamps' light that ripples."""
    period_px: Annotated[float, Field(gt=1, le=8e5)]
    """From band to band, in rows of the sensor without binning; far more than it has where all are alike."""
    cycles_per_frame: Annotated[float, Field(ge=-0.5, le=0.5)] | None = None
    """Share of a period by which bands move from frame to frame, for frames at regular intervals; None where
    they are at another place in each frame."""


class BandsField(Document):
    """Of a world file."""

    ambient_bands: AmbientBands | None = None
    """Bands of ambient light and lamps; None where these are steady."""


@dataclass(frozen=True, eq=False, kw_only=True)
class BandsParameters:
    """What a matching may change."""

    ambient_ripple: float = field(
        default=0.0,
        metadata=table_entry(
            "Amplitude of the rolling bands of the room's light, as a share of the light that ripples.",
            "ambient_bands.ripple",
            effect="ambient_ripple",
            reported_at_zero=True,
        ),
    )
    even_light_rippling: float = field(
        default=1.0,
        metadata=table_entry(
            "Share of the even ambient light that ripples.",
            "ambient_bands.even_light_share",
            effect="ambient_ripple",
        ),
    )
    lamp_light_rippling: float = field(
        default=1.0,
        metadata=table_entry(
            "Share of the lamp's light that ripples.",
            "ambient_bands.lamp_light_share",
            effect="ambient_ripple",
        ),
    )
    band_period_px: float = field(
        default=0.0,
        metadata=table_entry(
            "From band to band, in rows of the frame; 0 where there are none.",
            "ambient_bands.period_px",
            effect="ambient_ripple",
            in_binned_px=True,
        ),
    )
    band_advance: float | None = field(
        default=None,
        metadata=table_entry(
            "Periods by which bands move from frame to frame; None: another place in each frame.",
            "ambient_bands.cycles_per_frame",
            effect="ambient_ripple",
            reported_none="another in each frame",
        ),
    )


class RollingBands(Effect[BandsField]):
    """Light on the mains in the rows of a rolling shutter."""

    name = "rolling bands"
    explains = "light on the mains in the rows of a rolling shutter"
    order = 40
    parameters = BandsParameters
    strength = ("ambient_ripple",)
    world_fields = BandsField
    varies = True

    @override
    def clear(self, data: dict[str, Any]) -> None:
        data["ambient_bands"] = None

    @override
    def changes_light(self, world: EffectWorld) -> bool:
        bands = self.own(world).ambient_bands
        return bands is not None and bands.ripple > 0 and world.has_room_light

    @override
    def light_change(
        self, world: EffectWorld, frame: FrameOfSequence, rows: NDArray[np.intp], random: np.random.Generator
    ) -> LightChange:
        bands, phase = self.own(world).ambient_bands, random.uniform()
        if bands is None:
            return LightChange()
        if bands.cycles_per_frame is not None:
            # 1 separates the random number of where bands begin from those of other effects.
            start = float(np.random.default_rng([world.seed, *frame.sequence, 1]).uniform())
            phase = start + bands.cycles_per_frame * frame.number
        period = bands.period_px / world.camera.binning
        wave = bands.ripple * np.sin(2 * np.pi * (rows / period + phase))
        return LightChange(
            room=1.0 + bands.even_light_share * wave, lamps=1.0 + bands.lamp_light_share * wave
        )

    @override
    def propose(self, at: StepContext[ParametersT]) -> ParametersT:
        ripple = at.room_ripple()
        if ripple is None:
            return at.parameters.with_effect(BandsParameters(), ambient_ripple=0.0, band_period_px=0.0)
        amplitude = min(ripple.amplitude, 1.0)
        return at.parameters.with_effect(
            BandsParameters(
                ambient_ripple=amplitude,
                even_light_rippling=float(ripple.source != "lamps"),
                lamp_light_rippling=float(ripple.source != "even"),
                band_period_px=ripple.period_px,
                band_advance=ripple.advance,
            ),
            ambient_ripple=amplitude * ripple.amplitude_sigma,
            band_period_px=ripple.period_px * ripple.period_sigma,
        )
