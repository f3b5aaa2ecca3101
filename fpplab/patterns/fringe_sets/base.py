"""What every kind of a plan's sets is: images that a projector shows one after the other.

A kind is a file of this package with one class. It owns its patterns (`light`), what a pixel may see of it
when everything is in step (`waves`), its part of a plan file (its fields) and its documentation (their
docstrings). Plans, decoding and the proof of synchronisation take it through these classes alone.

`PatternSet` is any set. A `CodeSet` is one whose light depends on the coordinate along one axis, and a
`PeriodicSet` one that repeats itself. A `FringeSet` gives a phase by itself (`demodulation`).
"""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from fpplab.core.config import Document
from fpplab.core.conventions import (
    TWO_PI,
    Axis,
    Floats,
    Lattice,
    axis_length,
    mirror_centres,
    phase_of_coordinate,
    phase_steps,
)

MAX_PATTERN_BITS = 8
"""Bits per mirror of a pattern at most, and by default: those of its grey levels 0 to 255."""

PatternBits = Annotated[int, Field(ge=1, le=MAX_PATTERN_BITS)]
Width = Annotated[int, Field(gt=1)]
ExposureTime = Annotated[float, Field(gt=0, le=60)]  # in s
LedName = Literal["red", "green", "blue"]


@dataclass(frozen=True, eq=False)
class Demodulation:
    """How the images of a set become a phase: sums of the images, N of them, with these weights.

    With `S = Σ sine_n I_n` and `C = Σ cosine_n I_n` the phase is `atan2(S, C) - origin_rad` and the
    modulation `B = scale sqrt(S² + C²)`; `Σ mean_n I_n` is the offset. The decoder takes what the mean
    square holds beyond offset² + B²/2 for misfit, which is right if the weights are those of a balanced set:
    `Σ exp(iδ_n)` and `Σ exp(2iδ_n)` vanish for its phase shifts δ_n.
    """

    sine: Floats  # (N,) weights of the images
    cosine: Floats
    mean: Floats
    scale: float  # from the length of (S, C) to the modulation
    origin_rad: float  # phase of the coordinate where `2π stripes (u + 0.5)/W` is zero


