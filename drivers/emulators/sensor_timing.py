"""How soon an emulated camera is ready for the next trigger pulse.

A pulse that comes earlier is ignored, as real cameras do. An exposure may overlap with the readout of the
previous frame, but must not end before that readout does, and the sensor needs a dead time between two
exposures.
"""

from typing import Annotated

from pydantic import Field

from fpplab.core.config import Document

Microseconds = Annotated[float, Field(ge=0)]


class SensorTiming(Document):
    """Times of an emulated sensor; without options it is `STRICT`."""

    readout_us: Microseconds = 8000.0
    """Time in µs in which a frame is read out."""
    dead_us: Microseconds = 100.0
    """Time in µs between the end of an exposure, or of a readout, and the next."""
    untold_us: Microseconds = 0.0
    """Further dead time in µs, which the camera's resulting frame rate leaves out."""
    clock_ppm: Annotated[float, Field(ge=0, le=1000)] = 100.0
    """By how many millionths the camera's times are longer than it reports."""

    def reported_rate_hz(self, exposure_s: float) -> float:
        rate_hz = 1.0 / (max(exposure_s, self.readout_us * 1e-6) + self.dead_us * 1e-6)
        steps_per_hz = 100  # of the frame rate that pylon's emulator can report
        return max(int(rate_hz * steps_per_hz), 1) / steps_per_hz

    def period_s(self, exposure_s: float) -> float:
        """Compute the time from the beginning of an exposure until the camera takes the next pulse."""
        dead_s = (self.dead_us + self.untold_us) * 1e-6
        return (max(exposure_s, self.readout_us * 1e-6) + dead_s) * (1 + 1e-6 * self.clock_ppm)


STRICT = SensorTiming()
"""A sensor that needs time for readout and between exposures, by its slow clock more than it reports."""
ALWAYS_READY = SensorTiming(readout_us=0.0, dead_us=0.0, clock_ppm=0.0)
"""A sensor that takes the next pulse as soon as an exposure has ended; no camera does."""
