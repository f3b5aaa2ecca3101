"""Recordings: the frames that a camera took of a plan's patterns, with all that decoding needs."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fpplab.core import buffers
from fpplab.core.compiled import kernel
from fpplab.core.conventions import Axis, Floats, Image, Lattice, Map, full_scale, raw_per_grey
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError, DataError
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.mosaic import Bayer, colours_at, mean_of, without_mosaic
from fpplab.patterns.motion import Compensation
from fpplab.patterns.phase_error import relative_harmonics
from fpplab.patterns.plan import Plan

_BAND = 32
"""Rows whose mean is taken at a time (chosen): their sums stay in the cache."""


@dataclass(frozen=True)
class KnownCoordinate:
    """A projector coordinate that somebody knows, by a mark or by the distance of a point."""

    pixel: tuple[int, int]  # of the camera (column, row)
    coordinate: float  # of the projector in px, along the axis that neighbours unwrap


@dataclass(frozen=True, eq=False)
class MergedLevels:
    """What the levels of frames mean that were merged from several exposures (`fpplab.phase.exposures`)."""

    headroom: float  # full scale of the merged frames, in full scales of the camera
    # (height, width) by set of the plan: levels of each pixel per level of the longest exposure. Frames have
    # the noise that the camera has at this level; light of neighbouring pixels is compared without the scale.
    scales: tuple[Map, ...]
    noise: tuple[float, float]  # variance of a merged level at 0, and its increase per level, in grey levels


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of a plan, from a session, a simulation or anywhere else, on their way to be decoded.

    Attributes
    ----------
    frames : sequence of ndarray of uint8 or uint16, (height, width) each
        Raw frames in the plan's order; memory-mapped or not.
    plan : Plan
        What was projected.
    projector_size : tuple of int
        (width, height) in px of the projector that showed it.
    bits : int
        Depth of the frames' grey levels; full scale is 2^bits - 1.
    name : str
        What the frames are called in messages.
    response : Curve or None
        The measured response of the projector and camera, where it is known.
    depth : DepthRange or None
        Between which distances everything lies, where plan or rig state it.
    is_imported : bool
        Whether the frames are a session's that another program recorded.
    lattice : Lattice
        How the projector's mirrors lie, which edges of codes follow.
    known : tuple of KnownCoordinate
        Points whose coordinate is known, from which spatial unwrapping takes the orders of their islands.
    merged : MergedLevels or None
        Where the frames are merged from several exposures; one frame for each image of the plan.
    bayer : str or None
        Colours of the camera's filter, such as "RGGB"; None of a camera without. Frames are not interpolated.
    times_s : tuple of float
        When each frame was taken; empty where nobody knows, and frames follow evenly.
    motion : Compensation or None
        How parts moved, where frames are given as those of parts at rest.
    rows : ndarray of int, (height,), or None
        Which rows of the camera's image the frames consist of; None for all of them.
    """

    frames: Sequence[Image]
    plan: Plan
    projector_size: tuple[int, int]
    bits: int = 8
    name: str = "frames"
    response: Curve | None = None
    depth: DepthRange | None = None
    is_imported: bool = False
    lattice: Lattice = Lattice.SQUARE
    known: tuple[KnownCoordinate, ...] = ()
    merged: MergedLevels | None = None
    bayer: Bayer | None = None
    times_s: tuple[float, ...] = ()
    motion: Compensation | None = None
    rows: NDArray[np.intp] | None = None

    def __repr__(self) -> str:
        height, width = self.frames[0].shape if self.frames else (0, 0)
        frames = f"{len(self.frames)} frames of {width} x {height} px, {self.bits} bits"
        return f"<Recording {self.name}: {frames}; {self.plan!r}>"

    @property
    def grey(self) -> float:
        """8-bit grey levels to one unit of the raw frames."""
        return (self.merged.headroom if self.merged else 1.0) / raw_per_grey(self.bits)

    def light(self, levels: NDArray[Any]) -> NDArray[Any]:
        """Give levels (height, width) that compare pixels, whatever their exposures and Bayer colours are."""
        if self.merged is not None:
            levels = np.asarray(levels / self._scale(), np.float32)
        return levels if self.bayer is None else without_mosaic(levels)

    def _scale(self, index: int | None = None) -> Map:
        """Scale of a set of merged frames, by default the finest: all have the same where there are codes."""
        assert self.merged is not None
        plan = self.plan
        of_all = len(plan.fringe_indices) < len(plan.sets)
        return self.merged.scales[0 if of_all else plan.finest_set() if index is None else index]

    def _of_sets(self, plan: Plan, indices: Sequence[int]) -> Recording:
        frames = [frame for k in indices for frame in self.of_set(k)]
        merged = self.merged and replace(self.merged, scales=tuple(self.merged.scales[k] for k in indices))
        return replace(self, plan=plan, frames=frames, merged=merged)

    def part(self, chosen: tuple[slice, slice]) -> Recording:
        """Take some rows and columns of every frame."""
        frames = [np.ascontiguousarray(frame[chosen]) for frame in self.frames]
        merged = self.merged and replace(self.merged, scales=tuple(s[chosen] for s in self.merged.scales))
        return replace(self, frames=frames, merged=merged, motion=None)

    @cached_property
    def harmonics(self) -> Floats | None:
        """Harmonics that the response causes, relative to the fringe; None where no response is known.

        Patterns that the plan corrects are shown through the inverse of its response.
        """
        return None if self.response is None else relative_harmonics(self.response, self.plan.response)

    @property
    def full_scale(self) -> int:
        """The raw value at which a pixel is saturated."""
        return full_scale(self.bits)

    def of_set(self, index: int) -> Sequence[Image]:
        """Give the frames of one of the plan's sets, by its index."""
        first, end = self.plan.set_starts[index : index + 2]
        return self.frames[first:end]

    def finest(self, axis: Axis | None = None) -> tuple[FringeSet, Sequence[Image]]:
        """Give the finest fringe set and its frames; by default along the first axis that is coded."""
        index = self.plan.finest_set(axis)
        return self.plan.fringes[index], self.of_set(index)

    @property
    def fringe_part(self) -> Recording | None:
        """The fringe sets alone, with their frames; None where the plan has none."""
        part = self.plan.fringe_part
        if part is None or part is self.plan:
            return None if part is None else self
        return self._of_sets(part, self.plan.fringe_indices)

    @property
    def typical_frame(self) -> Image:
        """A frame that shows the scene under its finest fringes, or under a code where there are none."""
        if part := self.fringe_part:
            shown = part.finest()[1][0]
        else:
            shown = self.of_set(next(k for k, each in enumerate(self.plan.sets) if each.coded_axis))[-1]
        if self.merged is None:
            return shown
        return np.minimum(self.light(shown) * self.merged.headroom, self.full_scale).astype(np.uint16)

    def along(self, axis: Axis) -> Recording:
        """Take plan and frames of the fringe sets along one axis alone."""
        return self._of_sets(self.plan.along(axis), self.plan.sets_along(axis))

    def mean_image(self, index: int | None = None) -> NDArray[np.uint8]:
        """Give the scene under even light, 8 bits: the mean of a set's frames, by default the finest's."""
        if index is None:
            return self._evenly_lit_mean
        index = range(len(self.plan.sets))[index]
        return self._mean_of(self.of_set(index), index)

    @cached_property
    def _evenly_lit_mean(self) -> NDArray[np.uint8]:
        return self._mean_of(self._evenly_lit(), None)

    def _mean_of(self, frames: Sequence[Image], index: int | None) -> NDArray[np.uint8]:
        if self.bayer:
            even = self.light(mean_of(frames, self.grey))
            return np.asarray(np.rint(np.clip(even, 0.0, 255.0)), np.uint8)
        height, width = frames[0].shape
        mean, divisor = buffers.empty((height, width), np.uint8), np.float32(len(frames) / self.grey)

        def average(first: int) -> None:
            rows = slice(first, first + _BAND)
            total = np.zeros(mean[rows].shape, np.float32)
            for frame in frames:
                _add(frame[rows], total)
            if self.merged:
                total /= self._scale(index)[rows]
            _round(total, divisor, mean[rows])

        with ThreadPoolExecutor() as threads:
            list(threads.map(average, range(0, height, _BAND)))
        return mean

    def colours(self, pixels: NDArray[np.int32]) -> Floats | None:
        """Give red, green and blue (N, 3) in 8-bit grey levels at pixels (u, v); None without colours."""
        of_leds = [light for led in ("red", "green", "blue") if (light := self._even_light(led)) is not None]
        if len(of_leds) == 3:
            return np.asarray(
                np.stack([light[pixels[:, 1], pixels[:, 0]] for light in of_leds], axis=1), np.float64
            )
        if self.bayer is None:
            return None
        light = self._even_light(None)
        if light is None:
            light = mean_of(self._evenly_lit(), self.grey)
            if self.merged:
                light = light / self._scale()
        return colours_at(light, self.bayer, pixels)

    def _even_light(self, led: str | None) -> Map | None:
        """White under one LED or all, less black under the same where it is shown; None without white."""
        frames: dict[float, list[Image]] = {1.0: [], 0.0: []}
        for image, (index, step, _) in enumerate(self.plan.steps()):
            shown = self.plan.sets[index]
            if shown.coded_axis is None and shown.one_led == led:
                frames.get(float(shown.light(step, np.zeros(1), 1)[0]), []).append(self.frames[image])
        if not frames[1.0]:
            return None
        light = mean_of(frames[1.0], self.grey)
        if frames[0.0]:
            light = light - mean_of(frames[0.0], self.grey)
        return light if self.merged is None else np.asarray(light / self._scale(), np.float32)

    def _evenly_lit(self) -> Sequence[Image]:
        """Frames whose mean is the scene under even light: of fringes, of white, or of all codes."""
        if part := self.fringe_part:
            return part.finest()[1]
        images = [k for k, (index, step, _) in enumerate(self.plan.steps()) if self._is_white(index, step)]
        return [self.frames[k] for k in images] or self.frames

    def _is_white(self, index: int, step: int) -> bool:
        shown = self.plan.sets[index]
        if shown.coded_axis or shown.one_led:
            return False
        return bool(shown.light(step, np.zeros(1), 1)[0] > 0.5)

    def checked(self) -> Recording:
        """Make sure that the frames are the plan's, contiguous and in native byte order."""
        _check_number(self)
        for n, frame in enumerate(self.frames):
            _check_same_format(self.name, n, frame, self.frames[0])
        _check_depth(self)
        self.plan.check_projector(self.projector_size, self.name)
        _check_known(self)
        if all(type(f) is np.ndarray and f.flags.c_contiguous and f.dtype.isnative for f in self.frames):
            return self  # with what is remembered of it
        native = [cast(Image, np.ascontiguousarray(f, f.dtype.newbyteorder("="))) for f in self.frames]
        return replace(self, frames=native)


