"""The section of a GenTL camera in a rig file; docs/hardware.md shows an example."""

from pathlib import Path

from drivers.genicam.options import GenicamOptions


class GentlOptions(GenicamOptions):
    """The camera's section in a rig file."""

    producer: Path
    """.cti file of the maker's GenTL producer."""
