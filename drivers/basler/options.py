"""The section of a Basler camera in a rig file; docs/hardware.md shows an example."""

from typing import Annotated

from pydantic import Field

from drivers.genicam.options import GenicamOptions


class BaslerOptions(GenicamOptions):
    """The camera's section in a rig file."""

    packet_bytes: Annotated[int, Field(ge=1)] | None = None
    """Size of an Ethernet camera's packets in bytes; by default unchanged."""
    packet_delay_ticks: Annotated[int, Field(ge=0)] | None = None
    """Pause between two packets of an Ethernet camera, in ticks of its clock; by default unchanged."""
    features: str | None = None
    """.pfs file with the camera's settings, loaded before all others, as saved by pylon Viewer."""
