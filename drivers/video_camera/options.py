"""The section of a video camera in a rig file; docs/hardware.md shows an example."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.genicam.options import RawGain
from fpplab.core.config import Document

PositiveCount = Annotated[int, Field(ge=1)]


class VideoOptions(Document):
    """The camera's section in a rig file."""

    device: str
    """Device file; a link of /dev/v4l/by-id does not change when other cameras are plugged in."""
    size: tuple[PositiveCount, PositiveCount] | None = None
    """Width and height of frames in px; by default as the camera is set."""
    shutter: Literal["rolling", "global"] = "rolling"
    """The shutter that the camera has; the device does not report it."""
    raw_gain: RawGain | None = None
    """What the numbers of its gain mean; without it only the least gain is used, which counts as 0 dB."""
    latency_s: Annotated[float, Field(ge=0)] = 0.0
    """Longest time in s for which the camera holds a frame back before it is stamped."""
