"""A decoded measurement -> its score: compared with the true shape at a fixed sample of pixels and surface.

Everything that does not depend on what was measured is computed once (`TrueShape`): which pixels look at the
shape and what of the projector they must see, what of the shape counts, and in which pixels it is compared.
The figures are those of `fpplab.comparison`, whose means over all points are taken over the sample here: the
same sample for every candidate, so that what it gets wrong of one it gets wrong of the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.alignment import FINE_ROUNDS, AlignmentMesh, refine_pose
from fpplab.comparison.compare import DENSITY_PER_MM2, NEAR_MM, visible_samples
from fpplab.comparison.neighbours import nearest
from fpplab.comparison.surfaces import distance_to_surface
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Axis, Floats, Map, Mask, axis_length
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform
from fpplab.optimisation.candidate import Accuracy
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.pipeline import points_of
from fpplab.reconstruction.filtering import removal
from fpplab.reconstruction.triangulation import camera_rays, camera_slopes

SAMPLES = 12_000
"""About as many pixels, and points of the true surface, are compared."""
ALIGNED = 4_000
"""So many of these tell how the true shape lies: to a thirtieth of one point's noise or so."""
SURELY_SAMPLED = 2.0
"""A point of the shape counts where a sample of what counts is within so many of their mean distances."""
_UM = 1e3


Bounds = dict[Axis, tuple[Map, Map]]
"""By axis the least and greatest projector coordinate in px that a pixel may see.

Of the pixels around it too, because a pixel at an edge sees more than its centre does.
"""


@dataclass(frozen=True)
class ArtefactFigures(Accuracy):
    """surface_spread_um: standard error of `surface_smcd_um` by the choice of the sample."""

    surface_spread_um: float


