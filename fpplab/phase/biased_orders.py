"""Fringe orders that a bias between the sets makes wrong, found by what the frames show around a pixel.

Light that an object scatters shifts the phase of wide fringes. From half a period of the finer set on it
changes the order, and a whole period leaves no trace in the pixel itself. Its surroundings show it: where the
bias changes smoothly, the contradiction between the sets runs through half a period, and is followed from
there; where it changes at an edge, the coordinate jumps by whole periods along it, which no surface does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label, median, uniform_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from fpplab.core.conventions import TWO_PI, Floats, Map, Mask
from fpplab.patterns.recording import Recording
from fpplab.phase.demodulation import axis_phases
from fpplab.phase.error_model import ErrorModel
from fpplab.phase.limits import BIASED_ORDERS as LIMITS
from fpplab.phase.unwrapping import WavelengthSequence

_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])


def biased_orders(
    recording: Recording, sequence: WavelengthSequence, errors: ErrorModel, coordinate: Map, disagreement: Map
) -> Mask:
    """Find the pixels of one axis whose order the bias between its sets may have changed."""
    # coordinate, disagreement (height, width); returns (height, width)
    doubtful = np.zeros(coordinate.shape, np.bool_)
    if len(sequence.wavelengths) < 2:
        return doubtful
    step, length = LIMITS.step_px, recording.projector_size["xy".index(sequence.axis)]
    contradicted = disagreement[:: 2 * step, :: 2 * step] > LIMITS.min_disagreement
    if (9.0 * uniform_filter(contradicted.astype(np.float32), 3) > LIMITS.min_neighbours - 0.5).any():
        biased = _biased_samples(recording, sequence, errors)
        cells = np.repeat(np.repeat(biased, step, axis=0), step, axis=1)
        doubtful |= cells[: coordinate.shape[0], : coordinate.shape[1]]
    period = length / recording.plan.fringes[sequence.finest].stripes
    if _has_jumps_by_periods(coordinate, period):
        contradicting = _contradictory_parts(recording, sequence, errors)
        doubtful |= _across_jumps(np.where(doubtful, np.nan, coordinate), period, contradicting)
    return doubtful | _islands(doubtful, coordinate, period) if doubtful.any() else doubtful


def _sampled_contradictions(
    recording: Recording, sequence: WavelengthSequence, errors: ErrorModel
) -> tuple[list[tuple[Floats, Floats]], Mask]:
    """Contradictions of the sets with their noise at pixels spread over the image, and which are lit."""
    every = (slice(None, None, LIMITS.step_px),) * 2
    few = replace(recording, frames=[np.ascontiguousarray(frame[every]) for frame in recording.frames])
    measured = axis_phases(few, sequence, errors)
    noise = measured.position_sigma * measured.stripes[:, None, None]
    is_lit = (noise < LIMITS.max_noise_turns).all(axis=0)
    return list(_contradictions(measured.phases / TWO_PI, noise, sequence)), np.asarray(is_lit)


def _contradictory_parts(
    recording: Recording, sequence: WavelengthSequence, errors: ErrorModel
) -> Callable[[NDArray[np.int32], int], Mask]:
    """Give a function that tells in which of labelled parts of the image the sets contradict each other.

    A bias of whole periods leaves no contradiction, but none is that exactly; the edge of a part is.
    """
    contradictions, is_lit = _sampled_contradictions(recording, sequence, errors)

    def contradictory(parts: NDArray[np.int32], count: int) -> Mask:
        sampled = np.where(is_lit, parts[:: LIMITS.step_px, :: LIMITS.step_px], 0)
        every = np.arange(count)
        medians = [np.abs(np.nan_to_num(median(turns, sampled, every))) for turns, _ in contradictions]
        pixels = np.bincount(sampled.ravel(), minlength=count)
        # Of a part that no sampled pixel shows, nothing is known.
        return np.asarray((np.max(medians, axis=0) > LIMITS.min_part_bias_turns) | (pixels == 0))

    return contradictory


def _biased_samples(recording: Recording, sequence: WavelengthSequence, errors: ErrorModel) -> Mask:
    """Which of the pixels spread over the image lie where a bias may change the order."""
    contradictions, is_lit = _sampled_contradictions(recording, sequence, errors)
    biased = np.zeros(is_lit.shape, np.bool_)
    for turns, sigma in contradictions:
        biased |= _beyond_order(turns, sigma, is_lit)
    return np.asarray(binary_dilation(biased, _CROSS, LIMITS.margin_steps))


def _contradictions(
    turns: Floats, noise: Floats, sequence: WavelengthSequence
) -> Iterator[tuple[Floats, Floats]]:
    """How each wavelength's phase differs from that which the coarser predict, and its noise, in turns."""
    coefficients = [np.array(wavelength.coefficients, np.float64) for wavelength in sequence.wavelengths]
    phases = [np.tensordot(own, turns, 1) % 1.0 for own in coefficients]
    sigmas = [np.sqrt(np.tensordot(own**2, noise**2, 1)) for own in coefficients]
    position = phases[0] / sequence.wavelengths[0].stripes
    for k, (coarse, fine) in enumerate(pairwise(sequence.wavelengths), start=1):
        off = position * fine.stripes - phases[k]
        order = np.floor(off + 0.5)
        yield off - order, np.hypot(sigmas[k - 1] * fine.stripes / coarse.stripes, sigmas[k])
        position = (order + phases[k]) / fine.stripes


