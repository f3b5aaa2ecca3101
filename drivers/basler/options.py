"""The section of a Basler camera in a rig file.

camera:
  backend: "drivers.basler:BaslerCamera"
  serial: "21734321"                                # as `fpplab devices` shows it
  bits: 12
  roi: [0, 0, 5472, 3648]                           # offset x, offset y, width, height; all without it
  black_level: 4.0                                  # in the camera's numbers; as it is without it
  packed: true                                      # 12 bits as Mono12p: three quarters of the data
  shutter: rolling                                  # or global_reset, global
  trigger: {line: Line1, edge: rising, delay_us: 0}
  features: camera.pfs                              # loaded first, as pylon's viewer saves it
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from fpplab.core.config import Document

EDGES = {"rising": "RisingEdge", "falling": "FallingEdge"}
SHUTTERS = {
    "rolling": ("Rolling",),
    "global_reset": ("GlobalReset", "GlobalResetRelease"),
    "global": ("Global",),
}
"""The names of a choice in GenICam, those of SFNC 2 first."""

NotNegativeCount = Annotated[int, Field(ge=0)]


class TriggerLine(Document):
    """The line that the trigger pulse comes in on."""

    line: str = "Line1"
    edge: Literal["rising", "falling"] = "rising"
    delay_us: Annotated[float, Field(ge=0)] = 0.0


class BaslerOptions(Document):
    """The camera's section in a rig file, see the module; a camera whose shutter cannot be switched is told
    here what it has.
    """

    serial: str
    roi: (
        tuple[NotNegativeCount, NotNegativeCount, Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]
        | None
    ) = None
    black_level: float | None = None
    packed: bool = False
    shutter: Literal["rolling", "global_reset", "global"] | None = None
    trigger: TriggerLine = TriggerLine()
    features: str | None = None