class TrueShape:
    """A true shape as a calibrated rig sees it.

    mesh: in the camera's frame in mm, where it is known or nearly. lit: whether only what the projector
    reaches counts. Where a search moves the projector the truth must be one for all: it is then what the
    camera sees, and shadow is what is missing of it. samples: of pixels and of surface, None for all.
    density: as in `compare`. Raises `DataError` when nothing of the shape is seen.
    """

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        calibration: Calibration,
        lit: bool = True,
        samples: int | None = SAMPLES,
        density: float = DENSITY_PER_MM2,
    ) -> None:
        shape, random = RayTracedShape(mesh), np.random.default_rng(0)
        self._shape, self._target = shape, AlignmentMesh(mesh)
        self._surface = visible_samples(mesh, shape, calibration, density, 0, lit)[0]
        self._near_mm = SURELY_SAMPLED / np.sqrt(density)
        self._hits = _hits(shape, calibration)
        self._looked_at: Mask = np.isfinite(self._hits[..., 2])
        self._compared: Mask = self._looked_at & _drawn(self._looked_at, samples, random)
        self._sampled = self._surface[_drawn(np.ones(len(self._surface), np.bool_), samples, random)]
        self._expected: tuple[Calibration, Bounds] | None = None

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._surface, balanced_tree=False, compact_nodes=False)

    @cached_property
    def floor_um(self) -> float:
        """The point-set SMCD of a perfect measurement of what counts."""
        hits = self._hits[self._looked_at]
        perfect = hits[nearest(hits, self._surface)[0] < self._near_mm]
        back = nearest(self._sampled, perfect)[0]
        few = perfect[:: max(1, len(perfect) // SAMPLES)]
        return _UM * float(self._tree.query(few)[0].mean() + back.mean()) / 2.0

    def score(
        self, decoded: Decoded, plan: Plan, calibration: Calibration, align: bool = True
    ) -> ArtefactFigures:
        """Triangulate, filter as the plan says, and compare.

        align: move the true shape onto the cloud first, from where it nearly is. Raises `DataError` when
        nothing of the shape was measured.
        """
        decoded, cloud = points_of(decoded, calibration, plan)
        removed = removal(decoded)
        outliers = removed["share"] if removed else 0.0
        return self.compare(decoded, cloud, plan, calibration, outliers, align)

    def compare(
        self,
        decoded: Decoded,
        cloud: Cloud,
        plan: Plan,
        calibration: Calibration,
        outliers: float = 0.0,
        align: bool = True,
    ) -> ArtefactFigures:
        """Figures of a cloud over the pixels of these maps; outliers: what a filter has removed.

        Raises `DataError` when no point looks at the shape, or the points span no surface.
        """
        assert cloud.pixels is not None
        u, v = cloud.pixels.T
        counted, compared = self._looked_at[v, u], self._compared[v, u]
        faces = cloud.grid_mesh()[1]
        faces = faces[counted[faces].all(axis=1)]
        if not compared.any() or len(faces) == 0:
            raise DataError("cloud: nothing of it looks at the true shape; is it where it is said to be?")
        points = cloud.points.astype(np.float64)
        T_true_camera = self._placed(points[compared]) if align else RigidTransform.identity()
        points = T_true_camera.apply(points)
        measured = points[compared]
        square = igl.point_mesh_squared_distance(measured, self._target.vertices, self._target.faces)[0]
        error, back = np.sqrt(square), distance_to_surface(self._sampled, points, faces)
        to_points = nearest(self._sampled, points[counted])[0]
        spread = np.sqrt(error.var() / len(error) + back.var() / len(back)) / 2.0
        return ArtefactFigures(
            points=int(np.count_nonzero(counted)),
            surface_smcd_um=_UM * float(error.mean() + back.mean()) / 2.0,
            smcd_um=_UM * float(self._tree.query(measured)[0].mean() + to_points.mean()) / 2.0,
            smcd_floor_um=self.floor_um,
            surface_rms_um=_UM * float(np.sqrt(np.mean(error**2))),
            completeness=float(np.mean(back <= NEAR_MM)),
            wrong_orders=self._wrong_orders(decoded, plan, calibration, cloud.pixels[counted], T_true_camera),
            outliers=outliers,
            surface_spread_um=_UM * float(spread),
        )

    def _placed(self, points: Floats) -> RigidTransform:
        """What brings the points onto the shape where it is."""
        few = points[:: max(1, len(points) // ALIGNED)]
        return refine_pose(few, self._target, RigidTransform.identity(), FINE_ROUNDS)[0]

    def _wrong_orders(
        self,
        decoded: Decoded,
        plan: Plan,
        calibration: Calibration,
        pixels: NDArray[np.int32],
        T_true_camera: RigidTransform,
    ) -> float:
        """Share of these pixels whose coordinate, along any axis, is half a finest fringe off or more.

        T_true_camera: what brings the points onto the shape. Pixels that seem wrong are looked at again from
        where the camera is by that: where the shape was said to be, its edges may be a pixel beside.
        """
        wrong = 0
        for axis in plan.axes:
            stripes = plan.fringes[plan.sets_along(axis)[-1]].stripes
            half = axis_length(calibration.projector.size, axis) / stripes / 2.0
            coordinate = decoded.u if axis == "x" else decoded.v
            u, v = pixels.T
            least, most = (bound[v, u] for bound in self._bounds(calibration)[axis])
            suspect = ~_within(coordinate[v, u], least, most, half)
            again = pixels[suspect]
            true = self._seen_around(again, calibration, T_true_camera)[..., 0 if axis == "x" else 1]
            found = coordinate[again[:, 1], again[:, 0]]
            right = _within(found, np.fmin.reduce(true, axis=1), np.fmax.reduce(true, axis=1), half)
            wrong += int(np.count_nonzero(~right))
            suspect[suspect] = ~right
            pixels = pixels[~suspect]  # what is wrong along one axis is wrong
        return wrong / (wrong + len(pixels))

    def _seen_around(
        self, pixels: NDArray[np.int32], calibration: Calibration, T_true_camera: RigidTransform
    ) -> Floats:
        """Projector coordinates, (P, 9, 2), that each pixel and those around it see; NaN beside the shape."""
        slopes = camera_slopes(calibration.camera)
        last = np.array(calibration.camera.size) - 1
        around = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1).reshape(-1, 2)
        u, v = np.moveaxis(np.clip(pixels[:, None] + around, 0, last), -1, 0)
        rays = np.stack([slopes[0, v, u], slopes[1, v, u], np.ones(u.shape)], axis=-1).reshape(-1, 3)
        rays = rays @ T_true_camera.rotation.T / np.linalg.norm(rays, axis=1, keepdims=True)
        centre = T_true_camera.translation
        depth = self._shape.depth(centre, rays)
        hits = centre + rays * np.where(np.isfinite(depth), depth, np.nan)[:, None]
        pose = calibration.T_projector_camera @ T_true_camera.inverse()
        return calibration.projector.project(pose.apply(hits)).reshape(len(pixels), len(around), 2)

    def _bounds(self, calibration: Calibration) -> Bounds:
        """What each pixel must see; kept for the calibration that was asked for last."""
        if self._expected is None or self._expected[0] is not calibration:
            self._expected = calibration, self._bounds_of(calibration)
        return self._expected[1]

    def _bounds_of(self, calibration: Calibration) -> Bounds:
        pose, seen = calibration.T_projector_camera, self._looked_at
        true = calibration.projector.project(pose.apply(self._hits[seen]))
        bounds = []
        for values in true.T:
            least, most = np.full(seen.shape, np.inf, np.float32), np.full(seen.shape, -np.inf, np.float32)
            least[seen] = most[seen] = values
            bounds.append((minimum_filter(least, 3), maximum_filter(most, 3)))
        return {"x": bounds[0], "y": bounds[1]}


def _within(found: Floats | Map, least: Floats | Map, most: Floats | Map, half: float) -> Mask:
    """Where a coordinate is less than so much beside what may be seen."""
    return np.asarray((found > least - half) & (found < most + half))


def _drawn(of: Mask, count: int | None, random: np.random.Generator) -> Mask:
    """About `count` of those that are true, or all."""
    if count is None:
        return of
    return np.asarray(random.random(of.shape) < count / max(1, np.count_nonzero(of)))


def _hits(shape: RayTracedShape, calibration: Calibration) -> Floats:
    """Where each pixel's ray meets the shape, (height, width, 3) in mm, NaN where it does not."""
    rays = camera_rays(calibration.camera)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    depth = shape.depth(np.zeros(3), rays.reshape(-1, 3)).reshape(rays.shape[:2])
    return np.asarray(rays * np.where(np.isfinite(depth), depth, np.nan)[..., None])
