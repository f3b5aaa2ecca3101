"""The surroundings of a bench, rebuilt from its own recordings of a board: shape and reflectance.

Camera and projector stand still, so whatever stands around the board is seen in the same pixels. Its shape
is triangulated where the fringes decode, and merged over the poses by the median of the depths along every
pixel's ray. Where none decodes, surfaces go on along their planes for a while, and a backdrop stands behind
all. The reflectance is the ratio of the levels that were recorded to those of the twin, least squares
over images of a pose and the median over the poses: what hides or shades a surface in some poses does not
count. A surface is believed to be matt, and light that reaches it by way of others counts as its own.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import FppError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.pipeline.measuring import reconstruct_points
from fpplab.targets import Target
from sim.appearance import Appearance, BenchSurroundings, BoardSheet
from sim.matching.loss import rectangle_mask
from sim.matching.reference import LevelStack, Reference
from sim.twin import Twin


@dataclass(frozen=True)
class SurroundingsLimits:
    """How surroundings are rebuilt."""

    cell_px: int = 4  # side of the squares of pixels that share a corner of the mesh (chosen, for size)
    smoothed_cells: int = 5  # side of the window whose median is the depth of its middle (chosen)
    min_known_share: float = 0.3  # of that window (chosen)
    max_step: float = 0.03  # ratio less 1 of depths at the corners of a face (chosen)
    near_board_mm: float = 10.0  # within which a point may belong to the board (chosen)
    backdrop_factor: float = 1.02  # of the greatest known depth (chosen)
    backdrop_px: int = 32  # side of the backdrop's squares (chosen, for size)
    min_cells: int = 100  # that are known of surroundings (chosen)
    continued_cells: int = 40  # by which known surfaces go on where nothing is known (chosen)
    min_spread: float = 1e-3  # of squared distances, so that one known cell is enough (numerical)
    plane_cells: int = 9  # side of the window of a plane that is continued (chosen)
    trial_reflectance: float = 0.1  # dark enough that no level is saturated (chosen)
    min_level: float = 0.001  # of a lit surface of that reflectance, as a share of full scale (chosen)
    hidden_px: int = 12  # beyond the board's outline that are not used (chosen)


LIMITS = SurroundingsLimits()


def rebuild_surroundings(
    reference: Reference, twin: Twin, sheet: BoardSheet, poses: Sequence[int]
) -> BenchSurroundings | None:
    depths = _median_depths(reference, twin, sheet, poses)
    camera = twin.parameters.calibration.camera
    depths = _smooth_depths(depths)
    if np.isfinite(depths).sum() < LIMITS.min_cells:
        return None
    backdrop = backdrop_mesh(LIMITS.backdrop_factor * float(np.nanmax(depths)), camera)
    mesh = cast(
        trimesh.Trimesh, trimesh.util.concatenate([grid_mesh(continue_surfaces(depths), camera), backdrop])
    )
    width, height = camera.size
    surroundings = BenchSurroundings(mesh, np.full((height, width), LIMITS.trial_reflectance, np.float32))
    trial = twin.with_appearance(Appearance(sheet, surroundings))
    painted = _reflectance(reference, trial, sheet, poses)
    return replace(surroundings, reflectance=painted) if painted.any() else None


def _median_depths(reference: Reference, twin: Twin, sheet: BoardSheet, poses: Sequence[int]) -> Floats:
    """Median depth of the surroundings over poses in cells of pixels, NaN where nothing is known."""
    of_poses = []
    parameters = twin.parameters
    for pose in poses:
        try:
            _, cloud = reconstruct_points(reference.sessions[pose], parameters.calibration, as_recorded=True)
        except FppError:  # a pose that shows too little to be triangulated
            continue
        of_poses.append(
            _depth_by_cell(cloud, _is_outside_sheet(cloud, parameters.poses[pose], reference.target, sheet))
        )
    if not of_poses:
        return np.full((1, 1), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a cell that is known in no pose
        return np.asarray(np.nanmedian(np.stack(of_poses), axis=0))


def _is_outside_sheet(cloud: Cloud, pose: RigidTransform, target: Target, sheet: BoardSheet) -> Mask:
    """Return which points (N,) are neither on the board nor near it, and so do not move with it."""
    x, y, z = pose.inverse().apply(cloud.points.astype(np.float64)).T
    low, high = sheet_outline(target, sheet, LIMITS.near_board_mm)
    is_board = (
        (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]) & (np.abs(z) < LIMITS.near_board_mm)
    )
    return np.asarray(~is_board)


def _depth_by_cell(cloud: Cloud, chosen: Mask) -> Floats:
    """Median depth (rows, columns) of chosen points in cells of pixels, NaN where there is none."""
    assert cloud.pixels is not None
    assert cloud.size is not None
    width, height = cloud.size
    depths = np.full(
        (-(-height // LIMITS.cell_px) * LIMITS.cell_px, -(-width // LIMITS.cell_px) * LIMITS.cell_px), np.nan
    )
    u, v = cloud.pixels[chosen].T
    depths[v, u] = cloud.points[chosen, 2]
    rows, columns = depths.shape[0] // LIMITS.cell_px, depths.shape[1] // LIMITS.cell_px
    cells = (
        depths.reshape(rows, LIMITS.cell_px, columns, LIMITS.cell_px)
        .swapaxes(1, 2)
        .reshape(rows, columns, -1)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an empty cell
        return np.asarray(np.nanmedian(cells, axis=-1))


def grid_mesh(depths: Floats, camera: Pinhole) -> trimesh.Trimesh:
    """Join depths in cells of pixels to a mesh, where neighbours are near."""
    # depths (rows, columns) mm
    number = np.full(depths.shape, -1)
    known = np.isfinite(depths)
    number[known] = np.arange(known.sum())
    v, u = np.nonzero(known)
    middle = LIMITS.cell_px * (np.stack([u, v], axis=-1) + 0.5) - 0.5
    slopes = camera.normalise(middle.astype(np.float64))
    vertices = depths[known][:, None] * np.column_stack([slopes, np.ones(len(slopes))])
    corners = _quadrilateral_corners(number)
    corners = corners[(corners >= 0).all(axis=1)]
    depth = vertices[:, 2][corners]
    corners = corners[depth.max(axis=1) < (1.0 + LIMITS.max_step) * depth.min(axis=1)]
    mesh = trimesh.Trimesh(vertices, _triangles(corners), process=False)
    mesh.remove_unreferenced_vertices()
    return mesh


def continue_surfaces(depths: Floats) -> Floats:
    """Let surfaces go on along their planes, up to `continued_cells`, where nothing is known."""
    # The inverse depth of a plane is linear in the image, so each ring of cells around what is known gets the
    # value of the linear fit to the known cells of its window.
    # depths (rows, columns) mm
    inverse = 1.0 / depths
    lower, upper = np.nanmin(inverse), np.nanmax(inverse)
    for _ in range(LIMITS.continued_cells):
        known = np.isfinite(inverse)
        ring = cv2.dilate(known.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_) & ~known
        if not ring.any():
            break
        inverse[ring] = np.clip(_linear_fits(inverse, known, ring), lower, upper)
    return np.asarray(1.0 / inverse)


def _linear_fits(values: Floats, known: Mask, unknown: Mask) -> Floats:
    """Values (N,) of wanted cells by linear fits to the known ones around each."""
    weight = known.astype(np.float64)
    filled = np.where(known, values, 0.0)
    away = np.arange(LIMITS.plane_cells, dtype=np.float64) - LIMITS.plane_cells // 2

    def moment(of: Floats, x: int, y: int) -> Floats:
        """Sum over the window of a value times powers of the distance from its middle."""
        sums = cv2.sepFilter2D(of, -1, away**x, away**y, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(sums[unknown])

    n, x, y, xx, xy, yy = (moment(weight, *k) for k in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)))
    right = np.stack([moment(filled, *k) for k in ((0, 0), (1, 0), (0, 1))], axis=-1)
    normal = np.stack([n, x, y, x, xx, xy, y, xy, yy], axis=-1).reshape(-1, 3, 3)
    normal = normal + np.diag([0.0, LIMITS.min_spread, LIMITS.min_spread])
    return np.asarray(np.linalg.solve(normal, right[..., None])[:, 0, 0])


def backdrop_mesh(depth_mm: float, camera: Pinhole) -> trimesh.Trimesh:
    """Make a plane that faces the camera and fills its image: what is seen where no shape is known."""
    # It stands behind all else, so that it neither hides nor shades anything.
    width, height = camera.size
    columns, rows = (-(-side // LIMITS.backdrop_px) + 1 for side in (width, height))
    grid = np.meshgrid(np.linspace(-1, width, columns), np.linspace(-1, height, rows))
    slopes = camera.normalise(np.stack(grid, axis=-1).reshape(-1, 2))
    number = np.arange(rows * columns).reshape(rows, columns)
    vertices = depth_mm * np.column_stack([slopes, np.ones(len(slopes))])
    return trimesh.Trimesh(vertices, _triangles(_quadrilateral_corners(number)), process=False)


def _quadrilateral_corners(number: NDArray[np.int64]) -> NDArray[np.int64]:
    """Corners (N, 4) of the quadrilaterals between neighbours of a grid of numbered vertices."""
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    return np.asarray(np.stack(corners, axis=-1).reshape(-1, 4))


def _triangles(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Two triangles (2 N, 3) of each quadrilateral (N, 4)."""
    return np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


