"""Scores a decoded measurement at a fixed sample of pixels and points of the true surface.

The sample is the same for every candidate, so that its errors cancel when candidates are compared.
"""

from __future__ import annotations

from copy import copy
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
from fpplab.comparison.alignment import LIMITS as ALIGNMENT
from fpplab.comparison.alignment import AlignmentMesh, refine_pose
from fpplab.comparison.compare import LIMITS as COMPARISON
from fpplab.comparison.compare import visible_samples
from fpplab.comparison.neighbours import nearest_neighbours
from fpplab.comparison.surfaces import distance_to_surface
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Axis, Floats, Map, Mask, axis_length
from fpplab.core.errors import DataError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.optimisation.candidate import Accuracy
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.reconstruction.filtering import count_removed
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.triangulation import camera_rays, camera_slopes


@dataclass(frozen=True)
class ScoringLimits:
    """Sizes of the samples that a measurement is scored with."""

    samples: int = 12_000  # approximate number of pixels, and of points of the true surface (chosen)
    alignment_points: int = 4_000  # approximate number (derived: a thirtieth of one point's noise is left)
    near_spacings: float = 2.0  # of surface samples, within which a point of the shape counts (chosen)


LIMITS = ScoringLimits()


ProjectorCoordinateBounds = dict[Axis, tuple[Map, Map]]
"""By axis the least and greatest projector coordinate in px that each pixel may have.

The pixels around it are included, because a pixel at an edge sees more than its centre does.
"""


@dataclass(frozen=True)
class ArtefactFigures(Accuracy):
    """Figures of one artefact, with the uncertainty due to the sample."""

    surface_spread_um: float  # standard error of `surface_smcd_um` due to the choice of the sample, in µm


