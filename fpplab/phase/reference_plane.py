"""Heights over a reference plane, from how far the fringes on it moved.

The projector's coordinate on a camera's ray is a fraction of the height h on it,
`u - u_plane = b h / (1 - a h)`, whatever the pinhole devices and wherever the plane. If both devices stand
at the distance L from the plane, their centres the baseline d apart, `a = 1/L` and `b = d/L` divided by the
mm on the plane to a projector px. Plates of known heights tell a and b of every pixel instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from fpplab.core.config import Document
from fpplab.core.conventions import Floats


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise ValueError("must not be 0")
    return value


_Length = Annotated[float, Field(gt=0, le=1e6)]
_SignedLength = Annotated[float, Field(ge=-1e6, le=1e6), AfterValidator(_not_zero)]


class Plate(Document):
    """A session of the plane, moved by a known height."""

    session: str
    """Folder of the session, next to the file or by path."""
    height_mm: _SignedLength
    """Height over the reference plane, towards the camera, in mm."""


class PlaneGeometry(Document):
    """How camera and projector stand over a reference plane."""

    distance_mm: _Length
    """Distance of both devices' centres from the plane."""
    baseline_mm: _SignedLength
    """Distance between their centres across the fringes; negative where the projector's coordinate falls with
    the height."""
    period_mm: _Length
    """Period of the fringes on the plane."""
    heights_mm: tuple[float, float] | None = None
    """Least and greatest height of everything that is seen, which tells orders of a single set of fringes."""
    plates: tuple[Plate, ...] = ()
    """At least two plates, which then tell what distance, baseline and period need to be known for to a
    quarter of a period only."""

    @model_validator(mode="after")
    def _is_possible(self) -> PlaneGeometry:
        if len({plate.height_mm for plate in self.plates}) == 1:
            raise ValueError("'plates' have one height: needs two different ones, or none")
        if self.heights_mm is not None and not self.heights_mm[0] < self.heights_mm[1] < self.distance_mm:
            raise ValueError(
                "'heights_mm': the first must be less than the second, and this than 'distance_mm'"
            )
        return self

    def model(self, period_px: float) -> HeightModel:
        """Give the model that distance, baseline and period tell, for a period in projector px."""
        px_per_mm = period_px / self.period_mm
        return HeightModel(1.0 / self.distance_mm, self.baseline_mm / self.distance_mm * px_per_mm)


@dataclass(frozen=True, eq=False)
class HeightModel:
    """How heights move the coordinate, of all pixels or of each, (height, width)."""

    bend: Floats | float  # a, in 1/mm
    slope: Floats | float  # b, in px/mm
    covariance: Floats | None = None  # of bend and slope at each pixel, (height, width, 2, 2)

    def displacement(self, height_mm: float) -> Floats:
        """Give the displacement of the coordinate in px at a height."""
        return np.asarray(self.slope * height_mm / (1.0 - self.bend * height_mm))

    def heights(self, displacement_px: Floats, sigma_px: Floats) -> tuple[Floats, Floats]:
        """Give heights in mm with their standard uncertainty."""
        divisor = self.slope + self.bend * displacement_px
        height = displacement_px / divisor
        variance = np.square(sigma_px * self.slope / divisor**2)
        if self.covariance is not None:
            by_bend, by_slope = -height * displacement_px / divisor, -height / divisor
            gradient = np.stack([by_bend, by_slope], axis=-1)
            variance = variance + np.einsum("...i,...ij,...j->...", gradient, self.covariance, gradient)
        return height, np.sqrt(variance)


def fit_plates(
    heights_mm: Sequence[float], displacements_px: Sequence[Floats], sigmas_px: Sequence[Floats]
) -> HeightModel:
    """Fit the model of every pixel to plates; NaN where fewer than two of them are measured."""
    # `u = b h + a h u`: linear in a and b, with the noise of u.
    known = np.isfinite(displacements_px) & np.isfinite(sigmas_px)
    moved, sigma = np.where(known, displacements_px, 0.0), np.where(known, sigmas_px, 1.0)
    tall = np.asarray(heights_mm, np.float64)[:, None, None]
    terms = np.stack([tall * moved, np.broadcast_to(tall, moved.shape)], axis=-1)
    weight = known / np.square(sigma)
    normal = np.einsum("khw,khwi,khwj->hwij", weight, terms, terms)
    right = np.einsum("khw,khwi,khw->hwi", weight, terms, moved)
    enough = known.sum(axis=0) >= 2
    normal[~enough] = np.eye(2)
    covariance = np.linalg.inv(normal)
    fitted = np.einsum("hwij,hwj->hwi", covariance, right)
    fitted[~enough] = np.nan
    return HeightModel(fitted[..., 0], fitted[..., 1], covariance)