def _smooth_depths(depths: Floats) -> Floats:
    """Median over windows of cells; NaN where too little of the window is known, or not the middle itself."""
    margin = LIMITS.smoothed_cells // 2
    wide = np.pad(depths, margin, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(wide, (LIMITS.smoothed_cells, LIMITS.smoothed_cells))
    enough = np.isfinite(windows).mean(axis=(2, 3)) >= LIMITS.min_known_share
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a window of unknown cells
        medians = np.nanmedian(windows, axis=(2, 3))
    return np.where(enough, medians, np.nan)


def _reflectance(
    reference: Reference, twin: Twin, sheet: BoardSheet, poses: Sequence[int]
) -> NDArray[np.float32]:
    """Ratio (height, width) of recorded levels to the twin's, times the trial's reflectance; at most 1."""
    ratios = [_recorded_to_twin_ratio(reference, twin, sheet, pose) for pose in poses]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a pixel that is lit in no pose
        ratio: LevelStack = np.nanmedian(np.stack(ratios), axis=0)
    return np.clip(np.float32(LIMITS.trial_reflectance) * np.nan_to_num(ratio), 0, 1)


def _recorded_to_twin_ratio(reference: Reference, twin: Twin, sheet: BoardSheet, pose: int) -> LevelStack:
    """Recorded levels over the twin's at every pixel in one pose, NaN where nothing lit is seen."""
    images, black = reference.compared, np.float32(twin.parameters.black_level * reference.full_scale)
    real = reference.frames(pose, images) - black
    computed = twin.expected(pose, reference.shown(images), reference.settings) - black
    square = np.einsum("nvu,nvu->vu", computed, computed)
    both = np.einsum("nvu,nvu->vu", computed, real)
    is_lit = square > len(images) * (LIMITS.min_level * reference.full_scale) ** 2
    is_lit &= ~_pixels_on_board_or_frame(reference, twin, sheet, pose)
    ratio: LevelStack = np.divide(both, square, out=np.full_like(both, np.nan), where=is_lit)
    return ratio


def _pixels_on_board_or_frame(reference: Reference, twin: Twin, sheet: BoardSheet, pose: int) -> Mask:
    """Pixels that see the board or its frame, and some beyond."""
    now = twin.parameters
    low, high = sheet_outline(reference.target, sheet, 0.0)
    return rectangle_mask(now.calibration.camera, now.poses[pose], low, high, -LIMITS.hidden_px)


def sheet_outline(target: Target, sheet: BoardSheet, beyond_mm: float) -> tuple[Floats, Floats]:
    # returns (2,) mm
    left, top, right, bottom = sheet.margins_mm
    half = 0.5 * np.array(target.size_mm)
    beyond = sheet.rim_mm + beyond_mm
    return -half - [left, top] - beyond, half + [right, bottom] + beyond
