"""Comparing a measured cloud with the true shape.

There are two kinds of figure. The SMCD (symmetric mean Chamfer distance) is the paper's: the mean
distance to the nearest point of the other set, averaged over both directions. It compares samples, so
even a perfect measurement has the SMCD of the samples' spacing, `smcd_floor_um`. The surface figures
compare with surfaces (cloud to true mesh, truth to the surface over the pixel grid) and have no floor.
After a rigid alignment both are nearly blind to scale and shear, so the scale of the best-fit similarity and
the lengths of the artefact are given with them.

What is evaluated is decided before any distance is computed. Of the truth: what both devices see, that
is, inside both images, not occluded, and inclined to both views by no more than `STEEPEST_DEG`
(beyond that, the pixel grid does not resolve a surface). Of the cloud: every point whose camera ray meets
the true shape, wherever the point itself was measured; outliers are counted and are part of every mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import igl
import numpy as np
import trimesh

from fpplab.artefacts.parts import count_unpaired_edges
from fpplab.artefacts.recognition import PlacedArtefact
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud, load_cloud, load_mesh
from fpplab.clouds.surfaces import STEEPEST_DEG
from fpplab.comparison.alignment import Alignment, AlignmentMesh, align_mesh
from fpplab.comparison.lengths import MeasuredLength, displacements_by, measure_lengths
from fpplab.comparison.neighbours import nearest_neighbours
from fpplab.comparison.scale import FittedScale, fit_scale
from fpplab.comparison.surfaces import distance_to_surface
from fpplab.comparison.units import check_units
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.arguments import object_or_file
from fpplab.core.conventions import Floats, Map, Mask
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.notebook import axes_or_new, html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class ComparisonLimits:
    """Limits of a comparison, where its caller states no others."""

    density_per_mm2: float = 200.0  # samples of the true surface (chosen: their mean spacing is 0.07 mm)
    max_samples: int = 2_000_000
    """Of the true surface, or twice the points of the cloud if that is more. Chosen: more show nothing."""
    outlier_mm: float = 1.0  # distance beyond which a point is an outlier (chosen)
    near_mm: float = 0.5
    """Distance of the surface up to which a place of the true one counts as measured (chosen)"""
    max_out_of_view: float = 0.01  # share of the surface outside of the images without a warning (chosen)
    max_turned_share: float = 0.01  # share of the edges across which faces may be wound differently (chosen)


LIMITS = ComparisonLimits()


class UnseenMeshError(DataError):
    """Nothing of the mesh is where the cloud was measured: one of the two may stand elsewhere."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The distances between a cloud and a true mesh.

    Attributes
    ----------
    smcd_um : float
        Symmetric mean Chamfer distance in µm.
    smcd_floor_um : float
        SMCD of a perfect measurement with the same samples in µm.
    surface_smcd_um : float or None
        Mean of the mean distances from cloud to mesh and from visible truth to reconstructed surface, in µm;
        None for a cloud without pixels, which has no surface.
    surface_rms_um : float
        Root mean square distance from cloud to mesh in µm.
    surface_p95_um : float
        95th percentile of the distances from cloud to mesh in µm.
    completeness : float
        Share of the visible truth with reconstructed surface (without pixels: points) within `near_mm`.
    outliers : int
        Number of points farther than `outlier_mm`; they are part of all means.
    visible_share : float
        Visible share of the mesh's area.
    points : int
        Number of points that are evaluated.
    off_part : int
        Number of points that are not, since their camera rays do not meet the true shape; `beside` in JSON.
    density_per_mm2 : float
        Samples of the true mesh per mm².
    outlier_mm : float
        Distance beyond which a point is an outlier.
    near_mm : float
        Distance up to which a place of the truth counts as measured.
    restricted : bool
        Whether a calibration determined what is visible.
    alignment : Alignment or None
        Motion of the mesh onto the cloud, None without alignment.
    scale : FittedScale or None
        Scale of the best-fit similarity; None without alignment, or where the shape does not determine it.
    lengths : tuple of MeasuredLength
        Lengths of the artefact; empty without alignment, and for shapes that state none.
    distances_mm : ndarray of float32
        Signed distance (N,) of every point of the cloud, positive outside the true shape.
    counted : ndarray of bool
        (N,), True for the points that are evaluated.
    out_of_view : float
        Share of the surface turned to the devices that lies outside of their images; 0 without a calibration.
    open_edges : int
        Number of edges of the mesh that do not join two faces.
    """

    smcd_um: float
    smcd_floor_um: float
    surface_smcd_um: float | None
    surface_rms_um: float
    surface_p95_um: float
    completeness: float
    outliers: int
    visible_share: float
    points: int
    off_part: int
    density_per_mm2: float
    outlier_mm: float
    near_mm: float
    restricted: bool
    alignment: Alignment | None
    distances_mm: Map
    counted: Mask
    scale: FittedScale | None = None
    lengths: tuple[MeasuredLength, ...] = ()
    out_of_view: float = 0.0
    open_edges: int = 0

    def __repr__(self) -> str:
        mean_um, kind = self.surface_smcd_um, "surface SMCD"
        if mean_um is None:
            mean_um, kind = self.smcd_um, "SMCD"
        aligned = "aligned" if self.alignment else "not aligned"
        return (
            f"<Comparison: {mean_um:.1f} µm {kind}, {self.surface_rms_um:.1f} µm RMS, {self.points} points, "
            f"{100 * self.completeness:.1f} % complete, {aligned}>"
        )

    def _repr_html_(self) -> str:
        smcd_um = self.surface_smcd_um
        rows: dict[str, object] = {
            "surface SMCD": None if smcd_um is None else f"{smcd_um:.1f} µm",
            "SMCD": f"{self.smcd_um:.1f} µm, at best {self.smcd_floor_um:.1f} µm",
            "RMS": f"{self.surface_rms_um:.1f} µm",
            "95th percentile": f"{self.surface_p95_um:.1f} µm",
            "complete": f"{100 * self.completeness:.1f} %",
            "points": f"{self.points:,}, and {self.off_part:,} beside the part",
            "outliers": f"{self.outliers:,} beyond {self.outlier_mm:g} mm",
            "aligned": "yes" if self.alignment else "no",
        }
        if self.scale:
            rows["scale"] = f"{self.scale.ppm:.0f} ± {self.scale.sigma_ppm:.0f} ppm"
        for length in self.lengths:
            if length.error_um is not None:
                rows[length.name] = f"{length.error_um:+.1f} ± {length.sigma_um:.1f} µm"
        rows |= {f"warning {i}": warning for i, warning in enumerate(self.warnings(), 1)}
        return html_table("Comparison", rows)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw how often each distance occurs, among the points that are evaluated.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; new ones by default.

        Returns
        -------
        matplotlib.axes.Axes
            With a histogram over signed distances in µm, positive outside the true shape.
        """
        chosen = axes_or_new(axes)
        distances_um = 1e3 * self.distances_mm[self.counted]
        reach = max(4.0 * self.surface_rms_um, 1e-3)
        chosen.hist(np.clip(distances_um, -reach, reach), bins=100)
        chosen.set(xlabel="distance from the true surface, µm", ylabel="points")
        return chosen

    def warnings(self) -> list[str]:
        """List what the distances do not show: scale and shear, and shape that was not seen or is missing.

        A scale or length contradicts them if it deviates by more than `ScaleLimits.coverage` standard
        uncertainties, and by more than the root mean square distance: a rigid alignment makes them blind to
        both.

        Returns
        -------
        list of str
            Sentences for the operator.
        """
        warnings, scale = [], self.scale
        if self.out_of_view > LIMITS.max_out_of_view:
            warnings.append(
                f"field of view: {100 * self.out_of_view:.0f} % of the surface that is turned to camera and "
                "projector lies outside of their images; no figure counts it, completeness included"
            )
        if self.open_edges:
            warnings.append(
                f"mesh: has {self.open_edges} open edges; where faces are missing, points are compared with "
                "others, and an alignment may be wrong"
            )
        if scale is not None and scale.significant and scale.effect_um > self.surface_rms_um:
            warnings.append(
                f"scale: the cloud is {abs(scale.ppm):.0f} ± {scale.sigma_ppm:.0f} ppm too "
                f"{'large' if scale.ppm > 0 else 'small'}, which moves points by {scale.effect_um:.1f} µm; "
                f"the distance of {self.surface_rms_um:.1f} µm after alignment does not show it"
            )
        for length in self.lengths:
            error = length.error_um
            if error is not None and length.significant and abs(error) > self.surface_rms_um:
                warnings.append(
                    f"{length.name}: measures {length.measured_mm:.4f} mm, {abs(error):.1f} ± "
                    f"{length.sigma_um:.1f} µm too {'long' if error > 0 else 'short'}; the distance of "
                    f"{self.surface_rms_um:.1f} µm after alignment does not show it"
                )
        return warnings

    def summary(self) -> dict[str, object]:
        """Collect the figures for JSON.

        Returns
        -------
        dict of str to object
            Plain values by attribute, with the key `beside` for `off_part`; without the arrays.
        """
        left_out = ("distances_mm", "counted", "alignment", "scale", "lengths")
        keys = {"off_part": "beside"}
        figures = {keys.get(name, name): value for name, value in vars(self).items() if name not in left_out}
        return figures | {
            "alignment": self.alignment.summary() if self.alignment else None,
            "scale": self.scale.summary() if self.scale else None,
            "lengths": [length.summary() for length in self.lengths],
            "warnings": self.warnings(),
        }


