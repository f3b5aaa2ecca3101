"""Fringe orders that a bias between the sets has changed, found by what the frames show around a pixel.

Light that an object scatters shifts the phase of wide fringes. From half a period of the finer set on it
changes the order, and a whole period leaves no trace in the pixel itself. At the border of such pixels,
however, the coordinate jumps by whole periods although the fine phase goes on, in value and slope, as if
there were none. Parts of the image in which nothing jumps are joined across such borders, and of what is
joined, only the order of most pixels is kept.

An edge in depth may jump by a whole period too. There it hardly stays one all along, and the sets contradict
each other on one side as on the other.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Floats, Map, Mask
from fpplab.core.robust import robust_spread
from fpplab.phase.limits import BIASED_ORDERS as LIMITS

FlatIndices = NDArray[np.int64]
PartNumbers = NDArray[np.int32]
ContradictionOf = Callable[[FlatIndices], Floats]
"""How far the sets of some pixels contradict each other, in turns and with its sign."""


def mark_biased_orders(
    coordinate: Map,
    sigma: Map,
    cause: NDArray[np.uint8],
    *,
    max_sigma: float,
    mark: int,
    period: float,
    widest: float,
    contradiction: ContradictionOf,
) -> None:
    """Mark, in `cause`, the pixels whose order a bias between the sets may have changed."""
    # Coordinates are known too where `cause` says already that their order is in doubt; those whose `sigma`
    # is greater are left out. `period` and `widest` are those of the finest and the widest fringes in px.
    # coordinate, sigma, cause (height, width)
    half = np.float32(0.5 * period)
    sparse = slice(None, None, LIMITS.searched_px)
    if not any(
        (np.abs(np.diff(lines)) >= half).any() for lines in (coordinate[sparse], coordinate[:, sparse].T)
    ):
        return
    labels, part_of_label, sizes, measured, steps = _find_parts(
        coordinate.ravel(), sigma.ravel(), cause.ravel(), cause.shape[1], np.float32(max_sigma), half
    )
    if len(steps) > LIMITS.max_jumping_share * sizes.sum():
        return
    pixels = steps.T.astype(np.int64)
    parts = part_of_label[labels[pixels]].astype(np.int64)
    # From the part of the lower number to the other.
    pixels, parts = (np.where(parts[0] < parts[1], pair, pair[::-1]) for pair in (pixels, parts))
    jumps, gaps = _jumps_and_gaps(coordinate.ravel(), np.float32(period), pixels)
    numbers, any_step, lengths = _borders(parts, jumps, gaps)
    first, second, jumps = *parts[:, any_step], jumps[any_step]
    smaller = np.minimum(sizes[first], sizes[second])
    joins = smaller <= lengths**2
    judged = np.flatnonzero(joins & (smaller > LIMITS.small_part_px))
    along = np.flatnonzero(np.isin(numbers, judged))
    along = along[np.argsort(numbers[along], kind="stable")]
    changes = np.subtract(*contradiction(pixels[:, along].ravel()).reshape(2, -1)) if len(along) else along
    ends = np.cumsum(lengths[judged])
    for k, start, end in zip(judged, ends - lengths[judged], ends, strict=True):
        # No surface jumps by the widest fringes' own period; the sets agree there.
        change = changes[start:end] + (abs(jumps[k]) * period > 0.5 * widest)
        joins[k] = _surface_goes_on(gaps[:, along[start:end]], change)
    chosen = np.flatnonzero(joins)[np.argsort(-lengths[joins], kind="stable")]
    groups, orders = _join(first[chosen], second[chosen], jumps[chosen], lengths[chosen], sizes)
    joined = np.unique(np.concatenate([first[chosen], second[chosen]]))
    dropped = np.zeros(len(sizes), np.bool_)
    dropped[joined] = ~_has_most(groups[joined], orders[joined], measured[joined])
    if dropped.any():
        _mark(cause.ravel(), labels, dropped[part_of_label], np.uint8(mark))


def _jumps_and_gaps(coordinate: Map, period: np.float32, steps: FlatIndices) -> tuple[FlatIndices, Floats]:
    """By how many periods the coordinate jumps, and by what else than its slope before and after the step."""
    # coordinate (P,); steps (2, N) from pixel to pixel; returns (N,), (2, N) turns
    before, after = steps
    side = after - before
    outer = np.stack([before - side, after + side]).clip(0, len(coordinate) - 1)
    slopes = np.stack([coordinate[before] - coordinate[outer[0]], coordinate[outer[1]] - coordinate[after]])
    slopes /= period
    change = (coordinate[after] - coordinate[before]) / period
    # Where no slope is known, none is taken off.
    goes_on = change - np.nan_to_num(slopes - np.round(slopes))
    best = np.abs(goes_on - np.round(goes_on)).argmin(axis=0)
    jumps = np.round(np.take_along_axis(goes_on, best[None], axis=0)[0])
    return jumps.astype(np.int64), goes_on - jumps


def _borders(
    parts: FlatIndices, jumps: FlatIndices, gaps: Floats
) -> tuple[FlatIndices, FlatIndices, FlatIndices]:
    """Number the border of each step; a step of each border, and its length in px, 0 where it is none."""
    # Nearly all steps between two parts must be the same whole number of periods.
    # parts (2, N) before and after each step; jumps (N,); gaps (2, N)
    is_whole = (np.abs(gaps).min(axis=0) < LIMITS.near_period) & (jumps != 0) & (parts[0] != parts[1])
    _, of_pair, steps = np.unique(parts[0] << 32 | parts[1], return_inverse=True, return_counts=True)
    most = int(np.abs(jumps).max(initial=0))
    keys = np.where(is_whole, of_pair * (2 * most + 1) + jumps + most, -1)
    _, any_step, numbers, lengths = np.unique(
        keys, return_index=True, return_inverse=True, return_counts=True
    )
    is_border = is_whole[any_step] & (lengths >= LIMITS.min_whole_share * steps[of_pair[any_step]])
    return numbers, any_step, np.where(is_border, lengths, 0)


def _surface_goes_on(gaps: Floats, changes: Floats) -> bool:
    """Whether value and slope of the fine phase go on all along a border, and contradictions change at it."""
    # gaps (2, N) turns; changes (N,) turns
    is_continuous = abs(np.median(changes)) > 0.5
    max_gap = LIMITS.max_gap_turns if is_continuous else LIMITS.max_gap_at_edge_turns
    contradicts = False
    for stretch in np.array_split(np.vstack([gaps, changes]), LIMITS.stretches, axis=1):
        middle = np.median(stretch, axis=1)
        per_sigma = LIMITS.beyond_sigmas / np.sqrt(stretch.shape[1])
        if np.abs(middle[:2]).max() > max_gap + per_sigma * robust_spread(stretch[:2] - middle[:2, None]):
            return False
        noise = per_sigma * robust_spread(stretch[2] - middle[2])
        contradicts |= bool(abs(middle[2]) > max(LIMITS.min_change_turns, noise))
    return contradicts


def _has_most(groups: FlatIndices, orders: FlatIndices, areas: FlatIndices) -> Mask:
    # groups, orders, areas (P,); returns (P,)
    _, same = np.unique(groups << 32 | orders & 0xFFFFFFFF, return_inverse=True)
    return np.asarray(
        np.bincount(same, areas)[same] >= LIMITS.min_majority * np.bincount(groups, areas)[groups]
    )


@kernel(nogil=True)
def _find_parts(
    coordinate: Map, sigma: Map, cause: NDArray[np.uint8], width: int, max_sigma: np.float32, half: np.float32
) -> tuple[PartNumbers, PartNumbers, PartNumbers, PartNumbers, PartNumbers]:
    """Number the parts in which no step from pixel to pixel is half a period, and list the steps that are.

    If these are more than count, the rest of the image is left.

    Pixels have labels, of which several may lead to one part; label 0 has no coordinate that counts.
    """
    # coordinate, sigma, cause (P,); returns label of each pixel (P,); of each label its part, and of that all
    # pixels and measured ones (L,); steps (N, 2)
    size, per_row = np.uintp(len(cause)), np.uintp(width)
    # Memory that is not written to costs nothing.
    labels, leads = np.zeros(size, np.int32), np.empty(size + 1, np.int32)
    sizes, measured = np.empty(size + 1, np.int32), np.empty(size + 1, np.int32)
    leads[0] = sizes[0] = measured[0] = 0
    max_steps = np.uintp(LIMITS.max_jumping_share * size)
    steps = np.empty((max_steps + per_row + per_row, 2), np.int32)
    step_count, count = np.uintp(0), np.uintp(1)
    for v in range(len(cause) // width):
        before, label = np.float32(np.nan), np.uintp(0)
        if step_count > max_steps:
            break
        for u in range(width):
            pixel = np.uintp(v) * per_row + np.uintp(u)
            value = coordinate[pixel]
            if cause[pixel] > 0 and not sigma[pixel] <= max_sigma:
                value = np.float32(np.nan)
            apart = abs(value - before)
            before = value
            if not apart < half:
                label = np.uintp(0)
                if np.isnan(value):
                    continue
                if apart >= half:
                    steps[step_count, 0], steps[step_count, 1] = pixel - np.uintp(1), pixel
                    step_count += np.uintp(1)
            above = np.uintp(labels[pixel - per_row]) if v > 0 else np.uintp(0)
            if above != 0:
                if abs(value - coordinate[pixel - per_row]) < half:
                    if label != above:
                        label = above if label == 0 else _unite(leads, label, above)
                else:
                    steps[step_count, 0], steps[step_count, 1] = pixel - per_row, pixel
                    step_count += np.uintp(1)
            if label == 0:
                label = count
                leads[label], sizes[label], measured[label] = label, 0, 0
                count += np.uintp(1)
            labels[pixel] = label
            sizes[label] += 1
            measured[label] += cause[pixel] == 0
    for other in range(1, count):
        lead = leads[other] = leads[leads[other]]
        if lead != other:
            sizes[lead] += sizes[other]
            measured[lead] += measured[other]
    return labels, leads[:count], sizes[:count], measured[:count], steps[:step_count]


@kernel(nogil=True)
def _mark(cause: NDArray[np.uint8], labels: PartNumbers, dropped: NDArray[np.bool_], mark: np.uint8) -> None:
    for pixel in range(len(cause)):
        if dropped[labels[pixel]] and cause[pixel] == 0:
            cause[pixel] = mark


@kernel_part()
def _unite(leads: PartNumbers, a: np.uintp, b: np.uintp) -> np.uintp:
    """Let the greater one's part lead to the other's."""
    first, second = a, b
    while leads[a] != a:
        a = np.uintp(leads[a])
    while leads[b] != b:
        b = np.uintp(leads[b])
    lead = min(a, b)
    if leads[first] != lead or leads[second] != lead:
        leads[first] = leads[second] = leads[max(a, b)] = lead
    return lead


@kernel(nogil=True)
def _join(
    first: FlatIndices, second: FlatIndices, jumps: FlatIndices, lengths: FlatIndices, sizes: PartNumbers
) -> tuple[FlatIndices, FlatIndices]:
    """Join parts across borders, the longest first; the group and relative order of every part."""
    # A border is long enough for a group if it is a quarter of the outline of a square of its size.
    groups, orders, grown = np.arange(len(sizes)), np.zeros(len(sizes), np.int64), sizes.copy()
    for k in range(len(first)):
        a, b, jump = first[k], second[k], jumps[k]
        while groups[a] != a:
            jump += orders[a]
            a = groups[a]
        while groups[b] != b:
            jump -= orders[b]
            b = groups[b]
        if grown[a] < grown[b]:
            a, b, jump = b, a, -jump
        if a != b and grown[b] <= lengths[k] ** 2:
            groups[b], orders[b] = a, jump
            grown[a] += grown[b]
    for part in range(len(sizes)):
        lead, order = groups[part], orders[part]
        while groups[lead] != lead:
            order += orders[lead]
            lead = groups[lead]
        groups[part], orders[part] = lead, order
    return groups, orders
