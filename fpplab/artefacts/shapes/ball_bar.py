"""The ball bar: a standard for acceptance tests, its facets within a micrometre of the spheres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fpplab.artefacts.base import Artefact
from fpplab.artefacts.lengths import FeatureLength, SphereFace
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError

if TYPE_CHECKING:
    import trimesh
    from manifold3d import Manifold


@dataclass(frozen=True)
class BallBar(Artefact):
    """Two equal spheres on posts on a bar; their centres lie at x = ± spacing / 2, y = 0."""

    is_standard: ClassVar[bool] = True
    order: ClassVar[int] = 40

    diameter: float = 20.0  # of the spheres, in mm
    spacing: float = 70.0  # distance between the spheres' centres in mm
    bar: tuple[float, float, float] = (100.0, 24.0, 5.0)  # length, width and thickness of the bar in mm
    clearance: float = 4.0  # distance between the bar's upper face and the spheres in mm
    post: float = 8.0  # diameter of the posts in mm

    def check_lengths(self) -> None:
        if len(self.bar) != 3:
            raise ConfigError(f"BallBar.bar: {list(self.bar)} must be length, width and thickness in mm")
        self.check_below("diameter", self.diameter, self.spacing, "the spacing")
        self.check_below("post", self.post, self.diameter, "the spheres' diameter")
        self.check_below("post", self.post, self.bar[1], "the bar's width")
        self.check_below("spacing", self.spacing + self.post, self.bar[0], "the bar's length, with a post")

    @property
    def centres(self) -> Floats:
        """Centres of the two spheres, (2, 3) in mm."""
        height = self.bar[2] + self.clearance + self.diameter / 2
        return np.array([[-self.spacing / 2, 0.0, height], [self.spacing / 2, 0.0, height]])

    def lengths(self) -> tuple[FeatureLength, ...]:
        """List the distance between the spheres' centres."""
        first, second = (SphereFace(centre, self.diameter / 2) for centre in self.centres)
        return (FeatureLength("distance between sphere centres", first, second, self.spacing),)

    def mesh(self) -> trimesh.Trimesh:
        from manifold3d import Manifold

        from fpplab.artefacts.solids import to_trimesh

        bar = Manifold.cube(self.bar, center=True).translate((0.0, 0.0, self.bar[2] / 2))
        radius, height = self.post / 2, float(self.centres[0, 2])
        post = Manifold.cylinder(height - self.bar[2] / 2, radius, radius, 64)
        body = bar
        for centre in self.centres:
            body += post.translate((centre[0], centre[1], self.bar[2] / 2))
            body += self._sphere().translate(tuple(centre))
        return to_trimesh(body)

    def _sphere(self) -> Manifold:
        import trimesh

        from fpplab.artefacts.solids import to_manifold

        # The facets' sagitta is 0.005 % of the radius, 0.5 µm on a sphere of 20 mm.
        return to_manifold(trimesh.creation.icosphere(subdivisions=6, radius=self.diameter / 2))
