"""What every kind of fringe set is: images of `stripes` periods along an axis that together give a phase.

A kind is a file of this package with one class. It owns its patterns (`level`), its contribution to decoding
(`demodulation`), what a pixel may see of it when everything is in step (`waves`), its part of
a plan file (its fields) and its documentation (their docstrings). Plans, decoding and the proof of
synchronisation take it through this class alone.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from fpplab.core.config import Document
from fpplab.core.conventions import (
    TWO_PI,
    Axis,
    Floats,
    Lattice,
    axis_length,
    mirror_centres,
    phase_of_coordinate,
)

Width = Annotated[int, Field(gt=1)]


@dataclass(frozen=True, eq=False)
class Demodulation:
    """How the images of a set become a phase: sums of the images, N of them, with these weights.

    With `S = Σ sine_n I_n` and `C = Σ cosine_n I_n` the phase is `atan2(S, C) - origin_rad` and the
    modulation `B = scale sqrt(S² + C²)`; `Σ mean_n I_n` is the offset. The decoder takes what the mean
    square holds beyond offset² + B²/2 for misfit, which is right if the weights are those of a balanced set:
    `Σ exp(iδ_n)` and `Σ exp(2iδ_n)` vanish for its phase shifts δ_n.

    Attributes
    ----------
    sine, cosine, mean : ndarray of float64, (N,)
        Weights of the images.
    scale : float
        From the length of (S, C) to the modulation.
    origin_rad : float
        Phase of the coordinate where `2π stripes (u + 0.5)/W` is zero.
    """

    sine: Floats
    cosine: Floats
    mean: Floats
    scale: float
    origin_rad: float


class FringeSet(Document):
    """One set of fringe images: `stripes` periods across the projector along `axis`.

    Examples
    --------
    A kind of its own needs its fields, `images`, `phase_shifts` and what is abstract here::

        class Reordered(FringeSet):
            kind: Literal["reordered"]
            order: tuple[int, ...]
            ...
    """

    axis: Axis
    """Projector axis that the set codes: x for columns, y for rows."""

    stripes: Annotated[float, Field(gt=0)]
    """Periods across the whole projector along the axis; may be fractional."""

    projector_size: tuple[Width, Width] | None = None
    """(width, height) in px of the projector that the fringes were made for, where no rig says so."""

    @property
    @abstractmethod
    def images(self) -> int:
        """How many images the set has, N, at least 3."""

    @property
    def phase_noise(self) -> float:
        """Standard deviation of the phase in rad where that of a grey level equals the modulation."""
        return float(np.sqrt(2.0 / self.images))

    def phase_per_px(self, size: tuple[int, int]) -> float:
        """Slope of the phase in rad per px along its axis, on a projector of `size` (width, height)."""
        return TWO_PI * self.stripes / axis_length(size, self.axis)

    @abstractmethod
    def phase_shifts(self) -> Floats:
        """Give the phase shift δ_n of every image in its order, as it was projected.

        Returns
        -------
        ndarray of float64, (N,)
            rad, of a balanced set: see `Demodulation`.
        """

    @abstractmethod
    def demodulation(self) -> Demodulation:
        """Give the weights with which images become phase, modulation and offset.

        Called once for every decoding, both by the compiled decoder and by the reference.

        Returns
        -------
        Demodulation
            Weights of the N images.
        """

    @abstractmethod
    def wave(self, phase: Floats, step: int) -> Floats:
        """Give the level that one image shows at an absolute phase.

        Parameters
        ----------
        phase : ndarray of float64
            `2π stripes (u + 0.5)/W` in rad, any shape.
        step : int
            Index of the image in the set, 0 … N-1.

        Returns
        -------
        ndarray of float64
            Light in [0, 1], shaped as `phase`; neither clipped nor short of the range.
        """

    def level(self, step: int, size: tuple[int, int], lattice: Lattice) -> Floats:
        """Give one image as light, not quantised.

        Parameters
        ----------
        step : int
            Index of the image in the set, 0 … N-1.
        size : tuple of int
            (width, height) of the projector in mirrors.
        lattice : Lattice
            How the mirrors lie.

        Returns
        -------
        ndarray of float64, (height, width)
            Light in [0, 1].
        """
        u, v = mirror_centres(size, lattice)
        coordinate, length = (u if self.axis == "x" else v), axis_length(size, self.axis)
        return self.wave(phase_of_coordinate(coordinate, self.stripes, length), step)

    def waves(self, harmonics: int) -> Floats:
        """Give what a pixel may see of the set besides its offset: the proof of synchronisation's axes.

        Parameters
        ----------
        harmonics : int
            Harmonics of the fringe that the response may leave, at least 1.

        Returns
        -------
        ndarray of float64, (N, 2 * harmonics)
            Cosine and sine of every harmonic at every image.
        """
        shift = np.outer(self.phase_shifts(), np.arange(1, harmonics + 1))
        return np.asarray(np.stack([np.cos(shift), np.sin(shift)], axis=-1).reshape(self.images, -1))

    def pattern_id(self, index: int, step: int) -> str:
        """Name an image of the plan's set `index`, such as `02-x-64-003of12`; files are named by it."""
        return f"{index:02d}-{self.axis}-{self.stripes:g}-{step:03d}of{self.images}"


def indices_along(sets: Sequence[FringeSet], axis: Axis) -> tuple[int, ...]:
    """Indices of the fringe sets along one axis, fewest stripes first; empty where it is not coded."""
    chosen = (k for k, fringe in enumerate(sets) if fringe.axis == axis)
    return tuple(sorted(chosen, key=lambda k: sets[k].stripes))
