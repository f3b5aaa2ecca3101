"""The section of a Basler camera in a rig file.

camera:
  backend: basler
  serial: "21734321"                                # as `fpplab devices` shows it
  bits: 12
  roi: [0, 0, 5472, 3648]                           # offset x, offset y, width, height; all without it
  black_level: 4.0                                  # in the camera's numbers; as it is without it
  packed: true                                      # 12 bits as Mono12p: three quarters of the data
  shutter: rolling                                  # or global_reset, global
  raw_gain: {db_per_step: 0.0359}                   # of a camera with GainRaw only, see its manual
  packet_bytes: 8192                                # of Ethernet cameras
  packet_delay_ticks: 1000
  trigger: {line: Line1, edge: rising, delay_us: 0, debounce_us: 0}
  features: camera.pfs                              # loaded first, as pylon's viewer saves it
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivers.genicam.options import GenicamOptions


class BaslerOptions(GenicamOptions):
    """The camera's section in a rig file; the module shows an example."""

    packet_bytes: Annotated[int, Field(ge=1)] | None = None
    """Size of an Ethernet camera's packets in bytes; by default unchanged."""
    packet_delay_ticks: Annotated[int, Field(ge=0)] | None = None
    """Pause between two packets of an Ethernet camera, in ticks of its clock; by default unchanged."""
    features: str | None = None
    """.pfs file with the camera's settings, loaded before all others, as saved by pylon Viewer."""
