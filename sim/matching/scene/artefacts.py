"""Comparison of bench and matched twin by the errors with which they measure artefacts.

Bench and twin scan the same plan at the same pose; each scan is reconstructed with the scanner's own
calibration and compared with the true shape by the symmetric distance between points and surface. The pose of
the artefact on the bench is found by aligning its true shape with the bench's cloud.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import cv2
import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison import Comparison, compare
from fpplab.comparison.alignment import align_mesh
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Floats, Mask, PixelIndices
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform
from fpplab.core.progress import Progress, no_progress
from fpplab.diagnosis.causes.of_matching_and_search import ARTEFACT_MISFIT
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.pipeline.measuring import reconstruct_points
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.triangulation import camera_rays
from fpplab.sessions.session import Session
from sim.matching.passes import ComparedPass, twin_recording
from sim.matching.refusal import Refusals
from sim.prediction.figures import seen_surface
from sim.twin import Twin


@dataclass(frozen=True)
class ScanLimits:
    """When a scan is one of a part."""

    max_misfit: float = 0.005  # mean distance from the surface, as a share of the mesh's size (chosen)
    # of the points, which lie on the shape whatever highlights do to others (chosen)
    usual_share: float = 0.75
    max_rms_ratio: float = 1.2  # of two poses of a shape that fit equally well (chosen)
    edge_px: int = 3  # from edges and shadows, nearer to which the pose decides about light (chosen)


LIMITS = ScanLimits()

CLIPPED = 0.98  # share of full scale from which a level counts as saturated: noise lies on that, too (chosen)
SHORT = 1e-3
"""Factor of the exposure at which light of a part is computed, so that no highlight is clipped (chosen)."""


@dataclass(frozen=True, eq=False)
class ArtefactComparison:
    """One artefact, measured by bench and twin and compared with its true shape."""

    item: str  # the artefact, as the twin's world calls it
    reference: Comparison  # of the cloud recorded on the bench
    twin: Comparison  # of the twin's cloud
    reference_cloud: Cloud  # recorded on the bench
    twin_cloud: Cloud  # measured by the twin

    @property
    def reference_um(self) -> float:
        """Symmetric mean distance between points and true surface in µm, of the recorded scan."""
        return _surface(self.reference)

    @property
    def twin_um(self) -> float:
        """Symmetric mean distance between points and true surface in µm, of the twin's scan."""
        return _surface(self.twin)

    @property
    def delta_um(self) -> float:
        """The twin's less the reference's distance in µm: negative where the twin measures better."""
        return self.twin_um - self.reference_um

    def summary(self) -> dict[str, Any]:
        return {
            "item": self.item,
            "bench_um": self.reference_um,
            "twin_um": self.twin_um,
            "delta_um": self.delta_um,
            "delta_percent": 100.0 * abs(self.delta_um) / self.reference_um,
        }


def _surface(comparison: Comparison) -> float:
    assert comparison.surface_smcd_um is not None  # every cloud of a scan lies on a pixel grid
    return comparison.surface_smcd_um


@dataclass(frozen=True, eq=False)
class BenchScan:
    """A scan recorded on the bench, compared with the true shape of what was scanned."""

    item: str  # the artefact, as the twin's world calls it
    session: Session  # the scan
    cloud: Cloud  # of the bench's own calibration
    T_camera_item: RigidTransform  # pose of the artefact, in mm
    comparison: Comparison  # of the cloud with the true shape

    def levels(self, images: Iterable[int], pixels: PixelIndices) -> Floats:
        """Read some images at some pixels; they were checked when the scan was reconstructed."""
        # returns (n, P)
        first = self.compared_pass.first
        read = [self.session.read(first + index, verify=False)[pixels] for index in images]
        return np.array(read, np.float64)

    @cached_property
    def compared_pass(self) -> ComparedPass:
        return ComparedPass.of(self.session)


def placed_part(twin: Twin, scan: BenchScan) -> trimesh.Trimesh:
    """Give the true shape of a part where its scan shows it."""
    return twin.mesh(scan.item).copy().apply_transform(scan.T_camera_item.matrix)


