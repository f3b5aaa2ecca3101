"""Islands: connected regions in which neighbouring pixels tell how a phase goes on, and its unwrapping there.

A link of two neighbouring pixels is sound where the phase goes on as the pixels on both sides say: it differs
from the mean of both slopes by no more than noise, and half of the difference of the slopes, allow. Sums of
three links and means along an edge are examined too, since blur spreads a step over pixels and noise hides a
small one. Sound links alone do not make an island: a step that changes along its edge passes through whole
periods, where it looks like none or, of a tilted part, like a crease. So islands begin away from steps and
creases, wider than such a gap is, and grow back. Two of them are joined again where most of their common
border is sound and says the same, as that of two faces of a body does.

A step of a whole number of periods along all of an edge is invisible in one set of fringes.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import TWO_PI, Floats, Mask
from fpplab.core.robust import robust_spread
from fpplab.phase.limits import ISLANDS

_Labels = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Islands:
    """The unwrapped phase of every island, each up to a whole number of periods."""

    label: _Labels  # 1 … count, 0 where there is no island, (height, width)
    phase: Floats  # rad, meaningless where there is no island
    contradictory: Mask  # in an island whose links do not agree, which is given up

    @property
    def count(self) -> int:
        return int(self.label.max(initial=0))


def find_islands(phase: Floats, sigma_rad: Floats, usable: Mask, window_px: float = 0.0) -> Islands:
    """Divide a wrapped phase into islands and unwrap it in each."""
    # maps (height, width); window_px is the standard deviation of the window that made the phase
    right, even = sound_links(phase, sigma_rad, usable)
    down, even_down = (np.ascontiguousarray(m.T) for m in sound_links(phase.T, sigma_rad.T, usable.T))
    whole = _uncut(even, even_down, usable)
    label, unwrapped = np.zeros(phase.shape, np.int32), phase.astype(np.float64)
    contradictory = np.zeros(phase.shape, np.bool_)
    near = _eroded(usable, ISLANDS.hole_px)
    count = 0
    for step_px in ISLANDS.step_px:
        reach = step_px + math.ceil(ISLANDS.window_reach * window_px)
        core = _eroded(whole, reach) & near & (label == 0)
        count, bad = _flood(unwrapped, right, down, core, label, count)
        for _ in range(2 * (reach + ISLANDS.hole_px)):  # into corners
            if not _grow(unwrapped, right, down, label):
                break
        contradictory |= np.isin(label, bad)
    label[contradictory] = 0
    _join(unwrapped, phase, right, down, label, count)
    label[np.bincount(label.ravel())[label] < ISLANDS.min_pixels] = 0  # scraps are no other surface
    label[_meeting(right, down, label) | _beside_steps(right, down, label)] = 0
    for _ in range(ISLANDS.corner_px):
        label[_corners(label, usable)] = 0
    sizes = np.bincount(label.ravel())
    kept = sizes >= ISLANDS.min_pixels
    kept[0] = False
    numbers = np.where(kept, np.cumsum(kept), 0).astype(np.int32)
    return Islands(numbers[label], unwrapped, contradictory)


def _bends(phase: Floats, usable: Mask, gap: int) -> tuple[Floats, Floats, Mask, Mask]:
    """By how much the phase over `gap` links in a row exceeds the slopes beside them; how these differ."""
    # And where one slope is known, and both; (height, width - 1), at the middle link's left pixel.
    links, known = _wrapped(np.diff(phase, axis=1)), usable[:, 1:] & usable[:, :-1]
    sums, ones, none = np.where(known, links, 0.0), known.astype(np.float64), cv2.BORDER_CONSTANT
    window, beside = (ISLANDS.slope_px, ISLANDS.slope_px), (gap + ISLANDS.slope_px) // 2
    total, count = (
        np.asarray(cv2.boxFilter(values, -1, window, normalize=False, borderType=none), np.float64)
        for values in (sums, ones)
    )
    counts = [_shifted(count, by) for by in (-beside, beside)]
    means = [
        _shifted(total, by) / np.maximum(n, 1.0) for by, n in zip((-beside, beside), counts, strict=True)
    ]
    left, right = (
        np.where(own > 0.5, mean, other) for own, mean, other in zip(counts, means, means[::-1], strict=True)
    )
    change, all_known = (
        cv2.boxFilter(values, -1, (gap, 1), normalize=False, borderType=none) for values in (sums, ones)
    )
    whole = all_known > gap - 0.5
    steep = np.maximum(np.abs(left), np.abs(right)) > ISLANDS.max_slope_rad
    bend, differ = change - 0.5 * gap * (left + right), np.abs(right - left)
    bend[steep] = np.inf
    some, both = (whole & (fewer(*counts) > 0.5) for fewer in (np.maximum, np.minimum))
    return bend, differ, some, both


def sound_links(phase: Floats, sigma_rad: Floats, usable: Mask) -> tuple[Mask, Mask]:
    """Tell which pixels are linked to the next in their row, and which without a crease; (height, width)."""
    sound = np.zeros(phase.shape, np.bool_)
    sound[:, :-1] = usable[:, 1:] & usable[:, :-1]
    even = sound.copy()
    variance = np.square(sigma_rad)[:, :-1] + np.square(sigma_rad)[:, 1:]
    for gap, rows in ISLANDS.tests:
        bend, differ, some, both = _bends(phase, usable, gap)
        if gap == rows == 1:
            sound[:, :-1] &= some
            even[:, :-1] &= some
            both = some
        (excess, spread, allowed), count = _means_along((bend, variance, differ), both, rows)
        spread = np.sqrt(spread / count)
        finite = both & np.isfinite(excess)
        if finite.any():
            # A surface that is rough beside the noise of pixels scatters by more.
            rough = max(1.0, robust_spread(excess[finite] / spread[finite]))
            noise = ISLANDS.sigmas * rough * spread
            even[:, :-1] &= ~both | (np.abs(excess) <= noise)
            sound[:, :-1] &= ~both | (np.abs(excess) <= noise + ISLANDS.slope_share * gap * allowed)
    return sound, even


def _wrapped(phase: Floats) -> Floats:
    """Bring phases into [-π, π)."""
    return np.asarray((phase + np.pi) % TWO_PI - np.pi)


def _shifted(values: Floats, by: int) -> Floats:
    """Give at each column what stands `by` columns from it, 0 beyond the image."""
    moved = np.zeros_like(values)
    if abs(by) < values.shape[1]:
        moved[:, max(0, -by) : values.shape[1] - max(0, by)] = values[
            :, max(0, by) : values.shape[1] + min(0, by)
        ]
    return moved


def _means_along(maps: Sequence[Floats], valid: Mask, rows: int) -> tuple[list[Floats], Floats]:
    """Means over some rows of what is valid and finite, and over how many."""
    if rows == 1:
        return list(maps), np.ones(valid.shape)
    weight = valid & np.isfinite(maps[0])
    sums = [
        cv2.boxFilter(each, -1, (1, rows), normalize=False, borderType=cv2.BORDER_CONSTANT)
        for each in (*(np.where(weight, values, 0.0) for values in maps), weight.astype(np.float64))
    ]
    count = np.maximum(sums.pop(), 1.0)
    return [np.where(weight, total / count, each) for total, each in zip(sums, maps, strict=True)], count


def _uncut(right: Mask, down: Mask, usable: Mask) -> Mask:
    """Pixels all of whose links to usable neighbours are sound."""
    whole = usable.copy()
    for sound, a, b in (
        (right[:, :-1], np.s_[:, :-1], np.s_[:, 1:]),
        (down[:-1], np.s_[:-1], np.s_[1:]),
    ):
        cut = ~sound & usable[a] & usable[b]
        whole[a] &= ~cut
        whole[b] &= ~cut
    # Where there is no pixel, there is no step: holes count by themselves.
    return whole | ~usable


def _meeting(right: Mask, down: Mask, label: _Labels) -> Mask:
    """Pixels about the sound links of islands that were not joined, which may belong to either."""
    meeting = np.zeros(label.shape, np.uint8)
    for sound, a, b in ((right[:, :-1], np.s_[:, :-1], np.s_[:, 1:]), (down[:-1], np.s_[:-1], np.s_[1:])):
        meeting[a] |= sound & (label[a] != label[b]) & (label[a] > 0) & (label[b] > 0)
    side = 2 * ISLANDS.step_px[0] + 1
    return np.asarray(cv2.dilate(meeting, np.ones((side, side), np.uint8)) > 0)


def _beside_steps(right: Mask, down: Mask, label: _Labels) -> Mask:
    """Pixels that an unsound link parts from another island: they may see both."""
    beside = np.zeros(label.shape, np.bool_)
    for sound, a, b in ((right[:, :-1], np.s_[:, :-1], np.s_[:, 1:]), (down[:-1], np.s_[:-1], np.s_[1:])):
        step = ~sound & (label[a] != label[b]) & (label[a] > 0) & (label[b] > 0)
        beside[a] |= step
        beside[b] |= step
    return beside


def _corners(label: _Labels, usable: Mask) -> Mask:
    """Pixels of which two neighbours are of no island or another: a corner of what is beside may look so."""
    strange = np.zeros(label.shape, np.uint8)
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        differ = usable[a] & usable[b] & (label[a] != label[b])
        strange[a] += differ
        strange[b] += differ
    return np.asarray(strange > 1)


def _eroded(mask: Mask, reach: int) -> Mask:
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return np.asarray(cv2.erode(mask.astype(np.uint8), kernel) > 0)


def _flood(
    phase: Floats, right: Mask, down: Mask, core: Mask, label: _Labels, count: int
) -> tuple[int, list[int]]:
    """Unwrap the connected parts of `core` in place; the last label, and the contradictory ones."""
    count, wrong = _flood_parts(phase, right, down, core, label, count)
    return count, wrong.tolist()


@kernel_part()
def _difference(after: float, before: float) -> float:
    return (after - before + np.pi) % (2.0 * np.pi) - np.pi


@kernel()
def _flood_parts(
    phase: Floats, right: Mask, down: Mask, core: Mask, label: _Labels, count: int
) -> tuple[int, NDArray[np.int64]]:
    height, width = phase.shape
    queue = np.empty(core.size, np.int64)
    wrong = np.zeros(0, np.int64)
    for start in range(core.size):
        if not core[start // width, start % width] or label[start // width, start % width]:
            continue
        count += 1
        label[start // width, start % width] = count
        queue[0], first, end, agrees = start, 0, 1, True
        while first < end:
            v, u = queue[first] // width, queue[first] % width
            first += 1
            for side in range(4):
                dv, du = (0, 0, 1, -1)[side], (1, -1, 0, 0)[side]
                y, x = v + dv, u + du
                if y < 0 or x < 0 or y >= height or x >= width or not core[y, x]:
                    continue
                if not (right[v, min(u, x)] if dv == 0 else down[min(v, y), u]):
                    continue
                expected = phase[v, u] + _difference(phase[y, x], phase[v, u])
                if label[y, x] == 0:
                    label[y, x], phase[y, x] = count, expected
                    queue[end] = y * width + x
                    end += 1
                elif abs(expected - phase[y, x]) > np.pi:
                    agrees = False
        if not agrees:
            wrong = np.append(wrong, count)
    return count, wrong


@kernel()
def _grow(phase: Floats, right: Mask, down: Mask, label: _Labels) -> int:
    """Add to the islands their neighbours by sound links; how many there are."""
    height, width = phase.shape
    added = 0
    before = label.copy()
    for v in range(height):
        for u in range(width):
            if before[v, u]:
                continue
            for side in range(4):
                dv, du = (0, 0, 1, -1)[side], (1, -1, 0, 0)[side]
                y, x = v + dv, u + du
                if y < 0 or x < 0 or y >= height or x >= width or before[y, x] == 0:
                    continue
                if right[v, min(u, x)] if dv == 0 else down[min(v, y), u]:
                    label[v, u] = before[y, x]
                    phase[v, u] = phase[y, x] + _difference(phase[v, u], phase[y, x])
                    added += 1
                    break
    return added


def _join(phase: Floats, wrapped_phase: Floats, right: Mask, down: Mask, label: _Labels, count: int) -> None:
    """Join islands in place whose common border is sound for the most part and of one mind."""
    parent, turns = np.arange(count + 1), np.zeros(count + 1, np.int64)

    def root(island: int) -> tuple[int, int]:
        offset = 0
        while parent[island] != island:
            offset += int(turns[island])
            island = int(parent[island])
        return island, offset

    refused: set[int] = set()
    for a, b, change in _borders(phase, wrapped_phase, right, down, label):
        (root_a, turns_a), (root_b, turns_b) = root(a), root(b)
        if root_a != root_b:
            parent[root_b], turns[root_b] = root_a, change + turns_a - turns_b
        elif change + turns_a != turns_b:
            refused.add(root_a)
    at_odds = {root(island)[0] for island in refused}
    roots = (root(island) for island in range(count + 1))
    table = np.array([(k, 0) if into in at_odds else (into, by) for k, (into, by) in enumerate(roots)])
    phase += TWO_PI * table[label, 1]
    label[...] = table[label, 0]


def _borders(
    phase: Floats, wrapped_phase: Floats, right: Mask, down: Mask, label: _Labels
) -> Iterator[tuple[int, int, int]]:
    """Pairs of islands to join, the longest borders first, with the periods to add to the second."""
    pairs, sounds, changes = [], [], []
    for sound, a, b in (
        (right[:, :-1], np.s_[:, :-1], np.s_[:, 1:]),
        (down[:-1], np.s_[:-1], np.s_[1:]),
    ):
        at = (label[a] != label[b]) & (label[a] > 0) & (label[b] > 0)
        first, second = label[a][at], label[b][at]
        link = _wrapped(wrapped_phase[b][at] - wrapped_phase[a][at])
        turns = np.rint((phase[a][at] + link - phase[b][at]) / TWO_PI).astype(np.int64)
        swap = first > second
        pairs.append(np.stack([np.where(swap, second, first), np.where(swap, first, second)], axis=1))
        changes.append(np.where(swap, -turns, turns))
        sounds.append(sound[at])
    pair, sound, change = np.concatenate(pairs), np.concatenate(sounds), np.concatenate(changes)
    if not len(pair):
        return
    kinds, which = np.unique(pair, axis=0, return_inverse=True)
    which = which.reshape(-1)
    lengths, sound_lengths = np.bincount(which), np.bincount(which[sound], minlength=len(kinds))
    for k in np.argsort(-sound_lengths):
        own = change[(which == k) & sound]
        if sound_lengths[k] < ISLANDS.min_border_px or sound_lengths[k] < ISLANDS.sound_share * lengths[k]:
            continue
        value = int(np.median(own))
        if np.mean(own == value) >= ISLANDS.agreeing_share:
            yield int(kinds[k, 0]), int(kinds[k, 1]), value
