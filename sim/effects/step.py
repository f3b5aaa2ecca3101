"""What an effect is given to match it to a bench; `sim.matching` fulfils it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, Self, TypeVar

import numpy as np

from fpplab.core.conventions import Floats

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


RoomSource = Literal["all", "lamps", "even"]
"""Which light of the room: all, that of its lamps, or what comes evenly from all sides."""


@dataclass(frozen=True)
class Ripple:
    """Rippling light of the room that was found."""

    amplitude: float  # as a share of the room's light
    amplitude_sigma: float  # standard uncertainty of that, relative
    period_px: float  # from band to band, in rows of the image
    period_sigma: float  # standard uncertainty of the period, relative
    advance: float | None  # periods from frame to frame; None where frames do not agree on one
    gained: float  # by how much Schwarz's criterion is lower than that of steady light
    source: RoomSource = "all"  # of the light


@dataclass(frozen=True, eq=False)
class RandomDisplacement:
    """Random displacements of every frame, independent from frame to frame."""

    isotropic: float  # standard deviation of the part that is equally large in all directions
    axis: Floats  # standard deviation (k,) along an axis, with signs that give its direction

    @property
    def covariance(self) -> Floats:
        return np.asarray(self.isotropic**2 * np.eye(len(self.axis)) + np.outer(self.axis, self.axis))

    @property
    def free(self) -> int:
        return int(self.isotropic > 0) + len(self.axis) * int(self.axis.any())


@dataclass(frozen=True, eq=False)
class FrameFluctuation:
    """What changes in a series besides noise."""

    random: RandomDisplacement  # from frame to frame
    oscillation: Floats  # RMS value (k,) of the oscillation; 0 for none
    cycles_per_frame: float  # of the oscillation
    cycles_sigma: float  # standard uncertainty of that
    sigma: float  # standard uncertainty of the size of oscillation or random numbers, relative
    gained: float  # by how much Schwarz's criterion is lower than that of noise alone

    @property
    def size(self) -> float:
        """RMS value of all that changes, over all components together."""
        return float(np.sqrt(np.trace(self.random.covariance) + self.oscillation @ self.oscillation))


@dataclass(frozen=True, eq=False)
class ReprojectionErrors:
    """How large the errors of a characterisation are, in its own poses and in poses left out."""

    px2: Floats  # mean squares (2, 2) of both, in camera and projector, in px²
    sigma_px2: Floats  # standard uncertainties of them


class MatchedParameters(Protocol):
    """Parameters of a twin, of which an effect knows its own."""

    def with_effect(self, effect: DataclassInstance, **sigma: float) -> Self:
        """Replace an effect's parameters, with their standard uncertainties by name; 0 takes one away."""


ParametersT = TypeVar("ParametersT", bound=MatchedParameters)


class StepContext(Protocol[ParametersT]):
    """Recordings of a bench, the twin so far, and the fits that an effect's step may use."""

    @property
    def white(self) -> str:
        """Name of the parameter that scales the levels."""

    @property
    def parameters(self) -> ParametersT:
        """Parameters of the twin from which the step starts."""

    def with_parameters(self, parameters: ParametersT) -> Self:
        """Give the same with other parameters of the twin."""

    def light_parameters(self, *more: str) -> tuple[str, ...]:
        """Name the parameters of light that are free, and more."""

    def fit(self, *names: str) -> ParametersT:
        """Fit parameters of light and sharpness to the recordings."""

    def criterion(self, free: int) -> float:
        """Compute Schwarz's criterion, by the number of free parameters."""

    def search_lamp(self, linear: Sequence[str]) -> ParametersT:
        """Search for a lamp of the room from which to fit; linear: names of what is fitted with it."""

    def fluctuation(
        self, of: Literal["projector", "room", "position"], oscillates: bool = True
    ) -> FrameFluctuation:
        """Estimate how light, relative, or the item's position in mm changes from frame to frame."""

    def reprojection_errors(self) -> tuple[ReprojectionErrors, ReprojectionErrors]:
        """Compute the errors of the bench's characterisation, and of that of the twin's own frames."""

    def room_ripple(self) -> Ripple | None:
        """Find the ripple of the room's light; None where steady light explains the frames as well."""
