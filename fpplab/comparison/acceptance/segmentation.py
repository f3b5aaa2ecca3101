"""Finding a standard's spheres and plane in a cloud, and selecting the points to evaluate.

Points are selected by their camera rays alone: a rule that depended on their distances from the fit would
leave out the very errors that the test measures.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from fpplab.clouds import Cloud
from fpplab.comparison.acceptance.fitting import Plane, fit_plane
from fpplab.comparison.acceptance.standard import EvaluationRules
from fpplab.core.conventions import TWO_PI, Floats, Mask
from fpplab.core.errors import DataError


@dataclass(frozen=True)
class SegmentationLimits:
    """Limits by which spheres and planes are recognised."""

    max_votes: int = 20_000  # points, drawn at random, that vote for a sphere's centre or a plane (chosen)
    vote_reach: float = 0.1  # distance in radii within which votes for a sphere's centre agree (chosen)
    sphere_reach: float = 0.05  # distance in radii within which a point counts as near the sphere (chosen)
    inner_radius: float = 0.7  # distance in radii from the centre within which rays must meet it (chosen)
    min_near_share: float = 0.6  # of these rays' points (derived: of a plane that touches it, 0.4 at most)
    mean_shift_steps: int = 30  # iterations to the densest place of the votes (chosen)
    cap_rings: int = 8  # rings of equal solid angle that a cap is divided into (chosen)
    cap_sectors: int = 24  # sectors of such a ring (chosen)
    plane_reach: float = 0.01
    """Distance in lengths of the standard within which a point is near the plane (chosen)"""
    plane_trials: int = 400  # random samples (derived: a plane with a fifth of all points is missed in 4 %)
    spacings_per_cell: float = 2.0  # side of a cell of the plane's raster, in point spacings (chosen)
    max_side_ratio: float = 1.05
    """Of the plane's side to the standard's; beyond, it is another plane (chosen)"""


LIMITS = SegmentationLimits()


@dataclass(frozen=True, eq=False)
class Cap:
    """The points of a sphere's cap that are evaluated."""

    index: NDArray[np.intp]  # numbers (K,) of the points in the cloud
    solid_angle_sr: float  # solid angle of the cap that the points cover


@dataclass(frozen=True, eq=False)
class Face:
    """The points of a plane that are evaluated."""

    index: NDArray[np.intp]  # numbers (K,) of the points in the cloud
    area_mm2: float  # area of the plane that the points cover, in mm²


def normals_of(cloud: Cloud) -> Floats:
    # returns (N, 3)
    if cloud.normals is not None:
        return np.asarray(cloud.normals, np.float64)
    return np.asarray(cloud.grid().normals(), np.float64)


def find_spheres(points: Floats, normals: Floats, radius: float, count: int, source: str) -> list[Floats]:
    # Each point votes for the place one radius behind it along its normal; the votes of a sphere meet in its
    # centre, those of anything else are scattered. The centre is then fitted robustly to the points near the
    # sphere.
    # points (N, 3) mm; normals (N, 3); returns (3,) mm
    has_normal = np.any(normals != 0.0, axis=1)
    votes = points[has_normal] - radius * normals[has_normal]
    free = np.ones(len(votes), bool)
    centres: list[Floats] = []
    while len(centres) < count:
        centre = _find_densest_place(votes[free], LIMITS.vote_reach * radius)
        if centre is None:
            raise DataError(_not_found(source, radius, len(centres), count))
        centre = _fit_centre(points, centre, radius)
        inner = np.abs(_ray_distance(points, centre)) <= LIMITS.inner_radius * radius
        near = np.abs(np.linalg.norm(points[inner] - centre, axis=1) - radius) <= LIMITS.sphere_reach * radius
        if not inner.any() or near.mean() < LIMITS.min_near_share:
            raise DataError(_not_found(source, radius, len(centres), count))
        centres.append(centre)
        free &= np.linalg.norm(votes - centre, axis=1) > radius
    return centres


def sphere_cap(points: Floats, centre: Floats, radius: float, rule: EvaluationRules, source: str) -> Cap:
    # A ray that passes the centre at the distance d meets the sphere at the angle of incidence asin(d/r), and
    # r - d inside its silhouette.
    # points (N, 3) mm; centre (3,) mm
    reach = min(radius * np.sin(np.radians(rule.cap_deg)), radius - rule.edge_mm)
    if reach <= 0:
        raise DataError(
            f"{source}: an edge of {rule.edge_mm:g} mm leaves nothing of a sphere of {2 * radius:g} mm; "
            "give less in 'evaluation.edge_mm'"
        )
    index = np.flatnonzero(_ray_distance(points, centre) <= reach)
    if len(index) < rule.least_points:
        raise DataError(
            f"{source}: a sphere has {len(index)} points to evaluate, fewer than {rule.least_points}; "
            "measure it closer, or with more of it illuminated"
        )
    covered = _solid_angle(points[index], centre, radius, reach)
    if covered < rule.least_solid_angle_sr:
        raise DataError(
            f"{source}: the measured cap of a sphere spans {covered:.2f} sr, less than "
            f"{rule.least_solid_angle_sr:g} sr; illuminate more of it, or let 'evaluation.cap_deg' be greater"
        )
    return Cap(index, covered)


