"""A standard for acceptance tests as a watertight mesh: the ball bar.

Its centre distance and diameters are exact; the facets stay within a micrometre of the spheres.
Frame: as of the artefacts; the spheres' centres lie at x = ± spacing / 2, y = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from manifold3d import Manifold

from fpplab.artefacts.lengths import check_below, check_positive
from fpplab.artefacts.solids import to_manifold, to_trimesh
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError

SUBDIVISIONS = 6
"""Of an icosahedron: the facets' sagitta is 0.005 % of the radius, 0.5 µm on a sphere of 20 mm."""
POST_CORNERS = 64


@dataclass(frozen=True)
class BallBar:
    """Two equal spheres on posts that stand on a bar; lengths in mm.

    diameter: of the spheres. spacing: between their centres. bar: length, width and thickness of the bar.
    clearance: between the bar's upper face and the spheres. post: diameter of the posts.
    """

    diameter: float = 20.0
    spacing: float = 70.0
    bar: tuple[float, float, float] = (100.0, 24.0, 5.0)
    clearance: float = 4.0
    post: float = 8.0

    def __post_init__(self) -> None:
        check_positive(self)
        if len(self.bar) != 3:
            raise ConfigError(f"BallBar.bar: {list(self.bar)} must be length, width and thickness in mm")
        check_below(self, "diameter", self.diameter, self.spacing, "the spacing")
        check_below(self, "post", self.post, self.diameter, "the spheres' diameter")
        check_below(self, "post", self.post, self.bar[1], "the bar's width")
        check_below(self, "spacing", self.spacing + self.post, self.bar[0], "the bar's length, with a post")

    @property
    def centres(self) -> Floats:
        """Centres of the two spheres, (2, 3) in mm."""
        height = self.bar[2] + self.clearance + self.diameter / 2
        return np.array([[-self.spacing / 2, 0.0, height], [self.spacing / 2, 0.0, height]])

    def mesh(self) -> trimesh.Trimesh:
        """A single watertight body, normals outward."""
        bar = Manifold.cube(self.bar, center=True).translate((0.0, 0.0, self.bar[2] / 2))
        radius, height = self.post / 2, float(self.centres[0, 2])
        post = Manifold.cylinder(height - self.bar[2] / 2, radius, radius, POST_CORNERS)
        body = bar
        for centre in self.centres:
            body += post.translate((centre[0], centre[1], self.bar[2] / 2))
            body += self._sphere().translate(tuple(centre))
        return to_trimesh(body)

    def _sphere(self) -> Manifold:
        return to_manifold(trimesh.creation.icosphere(SUBDIVISIONS, self.diameter / 2))
