"""Which projector coordinates a camera pixel may have: what decoding knows of the geometry, as plain maps."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Axis, Floats, Map, axis_length
from fpplab.core.errors import DataError
from fpplab.patterns.recording import Recording

PositionInterval = tuple[float | Floats, float | Floats]
"""Least and greatest position, as shares of the projector's length."""


@dataclass(frozen=True, eq=False)
class PossibleCoordinates:
    """Interval of one projector coordinate for every camera pixel, maps [v, u] in px."""

    lower: Map  # ends of the interval, within the projector
    upper: Map  # ends of the interval, within the projector

    def positions(self, length: int) -> tuple[Map, Map]:
        # returns (height, width)
        half, px = np.float32(0.5), np.float32(length)
        return (self.lower + half) / px, (self.upper + half) / px


@dataclass(frozen=True, eq=False)
class PredictedCoordinate:
    """One projector coordinate of every camera pixel, as the other one and the geometry predict it."""

    predict: Callable[[Map], Map]  # maps (height, width) in px, NaN where unknown


DecodingBounds = Mapping[Axis, PossibleCoordinates | PredictedCoordinate]
"""What the geometry tells of the projector coordinates along each axis."""


def widest_interval_share(
    bounds: DecodingBounds | None, axis: Axis, projector_size: tuple[int, int]
) -> float | None:
    # projector_size (width, height) px
    interval = (bounds or {}).get(axis)
    if not isinstance(interval, PossibleCoordinates):
        return None
    return max(float(np.max(interval.upper - interval.lower)), 1.0) / axis_length(projector_size, axis)


def interval_of(
    bounds: Mapping[Axis, PossibleCoordinates] | None,
    axis: Axis,
    length: int,
    pixels: NDArray[np.int64] | None = None,
) -> PositionInterval:
    # pixels (P,)
    if bounds is None or axis not in bounds:
        return 0.0, 1.0
    low, high = (end.astype(np.float64) for end in bounds[axis].positions(length))
    return (low, high) if pixels is None else (low.ravel()[pixels], high.ravel()[pixels])


def check_bounds(bounds: Mapping[Axis, PossibleCoordinates] | None, recording: Recording) -> None:
    """Refuse intervals of another camera."""
    shape = recording.frames[0].shape
    for axis, interval in (bounds or {}).items():
        if interval.lower.shape != shape or interval.upper.shape != shape:
            raise DataError(
                f"{recording.name}: bounds along {axis} are maps of the shape {interval.lower.shape}, but "
                "the "
                f"frames have {shape}; compute them with the calibration of this camera"
            )