def mcd(a: Floats, b: Floats) -> float:
    """Compute the mean Chamfer distance from one point set to another."""
    # a (N, 3); b (M, 3)
    return float(nearest_neighbours(a, b)[0].mean())


def smcd(a: Floats, b: Floats) -> float:
    """Compute the symmetric mean Chamfer distance, (mcd(a, b) + mcd(b, a))/2."""
    # a (N, 3); b (M, 3)
    return (mcd(a, b) + mcd(b, a)) / 2.0


def compare(
    cloud: Cloud | Path | str,
    mesh: trimesh.Trimesh | Path | str,
    calibration: Calibration | None = None,
    density: float = LIMITS.density_per_mm2,
    seed: int = 0,
    align: bool = False,
    outlier_mm: float = LIMITS.outlier_mm,
    near_mm: float = LIMITS.near_mm,
    artefact: PlacedArtefact | None = None,
) -> Comparison:
    """Compare a cloud with the true mesh.

    Parameters
    ----------
    cloud : Cloud, path or str
        In mm in the camera's frame.
    mesh : trimesh.Trimesh, path or str
        The true shape in mm in the camera's frame, faces outwards.
    calibration : Calibration, optional
        Determines what both devices see. Without it, all of the mesh that faces the camera counts as visible,
        and every point of the cloud is evaluated.
    density : float
        Samples of the true mesh per mm², drawn uniformly; fewer of a large part (`LIMITS.max_samples`).
    seed : int
        Of the random samples.
    align : bool
        Whether the mesh is first aligned to the cloud (`fpplab.comparison.alignment`).
    outlier_mm : float
        Distance beyond which a point is an outlier.
    near_mm : float
        Distance of reconstructed surface up to which a place of the truth counts as measured.
    artefact : PlacedArtefact, optional
        What the mesh is, from `fpplab.artefacts.recognition.recognise`: its lengths are measured after an
        alignment.

    Returns
    -------
    Comparison
        All figures, and the distance of every point.

    Raises
    ------
    ConfigError
        The density or a length is not above 0.
    UnseenMeshError
        Nothing of the mesh is visible, or no point's camera ray meets it.
    DataError
        The mesh is inside out, not wound alike or not in the cloud's unit, no alignment is found, or the
        points do not span a surface.
    """
    for name, value in (("density", density), ("outlier_mm", outlier_mm), ("near_mm", near_mm)):
        if not (np.isfinite(value) and value > 0.0):
            raise ConfigError(f"{name}: {value:g} must be a number above 0")
    cloud = object_or_file(getattr(cloud, "cloud", cloud), Cloud, load_cloud, "cloud")
    mesh = object_or_file(mesh, trimesh.Trimesh, load_mesh, "mesh")
    _check_winding(mesh)
    points = np.asarray(cloud.coordinates, np.float64)
    check_units(points, mesh, seed)
    alignment = align_mesh(points, mesh, seed) if align else None
    if alignment is not None:
        mesh = mesh.copy().apply_transform(alignment.transform.matrix)
    shape = RayTracedShape(mesh)
    max_samples = max(LIMITS.max_samples, 2 * len(points))
    visible = visible_samples(mesh, shape, calibration, density, seed, max_samples=max_samples)
    samples = visible.samples
    counted = np.ones(len(points), np.bool_) if calibration is None else _camera_rays_meet(shape, points)
    if not counted.any():
        raise UnseenMeshError(
            "cloud: no point's camera ray meets the true mesh; check that both are in the camera's frame, or "
            "align them (--align)"
        )
    distances, feet = _to_mesh(points, mesh)
    measured, error = points[counted], np.abs(distances[counted])
    to_cloud = nearest_neighbours(samples, measured)[0]
    scale = None if alignment is None else fit_scale(measured, AlignmentMesh(mesh), seed)
    to_surface = None if cloud.pixels is None else distances_from_cloud(samples, cloud, counted)
    return Comparison(
        smcd_um=1e3 * (mcd(measured, samples) + float(to_cloud.mean())) / 2.0,
        smcd_floor_um=1e3 * smcd(feet[counted], samples),
        surface_smcd_um=None if to_surface is None else 1e3 * float(error.mean() + to_surface.mean()) / 2.0,
        surface_rms_um=1e3 * float(np.sqrt(np.mean(error**2))),
        surface_p95_um=1e3 * float(np.quantile(error, 0.95)),
        completeness=float(np.mean((to_cloud if to_surface is None else to_surface) <= near_mm)),
        outliers=int(np.count_nonzero(error > outlier_mm)),
        visible_share=visible.share,
        points=len(measured),
        off_part=len(points) - len(measured),
        density_per_mm2=visible.density_per_mm2,
        outlier_mm=outlier_mm,
        near_mm=near_mm,
        restricted=calibration is not None,
        alignment=alignment,
        distances_mm=distances.astype(np.float32),
        counted=counted,
        scale=scale,
        lengths=_lengths(points, alignment, artefact, calibration),
        out_of_view=visible.out_of_view,
        open_edges=count_unpaired_edges(mesh),
    )


