"""Light that each row of a camera collects from a projector that makes grey levels by switching mirrors.

A DLP mirror is on or off. A pattern of B bits is shown as B binary planes one after another within the period
T: the plane of bit k is lit for `2^k / (2^B - 1)` of T, the most significant first, and the pattern is
repeated endlessly. Row r of the camera collects light from `start + r * line_time` for the exposure; on a
global shutter the line time is 0. When the exposure is a whole number of periods every row collects every
plane in proportion and sees the grey level that was meant. When it is not, a row collects too much of some
planes and too little of others, by its own phase: bands whose strength depends on the grey level.

This is the model, the simplest with the right weights. The planes' real order is the firmware's own: it may
split long planes into segments and mix them, which mostly makes bands weaker, and it may leave dark times
between patterns, which makes bands on white too. What does not depend on it: a whole number of periods has no
bands.

Closed form: with t in periods, row r's exposure is `n + e` long, n whole and 0 <= e < 1, and begins at
phase p in [0, 1). Its n whole periods hold n times the plane's duration d; the rest, [p, p + e], can meet the
plane in this period, [o, o + d], and in the next, [o + 1, o + 1 + d].
"""

import numpy as np

from fpplab.core.conventions import Floats


def plane_weights(
    rows: int, bits: int, period_s: float, exposure_s: float, line_time_s: float, start_s: float
) -> Floats:
    """Compute the light that each row collects of each plane, relative to the average."""
    # A row of grey level `sum_k b_k 2^k` has the relative light `sum_k b_k 2^k weights[k] / (2^bits - 1)`:
    # the weights are 1 when the exposure is a whole number of periods, and white is always collected
    # completely.
    # returns (bits, rows)
    duration = plane_durations(bits)[:, None]
    onset = 1 - np.cumsum(duration, axis=0)
    turns = exposure_s / period_s
    whole = np.floor(turns)
    begin = np.mod((start_s + line_time_s * np.arange(rows)) / period_s, 1.0)
    end = begin + (turns - whole)
    rest = _overlap(begin, end, onset, duration) + _overlap(begin, end, onset + 1, duration)
    return np.asarray((whole + rest / duration) / turns, np.float64)


def plane_durations(bits: int) -> Floats:
    """Compute the share of the period for which each bit's plane is lit."""
    # returns (bits,)
    return np.asarray(np.exp2(np.arange(bits)) / (2**bits - 1), np.float64)


def is_whole(exposure_s: float, period_s: float) -> bool:
    """Return whether the exposure is one or more whole periods within rounding, so that every weight is 1."""
    turns = exposure_s / period_s
    # Weights of B bits are then within 2^B times 1e-9 of 1.
    return round(turns) >= 1 and abs(turns - round(turns)) <= 1e-9 * turns


def _overlap(begin: Floats, end: Floats, onset: Floats, duration: Floats) -> Floats:
    common = np.minimum(end, onset + duration) - np.maximum(begin, onset)
    return np.asarray(np.maximum(common, 0.0), np.float64)