@kernel(nogil=True)
def _add(frame: Image, total: Map) -> None:
    for v in range(len(total)):
        for u in range(total.shape[1]):
            total[v, u] += np.float32(frame[v, u])


@kernel(nogil=True)
def _round(total: Map, divisor: np.float32, mean: NDArray[np.uint8]) -> None:
    for v in range(len(total)):
        for u in range(total.shape[1]):
            mean[v, u] = np.uint8(min(np.rint(total[v, u] / divisor), np.float32(255)))


def _check_number(recording: Recording) -> None:
    count, planned = len(recording.frames), recording.plan.images
    if count != planned:
        raise DataError(
            f"{recording.name}: holds {count} frames, but the plan takes {planned}; give all of them"
        )


def _check_known(recording: Recording) -> None:
    height, width = recording.frames[0].shape
    for point in recording.known:
        if not (0 <= point.pixel[0] < width and 0 <= point.pixel[1] < height):
            raise ConfigError(
                f"--known: pixel {point.pixel[0]}, {point.pixel[1]} is none of the frames' {width} x {height}"
            )


def _check_same_format(name: str, number: int, frame: Image, first: Image) -> None:
    if frame.ndim != 2 or frame.size == 0:
        raise DataError(
            f"{name}: frame {number} has the shape {frame.shape}; a grey image (height, width) is needed"
        )
    if frame.shape != first.shape:
        raise DataError(f"{name}: frame {number} is {_size(frame)} pixels, but frame 0 is {_size(first)}")
    if frame.dtype != first.dtype:
        raise DataError(
            f"{name}: frame {number} is {frame.dtype}, but frame 0 is {first.dtype}; use one type"
        )


def _check_depth(recording: Recording) -> None:
    kind, bits = recording.frames[0].dtype, recording.bits
    if kind.kind != "u" or kind.itemsize > 2:
        raise DataError(f"{recording.name}: frames are {kind}; raw frames are uint8 or uint16")
    lower, upper = (8, 8) if kind.itemsize == 1 else (8, 16)
    if not lower <= bits <= upper:
        raise DataError(
            f"{recording.name}: frames are {kind}, which cannot hold {bits} bits; {lower} to {upper}"
        )


def _size(frame: Image) -> str:
    return f"{frame.shape[1]} x {frame.shape[0]}"
