"""An axis with one set of fringes and nothing that tells their orders: neighbours unwrap it.

Every island is known up to a whole number of periods. Which one it is, is said where all others would put
part of the island outside of the projector's picture or of the depth range, or where the coordinate of one
of its pixels is known. It is never guessed.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Axis, Floats, Map, Mask, axis_length
from fpplab.patterns.recording import KnownCoordinate, Recording
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.demodulation import Wrapped, wrapped_phase
from fpplab.phase.error_model import ErrorModel
from fpplab.phase.islands import Islands, find_islands
from fpplab.phase.limits import ISLANDS


@dataclass(frozen=True, eq=False)
class UnwrappedIslands:
    """Where the islands of one axis are in the projector's picture."""

    island: NDArray[np.int32]  # their numbers, negative where the order is unknown, 0 where there is none
    coordinate: Map  # px, NaN outside of islands


def unwrap_by_neighbours(
    recording: Recording, axis: Axis, errors: ErrorModel, possible: PossibleCoordinates | None
) -> UnwrappedIslands:
    """Unwrap the finest set along an axis."""
    index = recording.plan.finest_set(axis)
    measured = wrapped_phase(recording.of_set(index), recording.plan.fringes[index], errors.saturation)
    usable = usable_pixels(recording, measured, errors)
    sigma_rad = phase_sigma(recording, index, measured, errors)
    period_px = axis_length(recording.projector_size, axis) / recording.plan.fringes[index].stripes
    islands = find_islands(measured.phase.astype(np.float64), sigma_rad, usable)
    return placed(islands, recording, axis, period_px, sigma_rad, possible)


def usable_pixels(recording: Recording, measured: Wrapped, errors: ErrorModel) -> Mask:
    """Tell which pixels see fringes and are not saturated; decoding has further rules."""
    rules, grey = recording.plan.masks, recording.grey
    valid = (measured.modulation * grey >= rules.modulation_min) & (measured.peak < errors.saturation)
    return np.asarray(valid & (measured.modulation >= rules.contrast_min * measured.offset))


def phase_sigma(recording: Recording, index: int, measured: Wrapped, errors: ErrorModel) -> Floats:
    """Compute the standard uncertainty of the phase by noise, in rad."""
    level, modulation = (
        np.asarray(m, np.float64) * recording.grey for m in (measured.offset, measured.modulation)
    )
    variance = errors.noise.variance(level) * errors.sets[index].scatter * measured.loss
    return np.asarray(
        recording.plan.fringes[index].phase_noise * np.sqrt(variance) / np.maximum(modulation, 1e-30)
    )


def placed(
    islands: Islands,
    recording: Recording,
    axis: Axis,
    period_px: float,
    sigma_rad: Floats,
    possible: PossibleCoordinates | None,
) -> UnwrappedIslands:
    """Find the order of every island that has only one, and put the others somewhere into the picture."""
    length = axis_length(recording.projector_size, axis)
    coordinate = islands.phase * (period_px / TWO_PI) - 0.5
    lower, upper = (-0.5, length - 0.5) if possible is None else (possible.lower, possible.upper)
    margin = ISLANDS.beyond_sigmas * sigma_rad * period_px / TWO_PI
    # The least and the greatest number of periods that may be added at each pixel.
    lowest = np.ceil((lower - margin - coordinate) / period_px)
    highest = np.maximum(np.floor((upper + margin - coordinate) / period_px), lowest - 1)
    numbers, known = np.zeros(islands.count + 1, np.int64), np.zeros(islands.count + 1, np.bool_)
    at = np.flatnonzero(islands.label)
    order = at[np.argsort(islands.label.ravel()[at], kind="stable")]
    ends = np.cumsum(np.bincount(islands.label.ravel()[at], minlength=islands.count + 1))
    for k in range(1, islands.count + 1):
        own = order[ends[k - 1] : ends[k]]
        numbers[k], known[k] = _order_of(lowest.ravel()[own], highest.ravel()[own])
    for k, order_at in _orders_of_known_points(recording.known, islands, coordinate, period_px).items():
        known[k] = len(order_at) == 1
        numbers[k] = next(iter(order_at)) if known[k] else numbers[k]
    signed = np.where(known, 1, -1)[islands.label] * islands.label
    coordinate = np.where(islands.label > 0, coordinate + period_px * numbers[islands.label], np.nan)
    return UnwrappedIslands(signed.astype(np.int32), coordinate.astype(np.float32))


def _order_of(lower: Floats, upper: Floats) -> tuple[int, bool]:
    """Give the order at which most pixels are possible, and whether it is the only one."""
    first = int(min(lower.min(), upper.min()))
    orders = np.arange(first, int(max(lower.max(), upper.max())) + 1)
    inside = np.searchsorted(np.sort(lower), orders, "right") - np.searchsorted(
        np.sort(upper), orders, "left"
    )
    share = inside / len(lower)
    best = np.flatnonzero(share == share.max())
    middle = int(best[len(best) // 2])
    others = np.delete(share, middle)
    is_known = share[middle] >= ISLANDS.inside_share and (others <= 1.0 - ISLANDS.outside_share).all()
    return int(orders[middle]), bool(is_known)


def _orders_of_known_points(
    known: tuple[KnownCoordinate, ...], islands: Islands, coordinate: Floats, period_px: float
) -> dict[int, set[int]]:
    """Give the orders that known coordinates say, by island; two or none contradict it."""
    orders: dict[int, set[int]] = {}
    for point in known:
        column, row = point.pixel
        label = int(islands.label[row, column])
        turns = (point.coordinate - coordinate[row, column]) / period_px
        if label:
            fits = abs(turns - round(turns)) <= ISLANDS.max_off_turns
            near = (round(turns),) if fits else (math.floor(turns), math.ceil(turns))
            orders.setdefault(label, set()).update(near)
    return orders
