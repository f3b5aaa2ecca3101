"""The gain of a camera in dB, also where the camera knows only the integer `GainRaw`.

How `GainRaw` relates to dB depends on the model, and the camera does not tell: a driver knows it for some
models, and the rig file states it for others. Without either only the least gain can be used, and it counts
as 0 dB.
"""

from __future__ import annotations

import math

from drivers.genicam.features import Features
from drivers.genicam.names import GAIN_DB, GAIN_RAW
from drivers.genicam.options import RawGain


class CameraGain:
    """The gain of one open camera.

    Parameters
    ----------
    features : Features
        The camera's features.
    conversion : RawGain or None
        How GainRaw is converted, where it is known.
    """

    def __init__(self, features: Features, conversion: RawGain | None) -> None:
        self._features, self._conversion = features, conversion

    def limits_db(self) -> tuple[float, float]:
        """Read the range of gains at present.

        Returns
        -------
        tuple of float
            Least and greatest gain in dB; both 0 for a camera without gain, or whose conversion is unknown.
        """
        if self._features.has(GAIN_DB):
            return self._features.limits(GAIN_DB)
        if self._conversion is None or not self._features.has(GAIN_RAW):
            return 0.0, 0.0
        least, most = self._features.limits(GAIN_RAW)
        # Where a factor is proportional to it, 0 would be no gain in dB.
        return to_db(max(least, 1.0), self._conversion), to_db(most, self._conversion)

    def set_db(self, gain_db: float) -> float:
        """Set the gain.

        Parameters
        ----------
        gain_db : float
            Gain in dB, within `limits_db`.

        Returns
        -------
        float
            The gain that is read back, in dB.

        Raises
        ------
        SettingError
            The camera does not take it, or another one is read back.
        """
        if self._features.has(GAIN_DB):
            return float(self._features.write(GAIN_DB, gain_db, "configure", tolerance=1.0))
        if not self._features.has(GAIN_RAW):
            return 0.0
        if self._conversion is None:
            self._features.write(GAIN_RAW, self._features.limits(GAIN_RAW)[0], "configure")
            return 0.0
        raw = round(to_raw(gain_db, self._conversion))
        return to_db(self._features.write(GAIN_RAW, raw, "configure"), self._conversion)


def to_db(raw: float, conversion: RawGain) -> float:
    """Convert a raw gain to dB.

    Parameters
    ----------
    raw : float
        The camera's own number, greater than 0 where the factor is proportional to it.
    conversion : RawGain
        How the camera's numbers are meant.

    Returns
    -------
    float
        Gain in dB.
    """
    if conversion.unity is not None:
        return 20.0 * math.log10(raw / conversion.unity)
    assert conversion.db_per_step is not None
    return raw * conversion.db_per_step


def to_raw(gain_db: float, conversion: RawGain) -> float:
    """Convert a gain in dB to the camera's own number, not rounded: the inverse of `to_db`.

    Parameters
    ----------
    gain_db : float
        Gain in dB.
    conversion : RawGain
        How the camera's numbers are meant.

    Returns
    -------
    float
        The camera's own number.
    """
    if conversion.unity is not None:
        return float(conversion.unity * 10.0 ** (gain_db / 20.0))
    assert conversion.db_per_step is not None
    return gain_db / conversion.db_per_step