def _ray_distance(points: Floats, centre: Floats) -> Floats:
    """Compute the distances (N,) in mm of the points' rays from the centre; inf for rays that lead away."""
    length = np.maximum(np.linalg.norm(points, axis=1), 1e-12)
    along = points @ centre / length
    square = np.maximum(centre @ centre - along**2, 0.0)
    return np.where(along > 0.0, np.sqrt(square), np.inf)


def _find_densest_place(votes: Floats, reach: float) -> Floats | None:
    """Find where votes are densest, (3,): the best of a random sample, refined by mean shift."""
    if len(votes) == 0:
        return None
    random = np.random.default_rng(0)
    sample = (
        votes
        if len(votes) <= LIMITS.max_votes
        else votes[random.choice(len(votes), LIMITS.max_votes, replace=False)]
    )
    counts = cKDTree(sample).query_ball_point(sample, reach, return_length=True)
    centre = sample[int(np.argmax(counts))]
    for _ in range(LIMITS.mean_shift_steps):
        around = votes[np.linalg.norm(votes - centre, axis=1) <= reach]
        moved = around.mean(axis=0) if len(around) else centre
        if np.linalg.norm(moved - centre) <= 1e-3 * reach:
            break
        centre = moved
    return np.asarray(centre)


def _random_subset(points: Floats, random: np.random.Generator) -> Floats:
    if len(points) <= LIMITS.max_votes:
        return points
    return np.asarray(points[random.choice(len(points), LIMITS.max_votes, replace=False)])


def _fit_centre(points: Floats, centre: Floats, radius: float) -> Floats:
    for _ in range(3):
        near = np.abs(np.linalg.norm(points - centre, axis=1) - radius) <= LIMITS.sphere_reach * radius
        near &= _ray_distance(points, centre) <= 0.95 * radius
        around = points[near]
        if len(around) < 4:
            return centre
        scale = 1e-3 * radius
        centre = least_squares(
            lambda c, p: np.linalg.norm(p - c, axis=1) - radius,
            centre,
            lambda c, p: (c - p) / np.linalg.norm(p - c, axis=1)[:, None],
            loss="soft_l1",
            f_scale=scale,
            args=(around,),
        ).x
    return np.asarray(centre, np.float64)


def _solid_angle(points: Floats, centre: Floats, radius: float, reach: float) -> float:
    """Compute the covered solid angle, in sr, of the cap met by rays that pass the centre within `reach`."""
    rays = points / np.linalg.norm(points, axis=1)[:, None]
    across = np.minimum(_ray_distance(points, centre), reach)
    met = rays * (rays @ centre - np.sqrt(radius**2 - across**2))[:, None] - centre
    distance = float(np.linalg.norm(centre))
    axis = -centre / distance
    # The ray at `reach` meets the sphere at this angle from the line of centres.
    edge = np.cos(np.arcsin(reach / radius) - np.arcsin(reach / distance))
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    up = met @ axis / np.linalg.norm(met, axis=1)
    turn = np.arctan2(met @ np.cross(axis, side), met @ side) / TWO_PI % 1.0
    ring = np.clip(((1.0 - up) / (1.0 - edge) * LIMITS.cap_rings).astype(int), 0, LIMITS.cap_rings - 1)
    sector = np.minimum((turn * LIMITS.cap_sectors).astype(int), LIMITS.cap_sectors - 1)
    covered = len(np.unique(ring * LIMITS.cap_sectors + sector)) / (LIMITS.cap_rings * LIMITS.cap_sectors)
    return float(covered * TWO_PI * (1.0 - edge))


def _not_found(source: str, radius: float, centres_found: int, count: int) -> str:
    return (
        f"{source}: {centres_found} of {count} spheres of {2 * radius:g} mm were found; check that both are "
        "in view and well measured, and that the standard's file has the right diameters"
    )


