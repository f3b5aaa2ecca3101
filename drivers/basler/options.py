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
    """Input line that receives the hardware trigger."""

    line: str = "Line1"
    """GenICam name of the line, such as Line1."""
    edge: Literal["rising", "falling"] = "rising"
    """Edge of the pulse that starts an exposure."""
    delay_us: Annotated[float, Field(ge=0)] = 0.0
    """Delay from the edge to the start of the exposure, in µs."""


class BaslerOptions(Document):
    """The camera's section in a rig file; the module shows an example."""

    serial: str
    """Serial number, as `fpplab devices` shows it."""
    roi: (
        tuple[NotNegativeCount, NotNegativeCount, Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]
        | None
    ) = None
    """Region of interest: offset x, offset y, width and height in px; the whole sensor without it."""
    black_level: float | None = None
    """Black level in the camera's own units; left as it is without it."""
    packed: bool = False
    """Whether 12-bit frames are transferred as Mono12p, three quarters of the data of Mono12."""
    shutter: Literal["rolling", "global_reset", "global"] | None = None
    """Shutter mode to set; for a camera whose shutter cannot be switched, the one that it has."""
    trigger: TriggerLine = TriggerLine()
    """Line that receives the hardware trigger."""
    features: str | None = None
    """.pfs file with the camera's settings, loaded before all others, as saved by pylon Viewer."""