def _beyond_order(turns: Floats, sigma: Floats, is_lit: Mask) -> Mask:
    """Where the contradiction, followed from place to place, comes near half a period or beyond."""
    share = np.maximum(uniform_filter(is_lit.astype(np.float64), 3), 1e-9)
    waves = np.where(is_lit, np.exp(1j * TWO_PI * turns), 0.0)
    mean = (uniform_filter(waves.real, 3) + 1j * uniform_filter(waves.imag, 3)) / share
    known = is_lit & (share >= LIMITS.min_lit_share)
    scatter = np.sqrt(-2.0 * np.log(np.clip(np.abs(mean), 1e-9, 1.0))) / TWO_PI
    uneven = known & (scatter > np.maximum(LIMITS.max_scatter_turns, 2.0 * sigma))
    known &= ~uneven
    bias, parts = _followed(np.angle(mean) / TWO_PI, known)
    beyond = uneven
    spread = np.maximum(sigma, scatter)
    max_bias = np.maximum(0.5 - LIMITS.beyond_sigmas * spread, LIMITS.min_bias_turns)
    for part in range(parts.max(initial=-1) + 1):
        inside = parts == part
        orders, pixels = np.unique(np.round(bias[inside]), return_counts=True)
        largest = pixels.max()
        if len(pixels) > 1 and np.sort(pixels)[-2] * LIMITS.min_majority > largest:
            beyond |= inside
        else:
            beyond |= inside & (np.abs(bias - orders[pixels.argmax()]) > max_bias)
    return np.asarray(beyond)


def _followed(turns: Floats, known: Mask) -> tuple[Floats, NDArray[np.int64]]:
    """Count turns on from neighbour to neighbour, by the least changes; label the parts that are joined."""
    nodes = np.full(turns.shape, -1)
    nodes[known] = np.arange(known.sum())
    pairs = np.concatenate(
        [
            np.stack([first[both], second[both]], axis=1)
            for first, second in ((nodes[:-1], nodes[1:]), (nodes[:, :-1], nodes[:, 1:]))
            for both in [(first >= 0) & (second >= 0)]
        ]
    )
    values, count = turns[known], int(known.sum())
    change = np.diff(values[pairs], axis=1)[:, 0]
    change = np.abs(change - np.round(change)) + 1e-6  # a weight of zero would be no connection
    graph = minimum_spanning_tree(coo_array((change, pairs.T), (count + 1, count + 1)))
    _, labels = connected_components(graph, directed=False)
    # From one more node, all parts are reached at once.
    starts = np.unique(labels[:count], return_index=True)[1]
    star = coo_array((np.ones(len(starts)), (starts, np.full(len(starts), count))), graph.shape)
    order, before = breadth_first_order(graph + star, count, directed=False)
    for node in order[1:]:
        if before[node] != count:
            values[node] -= np.round(values[node] - values[before[node]])
    followed, parts = np.full(turns.shape, np.nan), nodes
    followed[known], parts[known] = values, labels[:count]
    return followed, parts


