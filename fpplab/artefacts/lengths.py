"""Lengths of an artefact that can be measured in a cloud, each between two features of its true surface."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from fpplab.core.conventions import Floats


@dataclass(frozen=True, eq=False)
class FlatFace:
    """One or more parts of a plane surface."""

    outlines: tuple[Floats, ...]  # corners (n, 3) in mm of each part, which is convex

    @property
    def origin(self) -> Floats:
        """A point (3,) in mm on the face: the mean of its corners."""
        return np.asarray(np.concatenate(self.outlines).mean(axis=0))

    @cached_property
    def axes(self) -> Floats:
        """Unit vectors in rows (3, 3): two along the face, and its outward normal."""
        corners = self.outlines[0]
        normal = np.sum([np.cross(a, b) for a, b in pairwise([*corners - corners[0]])], axis=0)
        normal /= np.linalg.norm(normal)
        first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(normal, first), normal])


@dataclass(frozen=True, eq=False)
class SphereFace:
    """A sphere, of which a part is seen."""

    centre: Floats  # (3,) in mm
    radius: float  # in mm


@dataclass(frozen=True, eq=False)
class Corner:
    """The point in which the planes of three faces meet."""

    faces: tuple[FlatFace, FlatFace, FlatFace]  # three faces, no two of them parallel


Feature = FlatFace | SphereFace | Corner  # what a length is measured between


@dataclass(frozen=True, eq=False)
class FeatureLength:
    """A length of an artefact between two features of the same kind."""

    name: str  # in words, for reports, such as "step height 2 to 3"
    first: Feature  # two parallel flat faces, whose distance it is
    second: Feature  # two parallel flat faces, whose distance it is
    true_mm: float  # its true value in mm