def part_surface_seen(twin: Twin, scan: BenchScan, pixels: PixelIndices) -> tuple[Floats, Floats]:
    # returns (P, 3) mm
    shape, rays = RayTracedShape(placed_part(twin, scan)), camera_rays(twin.parameters.calibration.camera)
    directions = rays[pixels] / np.linalg.norm(rays[pixels], axis=1, keepdims=True)
    points = directions * shape.depth(np.zeros(3), directions)[:, None]
    return points, shape.normals[shape.first_face(np.zeros(3), directions)]


def lit_inside(twin: Twin, scan: BenchScan) -> Mask:
    """Find the pixels that see lit surface of a part away from its edges and shadows."""
    # returns (height, width)
    _, lit = seen_surface(placed_part(twin, scan), twin.parameters.calibration)
    side = 2 * LIMITS.edge_px + 1
    inner = cv2.erode(lit.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=(0.0,))
    return np.asarray(inner > 0)


def fit_scan(
    twin: Twin, item: str, session: Session, calibration: Calibration, refusals: Refusals
) -> BenchScan:
    """Reconstruct a scan and refuse it where it is not that of the artefact."""
    # A mean that is too great may come from a saturated highlight, which leaves holes and some points far
    # off. The distance of three quarters of the points then decides.
    mesh = twin.mesh(item)
    _, cloud = reconstruct_points(session, calibration)
    try:
        T_camera_item = _find_mesh_pose(cloud, mesh, twin.pose_of(item))
    except DataError as error:
        raise DataError(f"{session.path}: is no scan of the {item} by this bench: {error}") from error
    placed = mesh.copy().apply_transform(T_camera_item.matrix)
    judged = compare(cloud, placed, calibration, align=True)
    limit = 1e3 * LIMITS.max_misfit * float(mesh.scale)
    off = min(_surface(judged), 1e3 * float(np.nanquantile(np.abs(judged.distances_mm), LIMITS.usual_share)))
    if off > limit:
        refusals.refuse(
            ARTEFACT_MISFIT,
            f"{session.path}: its points are {off:.0f} µm off the {item}'s surface (at most {limit:.0f}): "
            "it is a scan of something else or of another bench",
        )
    return BenchScan(item, session, cloud, T_camera_item, judged)


def _find_mesh_pose(cloud: Cloud, mesh: trimesh.Trimesh, nominal: RigidTransform) -> RigidTransform:
    """Find the pose of a mesh; where two fit equally well, the one nearer to that of the twin's file."""
    # A highlight leaves holes, without which a stepped part fits in more places than one.
    points, poses = cloud.points.astype(float), []
    for start in (nominal, RigidTransform.identity()):
        with suppress(DataError):
            near = align_mesh(points, mesh.copy().apply_transform(start.matrix))
            poses.append((near.rms_um, near.transform @ start))
    if not poses:
        raise DataError("no pose of the true shape fits the points")
    best = min(rms for rms, _ in poses)
    return next(pose for rms, pose in poses if rms <= LIMITS.max_rms_ratio * best)


def compare_artefacts(
    twin: Twin, scans: Sequence[BenchScan], twin_calibration: Calibration, progress: Progress = no_progress
) -> list[ArtefactComparison]:
    comparisons = []
    for number, scan in enumerate(scans, 1):
        own = _twin_cloud(twin, scan, twin_calibration)
        judged = compare(own, placed_part(twin, scan), twin_calibration, align=True)
        comparisons.append(ArtefactComparison(scan.item, scan.comparison, judged, scan.cloud, own))
        progress(number / len(scans))
    return comparisons


def scan_by_twin(twin: Twin, scan: BenchScan) -> Recording:
    """Scan an item where the bench had it with the twin, by the session's plan and settings."""
    patterns = make_patterns(scan.session.plan, *scan.session.projector())
    take = partial(twin.scan, scan.item, scan.T_camera_item)
    return twin_recording(scan.session, patterns, take, f"the twin's {scan.item}")


def _twin_cloud(twin: Twin, scan: BenchScan, calibration: Calibration) -> Cloud:
    recording, plan = scan_by_twin(twin, scan), scan.session.plan
    decoded = decode(recording, bounds=decoding_bounds(plan, calibration, scan.session.depth))
    return points_of(decoded, calibration, plan, recording.mean_image())[1]