class PatternSet(Document):
    """Images of one kind, one after the other.

    Examples
    --------
    A kind of its own needs its fields and what is abstract here::

        class Checks(CodeSet):
            kind: Literal["checks"]
            cells: int
            ...
    """

    projector_size: tuple[Width, Width] | None = None
    """(width, height) in px of the projector that the images were made for, where no rig says so."""

    pattern_bits: PatternBits | None = None
    """Bits per mirror in which the images are projected; by default 8. A projector shows fewer faster.

    Levels between the few that there are, are dithered: the blur of the projector's lens takes off most of
    the error. One bit is enough for codes of black and white.
    """

    @model_serializer(mode="wrap")
    def _with_kind(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Name the kind, which is a default, in files that leave defaults out."""
        field = type(self).model_fields["kind"]
        return handler(self) if field.exclude else {"kind": field.default, **handler(self)}

    @classmethod
    def completed(cls, entry: dict[str, Any], folder: Path) -> dict[str, Any]:
        """Put what files in a plan's folder hold into an entry of the plan file that names them."""
        return entry

    @classmethod
    def guessed(
        cls, images: Sequence[NDArray[np.bool_]], edges: Sequence[int], axis: Axis | None, length: int
    ) -> dict[str, Any] | None:
        """Guess the fields of a set of the kind from images of two levels; None where it has others."""
        # images: whether lit pixels (P,) are bright; edges: changes between neighbouring pixels in each;
        # axis: along which they change, None of even light; length: of the projector along it in px
        return None

    @property
    def coded_axis(self) -> Axis | None:
        """The projector axis along which the light changes; None where it is even."""
        return None

    @property
    def one_led(self) -> LedName | None:
        """The one LED that lights the images; None for all that are on."""
        return None

    @property
    @abstractmethod
    def images(self) -> int:
        """How many images the set has, N."""

    @property
    def bit_depth(self) -> int:
        """Bits per mirror in which the images are projected."""
        return self.pattern_bits or MAX_PATTERN_BITS

    @abstractmethod
    def light(self, step: int, coordinate: Floats, length: int) -> Floats:
        """Give the light in [0, 1] of image `step`, 0 … N-1, as it is shown at coordinates in px."""
        # along the coded axis, as the length of the projector is

    def level(self, step: int, size: tuple[int, int], lattice: Lattice) -> Floats:
        """Give one image (height, width) as light in [0, 1], not quantised, on a projector of this size."""
        u, v = mirror_centres(size, lattice)
        axis = self.coded_axis or "x"
        return self.light(step, u if axis == "x" else v, axis_length(size, axis))

    def waves(self, harmonics: int) -> Floats:
        """Give what a pixel may see besides its offset, (N, M): the axes of the proof of synchronisation."""
        # harmonics: those that the response may leave of a fringe, at least 1. By default every image may
        # have any level, which proves nothing.
        return np.eye(self.images)

    def pattern_id(self, index: int, step: int) -> str:
        """Name an image of the plan's set `index`, such as `02-x-64-003of12`; files are named by it."""
        name = "-".join(filter(None, (self.coded_axis, self.short_name)))
        return f"{index:02d}-{name}-{step:03d}of{self.images}"

    def other_orders(self) -> Iterator[tuple[str, NDArray[np.int64]]]:
        """Give orders (N,) in which other programs show such images, with their meaning and what to write."""
        yield from ()

    def finest_stripes(self, length: int) -> float:
        """Give how fine the set is: periods of its finest pattern across a projector of this length in px."""
        return length / 2.0

    @property
    @abstractmethod
    def short_name(self) -> str:
        """What tells the set from others in names of patterns and lists, letters and digits."""

    def fault(self, length: int) -> str | None:
        """Say why a projector of this length in px cannot show the set, or a plan not use it."""
        return None


class CodeSet(PatternSet):
    """Images whose light depends on the coordinate along one axis."""

    axis: Axis
    """Projector axis that the set codes: x for columns, y for rows."""

    @property
    def coded_axis(self) -> Axis | None:
        return self.axis


class PeriodicSet(CodeSet):
    """Images of `stripes` periods along an axis, each shifted by a phase of its own."""

    stripes: Annotated[float, Field(gt=0)]
    """Periods across the whole projector along the axis; may be fractional."""

    @abstractmethod
    def phase_shifts(self) -> Floats:
        """Give the phase shift δ_n of every image in its order, as it was projected, (N,) in rad."""

    @abstractmethod
    def wave(self, phase: Floats, step: int) -> Floats:
        """Give the level in [0, 1] of image `step`, 0 … N-1, at phases `2π stripes (u + 0.5)/W` in rad."""
        # neither clipped nor short of the range

    def light(self, step: int, coordinate: Floats, length: int) -> Floats:
        """Give `wave` at the phase of each coordinate."""
        return self.wave(phase_of_coordinate(coordinate, self.stripes, length), step)

    def waves(self, harmonics: int) -> Floats:
        """Give cosine and sine of every harmonic at every image, (N, 2 * harmonics)."""
        shift = np.outer(self.phase_shifts(), np.arange(1, harmonics + 1))
        return np.asarray(np.stack([np.cos(shift), np.sin(shift)], axis=-1).reshape(self.images, -1))

    def finest_stripes(self, length: int) -> float:
        """Give its stripes."""
        return self.stripes

    @property
    def short_name(self) -> str:
        return f"{self.stripes:g}"

    def fault(self, length: int) -> str | None:
        """Refuse stripes that the projector cannot resolve."""
        if self.stripes <= length / 2:
            return None
        return (
            f"stripes' is {self.stripes:g}: more than half of the projector's {length} pixels along "
            f"{self.axis}; at most {length / 2:g}"
        )


class FringeSet(PeriodicSet):
    """One set of fringe images, which together give a phase: its shifts are balanced (`Demodulation`)."""

    exposures_s: Annotated[tuple[ExposureTime, ...] | None, Field(min_length=1, max_length=8)] = None
    """Exposures of the set's images in s, in place of those of the plan; of plans of fringes alone."""

    @property
    def phase_noise(self) -> float:
        """Standard deviation of the phase in rad where that of a grey level equals the modulation."""
        return float(np.sqrt(2.0 / self.images))

    def phase_per_px(self, size: tuple[int, int]) -> float:
        """Slope of the phase in rad per px along its axis, on a projector of `size` (width, height)."""
        return TWO_PI * self.stripes / axis_length(size, self.axis)

    @abstractmethod
    def demodulation(self) -> Demodulation:
        """Give the weights with which images become phase, modulation and offset, once for every decoding."""


class SteppedFringes(FringeSet):
    """Images shifted by equal steps, also those of other programs."""

    steps: Annotated[int, Field(ge=3, le=1000)]
    """Images N, shifted by 2π/N each."""

    shift_sign: Literal[1, -1] = 1
    """-1 where the images were shifted the other way."""

    phase_origin_rad: float = 0.0
    """Phase in rad that the fringes have where `2π stripes (u + 0.5)/W` is zero."""

    @property
    def images(self) -> int:
        return self.steps

    def phase_shifts(self) -> Floats:
        """Give `δ_n = 2π n/N`, by the sign of the set."""
        # returns (N,)
        return self.shift_sign * phase_steps(self.steps)


def indices_along(sets: Sequence[FringeSet], axis: Axis) -> tuple[int, ...]:
    """Indices of the fringe sets along one axis, fewest stripes first; empty where it is not coded."""
    chosen = (k for k, fringe in enumerate(sets) if fringe.axis == axis)
    return tuple(sorted(chosen, key=lambda k: sets[k].stripes))
