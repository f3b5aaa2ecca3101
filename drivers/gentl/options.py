"""The section of a GenTL camera in a rig file.

camera:
  backend: gentl
  producer: /opt/maker/lib/maker.cti                # of the maker's software
  serial: "21734321"                                # as the maker's software shows it
  bits: 12
  roi: [0, 0, 2048, 1536]                           # offset x, offset y, width, height; all without it
  black_level: 4.0                                  # in the camera's numbers; as it is without it
  shutter: global                                   # or rolling, global_reset
  raw_gain: {db_per_step: 0.1}                      # of a camera whose gain is not in dB, see its manual
  trigger: {line: Line1, edge: rising, delay_us: 0, debounce_us: 0}
"""

from __future__ import annotations

from pathlib import Path

from drivers.genicam.options import GenicamOptions


class GentlOptions(GenicamOptions):
    """The camera's section in a rig file; the module shows an example."""

    producer: Path
    """.cti file of the maker's GenTL producer."""