def _lengths(
    points: Floats,
    alignment: Alignment | None,
    placed: PlacedArtefact | None,
    calibration: Calibration | None,
) -> tuple[MeasuredLength, ...]:
    if alignment is None or placed is None:
        return ()
    at, lengths = alignment.transform @ placed.pose, placed.artefact.lengths()
    pose = at.inverse()
    return measure_lengths(pose.apply(points), pose.translation, lengths, displacements_by(calibration, at))


def _check_winding(mesh: trimesh.Trimesh) -> None:
    if mesh.is_winding_consistent:
        if mesh.is_watertight and mesh.volume < 0.0:
            raise DataError("true mesh: its normals point inwards; turn them outwards and export it again")
        return
    _, edge, uses = np.unique(mesh.edges, axis=0, return_inverse=True, return_counts=True)
    # Wound alike, two faces run along their edge in opposite directions.
    share = float(np.mean(uses[edge] > 1))
    if share > LIMITS.max_turned_share:
        raise DataError(
            f"true mesh: its faces are not wound consistently (across {100 * share:.0f} % of the edges), so "
            "that it has no outer side; unify its normals and export it again"
        )


class VisibleSurface(NamedTuple):
    """Samples of what is visible of a mesh."""

    samples: Floats  # visible points (M, 3) of the surface in mm
    share: float  # share of the mesh's area that is visible
    out_of_view: float  # share of the area that is turned to the devices which lies outside of their images
    density_per_mm2: float


