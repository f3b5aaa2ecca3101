"""What the section of every GenICam camera in a rig file may contain."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fpplab.core.config import Document

EDGES = {"rising": "RisingEdge", "falling": "FallingEdge"}
SHUTTERS = {
    "rolling": ("Rolling", "RollingShutter"),
    "global_reset": ("GlobalReset", "GlobalResetRelease", "GlobalResetShutter"),
    "global": ("Global", "GlobalShutter"),
}
"""The names of a choice in GenICam, those of SFNC 2 first."""

NotNegativeCount = Annotated[int, Field(ge=0)]


class TriggerLine(Document):
    """Input line that receives the hardware trigger."""

    line: str | None = None
    """GenICam name of the line, such as Line1; by default the input of the maker's cameras."""
    edge: Literal["rising", "falling"] = "rising"
    """Edge of the pulse that starts an exposure."""
    delay_us: Annotated[float, Field(ge=0)] = 0.0
    """Delay from the edge to the start of the exposure, in µs."""
    debounce_us: Annotated[float, Field(ge=0)] = 0.0
    """Time in µs for which the line must keep its level to count; it delays the exposure by as much."""


class RawGain(Document):
    """How the integer `GainRaw` of a camera without gain in dB is converted: one of both, by its manual."""

    db_per_step: Annotated[float, Field(gt=0)] | None = None
    """dB for each step of GainRaw, where the gain in dB is proportional to it; 0.0359 for many models."""
    unity: Annotated[float, Field(gt=0)] | None = None
    """GainRaw at 0 dB, where the gain as a factor is proportional to it; 32 for some models."""

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.db_per_step is None) == (self.unity is None):
            raise ValueError("'raw_gain' needs either 'db_per_step' or 'unity'")
        return self


class GenicamOptions(Document):
    """The keys that every GenICam camera has."""

    serial: str
    """Serial number, as `fpplab devices` shows it."""
    roi: (
        tuple[NotNegativeCount, NotNegativeCount, Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]
        | None
    ) = None
    """Region of interest: offset x, offset y, width and height in px; by default the whole sensor."""
    black_level: float | None = None
    """Black level in the camera's own units; by default unchanged."""
    raw_gain: RawGain | None = None
    """Conversion of GainRaw, for a camera that has no gain in dB; without it such a camera has its least gain
    only, which counts as 0 dB, unless the driver knows the conversion of its model."""
    shutter: Literal["rolling", "global_reset", "global"] | None = None
    """Shutter mode to set; for a camera whose shutter cannot be switched, the one that it has."""
    strobe: str | None = None
    """GenICam name of the output that is active during exposures, such as Line2, for plans whose projector
    follows the camera; by default none."""
    accept_raw: tuple[str, ...] = ()
    """Names of features that alter grey levels and that this camera does not switch off: they are accepted as
    they are."""
    packed: bool = False
    """Whether 12-bit frames are transferred packed, as Mono12p or BayerRG12p: three quarters of the data."""
    trigger: TriggerLine = TriggerLine()
    """Line that receives the hardware trigger."""