class TrueShape:
    """A true shape as a calibrated rig sees it, with everything precomputed for comparisons."""

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        calibration: Calibration,
        illuminated: bool = True,
        samples: int | None = LIMITS.samples,
        density: float = COMPARISON.density_per_mm2,
    ) -> None:
        shape, random = RayTracedShape(mesh), np.random.default_rng(0)
        self._shape, self._target = shape, AlignmentMesh(mesh)
        self._surface = visible_samples(mesh, shape, calibration, density, 0, illuminated).samples
        self._near_mm = LIMITS.near_spacings / np.sqrt(density)
        self._hits = _intersect_pixel_rays(shape, calibration)
        self._on_shape: Mask = np.isfinite(self._hits[..., 2])
        self._compared: Mask = _random_subset(self._on_shape, samples, random)
        self._sampled = self._surface[_random_subset(np.ones(len(self._surface), np.bool_), samples, random)]
        self._expected: tuple[Calibration, ProjectorCoordinateBounds] | None = None

    def part(self, camera: Pinhole, corner: tuple[int, int], border: int) -> TrueShape:
        part, (left, top), (width, height) = copy(self), corner, camera.size
        for computed in ("_tree", "floor_um"):
            vars(part).pop(computed, None)
        window = slice(top, top + height), slice(left, left + width)
        compared, on_shape = np.zeros((height, width), np.bool_), self._on_shape[window]
        inner = slice(border, height - border), slice(border, width - border)
        compared[inner] = on_shape[inner]
        surface = self._surface[camera.sees(self._surface)]
        sampled = surface[camera.sees(surface, margin_px=border)]
        if not compared.any() or len(sampled) == 0:
            raise DataError(f"true mesh: nothing of it is visible in a part of {width} x {height} px")
        vars(part).update(
            _hits=self._hits[window],
            _on_shape=on_shape,
            _compared=compared,
            _surface=surface,
            _sampled=sampled,
            _expected=None,
        )
        return part

    @property
    def visible(self) -> Mask:
        return self._on_shape

    @property
    def surface_points(self) -> int:
        return len(self._sampled)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._surface, balanced_tree=False, compact_nodes=False)

    @cached_property
    def floor_um(self) -> float:
        """`smcd_um` that a perfect measurement of the counted surface would have, in µm."""
        hits = self._hits[self._on_shape]
        perfect = hits[nearest_neighbours(hits, self._surface)[0] < self._near_mm]
        back = nearest_neighbours(self._sampled, perfect)[0]
        few = perfect[:: max(1, len(perfect) // LIMITS.samples)]
        return 1e3 * float(self._tree.query(few)[0].mean() + back.mean()) / 2.0

    def score(
        self, decoded: Decoded, plan: Plan, calibration: Calibration, align: bool = True
    ) -> ArtefactFigures:
        # decoded (height, width) px
        decoded, cloud = points_of(decoded, calibration, plan)
        removed = count_removed(decoded)
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
        # decoded (height, width)
        assert cloud.pixels is not None
        u, v = cloud.pixels.T
        counted, compared = self._on_shape[v, u], self._compared[v, u]
        faces = cloud.grid_mesh()[1]
        faces = faces[counted[faces].all(axis=1)]
        if not compared.any() or len(faces) == 0:
            raise DataError("cloud: no point of it lies on the true shape; check the pose of the artefact")
        points = cloud.points.astype(np.float64)
        T_true_camera = self._align(points[compared]) if align else RigidTransform.identity()
        points = T_true_camera.apply(points)
        measured = points[compared]
        square = igl.point_mesh_squared_distance(measured, self._target.vertices, self._target.faces)[0]
        error, back = np.sqrt(square), distance_to_surface(self._sampled, points, faces)
        to_points = nearest_neighbours(self._sampled, points[counted])[0]
        spread = np.sqrt(error.var() / len(error) + back.var() / len(back)) / 2.0
        return ArtefactFigures(
            points=int(np.count_nonzero(counted)),
            surface_smcd_um=1e3 * float(error.mean() + back.mean()) / 2.0,
            smcd_um=1e3 * float(self._tree.query(measured)[0].mean() + to_points.mean()) / 2.0,
            smcd_floor_um=self.floor_um,
            surface_rms_um=1e3 * float(np.sqrt(np.mean(error**2))),
            completeness=float(np.mean(back <= COMPARISON.near_mm)),
            wrong_orders=self._wrong_orders(decoded, plan, calibration, cloud.pixels[counted], T_true_camera),
            outliers=outliers,
            surface_spread_um=1e3 * float(spread),
        )

    def _align(self, points: Floats) -> RigidTransform:
        few = points[:: max(1, len(points) // LIMITS.alignment_points)]
        return refine_pose(few, self._target, RigidTransform.identity(), ALIGNMENT.fine_rounds)[0]

    def _wrong_orders(
        self,
        decoded: Decoded,
        plan: Plan,
        calibration: Calibration,
        pixels: NDArray[np.int32],
        T_true_camera: RigidTransform,
    ) -> float:
        """Compute the share of pixels whose coordinate is off by half a period of the finest set."""
        # Pixels that seem wrong are checked again with rays from the camera as aligned by T_true_camera,
        # edges of the shape in its nominal pose may lie a pixel off.
        wrong = 0
        for axis in plan.axes:
            length, fringes = axis_length(calibration.projector.size, axis), plan.fringe_part
            sets = fringes.sets if fringes and axis in fringes.axes else plan.sets
            half = length / max(each.finest_stripes(length) for each in sets if each.coded_axis == axis) / 2.0
            coordinate = decoded.coordinate(axis)
            u, v = pixels.T
            lower, upper = (bound[v, u] for bound in self._projector_bounds(calibration)[axis])
            suspect = ~_within(coordinate[v, u], lower, upper, half)
            rechecked = pixels[suspect]
            true = self._neighbour_coordinates(rechecked, calibration, T_true_camera)[
                ..., 0 if axis == "x" else 1
            ]
            decoded_again = coordinate[rechecked[:, 1], rechecked[:, 0]]
            right = _within(decoded_again, np.fmin.reduce(true, axis=1), np.fmax.reduce(true, axis=1), half)
            wrong += int(np.count_nonzero(~right))
            suspect[suspect] = ~right
            pixels = pixels[~suspect]  # wrong along one axis is wrong
        return wrong / (wrong + len(pixels))

    def _neighbour_coordinates(
        self, pixels: NDArray[np.int32], calibration: Calibration, T_true_camera: RigidTransform
    ) -> Floats:
        """Projector coordinates, (P, 9, 2), that each pixel and its neighbours see; NaN off the shape."""
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

    def _projector_bounds(self, calibration: Calibration) -> ProjectorCoordinateBounds:
        """Bound the projector coordinate of each pixel; kept for the calibration that was asked for last."""
        if self._expected is None or self._expected[0] is not calibration:
            self._expected = calibration, self._compute_projector_bounds(calibration)
        return self._expected[1]

    def _compute_projector_bounds(self, calibration: Calibration) -> ProjectorCoordinateBounds:
        pose, on_shape = calibration.T_projector_camera, self._on_shape
        true = calibration.projector.project(pose.apply(self._hits[on_shape]))
        bounds = []
        for values in true.T:
            lower = np.full(on_shape.shape, np.inf, np.float32)
            upper = np.full(on_shape.shape, -np.inf, np.float32)
            lower[on_shape] = upper[on_shape] = values
            bounds.append((minimum_filter(lower, 3), maximum_filter(upper, 3)))
        return {"x": bounds[0], "y": bounds[1]}


def _within(coordinate: Floats | Map, lower: Floats | Map, upper: Floats | Map, half: float) -> Mask:
    """Select where a coordinate is less than `half` outside its bounds."""
    return np.asarray((coordinate > lower - half) & (coordinate < upper + half))


def _random_subset(mask: Mask, count: int | None, random: np.random.Generator) -> Mask:
    if count is None:
        return mask
    return np.asarray(mask & (random.random(mask.shape) < count / max(1, np.count_nonzero(mask))))


def _intersect_pixel_rays(shape: RayTracedShape, calibration: Calibration) -> Floats:
    """Intersect each pixel's ray with the shape: (height, width, 3) in mm, NaN where it misses."""
    rays = camera_rays(calibration.camera)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    depth = shape.depth(np.zeros(3), rays.reshape(-1, 3)).reshape(rays.shape[:2])
    return np.asarray(rays * np.where(np.isfinite(depth), depth, np.nan)[..., None])