def visible_samples(
    mesh: trimesh.Trimesh,
    shape: RayTracedShape,
    calibration: Calibration | None,
    density: float,
    seed: int,
    illuminated: bool = True,
    max_samples: int | None = None,
) -> VisibleSurface:
    centres = [np.zeros(3)]
    if calibration is not None and illuminated:
        centres.append(calibration.projector_centre)
    facing = np.logical_and.reduce([shape.facing(centre) for centre in centres])
    area = np.asarray(mesh.area_faces) * facing
    count = int(np.ceil(density * area.sum()))
    if count == 0:
        raise UnseenMeshError(
            "true mesh: no side of it faces both devices; check that cloud and mesh are in the camera's "
            "frame, or align them (--align)"
        )
    if max_samples is not None and count > max_samples:
        count, density = max_samples, max_samples / float(area.sum())
    samples, faces = trimesh.sample.sample_surface(mesh, count, face_weight=area, seed=seed)
    samples = np.asarray(samples, np.float64)
    visible = np.logical_and.reduce(
        [shape.inclination_deg(c, samples, faces) <= STEEPEST_DEG for c in centres]
    )
    turned = np.count_nonzero(visible)
    if calibration is not None:
        visible &= calibration.camera.sees(samples)
        if illuminated:
            visible &= calibration.projector.sees(samples, calibration.T_projector_camera)
    out_of_view = 1.0 - np.count_nonzero(visible) / max(turned, 1)
    if calibration is not None:
        for centre in centres:
            visible[visible] = shape.unoccluded(centre, samples[visible])
    if not visible.any():
        raise UnseenMeshError(
            "true mesh: both devices see nothing of it; check that cloud and mesh are in the camera's frame, "
            "or align them (--align)"
        )
    share = float(np.mean(visible) * area.sum() / mesh.area)
    return VisibleSurface(samples[visible], share, out_of_view, density)


def _camera_rays_meet(shape: RayTracedShape, points: Floats) -> Mask:
    directions = points / np.linalg.norm(points, axis=1)[:, None]
    return np.isfinite(shape.depth(np.zeros(3), directions))


def _to_mesh(points: Floats, mesh: trimesh.Trimesh) -> tuple[Floats, Floats]:
    """Compute signed distances (N,) to the mesh, positive outside, and the closest points on it (N, 3)."""
    distances, _, feet, _ = igl.signed_distance(
        points,
        np.ascontiguousarray(mesh.vertices, np.float64),
        np.ascontiguousarray(mesh.faces, np.int64),
        sign_type=igl.SignedDistanceType.SIGNED_DISTANCE_TYPE_PSEUDONORMAL,
    )
    return distances, feet


def distances_from_cloud(samples: Floats, cloud: Cloud, counted: Mask) -> Floats:
    # samples (M, 3) mm; counted (N,); returns (M,) mm
    vertices, faces = cloud.grid_mesh()
    faces = faces[counted[faces].all(axis=1)]
    if len(faces) == 0:
        raise DataError(
            "cloud: its points span no surface, since none are neighbours; check the mask's settings"
        )
    return distance_to_surface(samples, vertices.astype(np.float64), faces)