def _has_jumps_by_periods(coordinate: Map, period: float) -> bool:
    """Whether more steps from pixel to pixel are whole periods than those of edges are by chance."""
    every = slice(None, None, LIMITS.searched_px)
    rows, columns = _jumps(coordinate[every], period, 1), _jumps(coordinate[:, every], period, 0)
    near, far = (int(rows[k].sum() + columns[k].sum()) for k in (0, 1))
    return near > far + LIMITS.min_jumps


def _jumps(coordinate: Map, period: float, axis: int) -> tuple[Mask, Mask]:
    """Which steps from pixel to pixel are whole periods, and which others are above half a period."""
    # The surface itself goes on as it did one pixel before.
    change = np.diff(coordinate, axis=axis) / np.float32(period)
    periods = np.diff(change, axis=axis, prepend=np.take(change, [0], axis=axis))
    whole = np.round(periods)
    near = (whole != 0.0) & (np.abs(periods - whole) < LIMITS.near_period)
    return near, (np.abs(periods) > 0.5) & ~near


def _parts(coordinate: Map, period: float) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    """Label the parts over which the coordinate changes by less than half a period; count their pixels."""
    is_border = np.isnan(coordinate)
    is_border[:-1] |= np.abs(np.diff(coordinate, axis=0)) > 0.5 * period
    is_border[:, :-1] |= np.abs(np.diff(coordinate, axis=1)) > 0.5 * period
    parts, count = label(~is_border)
    return parts, np.bincount(parts.ravel(), minlength=count + 1)


def _across_jumps(
    coordinate: Map, period: float, contradictory: Callable[[NDArray[np.int32], int], Mask]
) -> Mask:
    """Parts of the image that a border of jumps by whole periods separates from greater parts.

    Edges of a part jump by whole periods by chance, all along; there the sets do not contradict each other.
    """
    near = [_jumps(coordinate, period, axis)[0] for axis in (0, 1)]
    parts, pixels = _parts(coordinate, period)
    # The border is the pixel before the jump: the parts are those before and after it.
    before = [parts[:-2][near[0][1:]], parts[:, :-2][near[1][:, 1:]]]
    after = [parts[2:][near[0][1:]], parts[:, 2:][near[1][:, 1:]]]
    pairs = np.sort(np.stack([np.concatenate(before), np.concatenate(after)]), axis=0)
    pairs = pairs[:, (pairs[0] > 0) & (pairs[0] != pairs[1])]
    dropped, is_contradictory = np.zeros(len(pixels), np.bool_), contradictory(parts, len(pixels))
    borders, lengths = np.unique(pairs, axis=1, return_counts=True)
    for first, second, jumps in zip(*borders, lengths, strict=True):
        if jumps < LIMITS.min_border_px or not (is_contradictory[first] or is_contradictory[second]):
            continue
        smaller, greater = sorted((first, second), key=lambda part: pixels[part])
        dropped[smaller] = True
        dropped[greater] |= pixels[smaller] * LIMITS.min_majority > pixels[greater]
    return np.asarray(dropped[parts])


def _islands(doubtful: Mask, coordinate: Map, period: float) -> Mask:
    """Smaller parts of the image that doubtful ones touch: nothing tells that the bias ends at them."""
    parts, pixels = _parts(np.where(doubtful, np.nan, coordinate), period)
    touching = np.unique(parts[binary_dilation(doubtful, _CROSS, 2)])
    is_main = pixels * LIMITS.min_majority > pixels[1:].max(initial=1)
    islands = np.isin(parts, touching[(touching > 0) & ~is_main[touching]])
    # Of the pixel at a border, the side is not known.
    return np.asarray(islands | ((parts == 0) & binary_dilation(doubtful | islands, _CROSS, 2)))
