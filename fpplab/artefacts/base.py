"""The base class of every artefact and standard in `fpplab.artefacts.shapes`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fpplab.artefacts.lengths import FeatureLength
from fpplab.core.errors import ConfigError

if TYPE_CHECKING:
    import trimesh

Lengths = float | tuple[float, ...]  # a field of an artefact, in mm


@dataclass(frozen=True)
class Artefact(ABC):
    """A body of known shape, defined by lengths in mm.

    A subclass is a frozen dataclass in a file of its own in `fpplab.artefacts.shapes`; the file's name is the
    artefact's name on the command line and in configuration files. Every field is a `Lengths` with a default,
    the usual size. Listing names imports the files of that package, so they import trimesh in functions only.

    Frame: mm, base on z = 0, z up towards the viewer, centred on x = y = 0.
    """

    is_standard: ClassVar[bool] = False
    """True for a standard of acceptance tests, False for an artefact that clouds are compared with."""
    order: ClassVar[int] = 1000
    """Position in lists of names, smallest first; equal positions are sorted by name."""

    def __post_init__(self) -> None:
        for field in fields(self):
            values = np.atleast_1d(getattr(self, field.name))
            if values.size == 0 or not (np.isfinite(values).all() and (values > 0).all()):
                raise ConfigError(
                    f"{type(self).__name__}.{field.name}: {values.tolist()} must be lengths above 0 mm"
                )
        self.check_lengths()

    @abstractmethod
    def check_lengths(self) -> None:
        """Check that the lengths, which are finite and above 0 mm, give a solid (`ConfigError`)."""

    @abstractmethod
    def mesh(self) -> trimesh.Trimesh:
        """Build the surface of the body, watertight with outward normals, in mm in the artefact's frame."""

    def lengths(self) -> tuple[FeatureLength, ...]:
        """List the lengths that are measured in clouds of the body; none unless a subclass states them."""
        return ()

    def check_below(self, field: str, value: float, limit: float, limit_name: str) -> None:
        """Refuse a length in mm that is not less than a limit, called `limit_name`; for `check_lengths`."""
        if not value < limit:
            raise ConfigError(
                f"{type(self).__name__}.{field}: {value:g} mm must be less than {limit:g} mm, {limit_name}"
            )