def find_plane(points: Floats, length: float, source: str) -> Plane:
    # By random samples of three points (RANSAC), then fitted to the points near it.
    # points (N, 3) mm
    random = np.random.default_rng(0)
    sample = (
        points
        if len(points) <= LIMITS.max_votes
        else points[random.choice(len(points), LIMITS.max_votes, replace=False)]
    )
    near, best, best_count = LIMITS.plane_reach * length, None, 0
    for _ in range(LIMITS.plane_trials):
        corners = sample[random.choice(len(sample), 3, replace=False)] if len(sample) >= 3 else sample[:0]
        if len(corners) < 3:
            break
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        size = np.linalg.norm(normal)
        if size < 1e-9:
            continue
        count = int((np.abs((sample - corners[0]) @ normal) <= near * size).sum())
        if count > best_count:
            best, best_count = Plane(corners[0], normal / size), count
    if best is None or best_count < 0.05 * len(sample):
        raise DataError(f"{source}: no plane was found; check that the standard is in view and well measured")
    for _ in range(5):
        best = fit_plane(points[np.abs(best.distances(points)) <= near])
    return best


def plane_face(
    points: Floats, plane: Plane, size: tuple[float, float], rule: EvaluationRules, source: str
) -> Face:
    # points (N, 3) mm
    places, ahead = _on_plane(points, plane)
    near = ahead & (np.abs(plane.distances(points)) <= LIMITS.plane_reach * max(size))
    cell = LIMITS.spacings_per_cell * _spacing(places[near])
    # Half a cell more: were it on the edge of a cell, the last bit of the first point would decide the size.
    low = places[near].min(axis=0) - 3.5 * cell
    shape = np.ceil((places[near].max(axis=0) + 3 * cell - low) / cell).astype(int)
    filled = _outline(places[near], low, cell, shape)
    _refuse_larger(filled, cell, size, source)
    inner = ndimage.distance_transform_edt(filled) * cell > rule.edge_mm + cell
    area = float(inner.sum() * cell**2)
    if area < rule.least_area_share * size[0] * size[1]:
        raise DataError(
            f"{source}: {area:.0f} mm² of the plane count, less than {rule.least_area_share:g} of its "
            f"{size[0]:g} x {size[1]:g} mm; have all of it in view and illuminated"
        )
    at = np.floor((places - low) / cell).astype(int)
    inside = ahead & (at >= 0).all(axis=1) & (at < shape).all(axis=1)
    inside[inside] = inner[at[inside, 0], at[inside, 1]]
    index = np.flatnonzero(inside)
    if len(index) < rule.least_points:
        raise DataError(
            f"{source}: the plane has {len(index)} points to evaluate, fewer than {rule.least_points}; "
            "measure it closer, or with more pixels"
        )
    return Face(index, area)


def _on_plane(points: Floats, plane: Plane) -> tuple[Floats, Mask]:
    """Intersect rays with the plane: places (N, 2) in mm on it, and which (N,) lie ahead of the camera."""
    towards = points @ plane.normal
    ahead = towards * (plane.point @ plane.normal) > 0.0
    met = points * ((plane.point @ plane.normal) / np.where(ahead, towards, 1.0))[:, None]
    first = np.cross(plane.normal, np.eye(3)[int(np.argmin(np.abs(plane.normal)))])
    first /= np.linalg.norm(first)
    axes = np.column_stack([first, np.cross(plane.normal, first)])
    return np.where(ahead[:, None], (met - plane.point) @ axes, 0.0), ahead


def _spacing(places: Floats) -> float:
    """Estimate the median distance of a point from its nearest neighbour."""
    some = places[:: max(1, len(places) // 2000)]
    distances, _ = cKDTree(places).query(some, k=2)
    return max(float(np.median(distances[:, 1])), 1e-6)


def _outline(places: Floats, low: Floats, cell: float, shape: NDArray[np.intp]) -> Mask:
    occupied = np.zeros(shape, bool)
    at = np.floor((places - low) / cell).astype(int)
    occupied[at[:, 0], at[:, 1]] = True
    closed = ndimage.binary_closing(occupied, np.ones((3, 3), bool))
    labels, _ = ndimage.label(closed)
    largest = int(np.argmax(np.bincount(labels.ravel())[1:])) + 1
    return np.asarray(ndimage.binary_fill_holes(labels == largest), bool)


def _refuse_larger(filled: Mask, cell: float, size: tuple[float, float], source: str) -> None:
    corners = np.argwhere(filled).astype(np.float32)
    sides = sorted((float((side + 1) * cell) for side in cv2.minAreaRect(corners)[1]), reverse=True)
    for side, stated in zip(sides, sorted(size, reverse=True), strict=True):
        if side > LIMITS.max_side_ratio * stated + 2 * cell:
            raise DataError(
                f"{source}: the plane found measures {sides[0]:.0f} x {sides[1]:.0f} mm, but the standard is "
                f"{size[0]:g} x {size[1]:g} mm; check the standard's file, and for other flat areas"
            )
