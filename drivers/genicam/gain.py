"""The gain of a camera in dB, also where the camera knows only the integer `GainRaw`.

How `GainRaw` relates to dB depends on the model, and the camera does not report it: a driver knows it for
some models, and the rig file states it for others. Without either only the lowest gain can be used, and it
counts as 0 dB.
"""

import math

from drivers.genicam.features import Features
from drivers.genicam.names import GAIN_DB, GAIN_RAW, GAIN_SELECTOR
from drivers.genicam.options import RawGain


class CameraGain:
    """The gain of one open camera."""

    def __init__(self, features: Features, conversion: RawGain | None, in_db: bool = True) -> None:
        self._features, self._conversion = features, conversion
        self._in_db = in_db and features.has(GAIN_DB)
        self._own = GAIN_RAW if in_db else GAIN_DB

    def neutralise_digital(self) -> None:
        """Set digital gains to a factor of 1, where the camera has them beside the sensor's own."""
        for entry in self._features.choices(GAIN_SELECTOR):
            if entry.startswith("Digital") and self._features.has(GAIN_DB):
                self._features.write_if_possible(GAIN_SELECTOR, entry)
                known = self._in_db or self._conversion is not None
                neutral = (0.0 if self._in_db else 1.0) if known else self._features.limits(GAIN_DB)[0]
                self._features.ensure(GAIN_DB, neutral, "open")

    def limits_db(self) -> tuple[float, float]:
        if self._in_db:
            return self._features.limits(GAIN_DB)
        if self._conversion is None or not self._features.has(self._own):
            return 0.0, 0.0
        minimum, maximum = self._features.limits(self._own)
        if self._own == GAIN_RAW:
            minimum = max(minimum, 1.0)  # where a factor is proportional to it, 0 would be no gain in dB
        return to_db(minimum, self._conversion), to_db(maximum, self._conversion)

    def set_db(self, gain_db: float) -> float:
        if self._in_db:
            return float(self._features.write(GAIN_DB, gain_db, "configure", tolerance=1.0))
        if not self._features.has(self._own):
            return 0.0
        if self._conversion is None:
            self._features.write(self._own, self._features.limits(self._own)[0], "configure")
            return 0.0
        raw = to_raw(gain_db, self._conversion)
        if self._own == GAIN_RAW:
            return to_db(self._features.write(GAIN_RAW, round(raw), "configure"), self._conversion)
        back = self._features.write(GAIN_DB, raw, "configure", tolerance=0.1 * abs(raw))
        return to_db(back, self._conversion)


def to_db(raw: float, conversion: RawGain) -> float:
    if conversion.unity is not None:
        return 20.0 * math.log10(raw / conversion.unity)
    assert conversion.db_per_step is not None
    return raw * conversion.db_per_step


def to_raw(gain_db: float, conversion: RawGain) -> float:
    """Convert a gain in dB to the camera's own number, not rounded: the inverse of `to_db`."""
    if conversion.unity is not None:
        return float(conversion.unity * 10.0 ** (gain_db / 20.0))
    assert conversion.db_per_step is not None
    return gain_db / conversion.db_per_step
