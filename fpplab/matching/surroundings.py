"""The surroundings of a bench, rebuilt from its own recordings of a board: shape and reflectance.

Camera and projector stand still, so whatever is beside the board is seen in the same pixels again. Its shape
is triangulated where the fringes decode, and merged over the poses by the median of the depths along every
pixel's ray. Its reflectance is the ratio of the levels that were recorded to those of the twin, least squares
over all images of a pose and the median over the poses: what hides or shades a surface in some poses does not
count. A surface is believed to be matt, and light that reaches it by way of others counts as its own.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import FppError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.core.progress import Progress, no_progress
from fpplab.matching.loss import MARGIN_PX, board_mask, ssim
from fpplab.matching.reference import LevelStack, Reference
from fpplab.pipeline import reconstruct
from fpplab.simulation.matchable import Twin
from fpplab.simulation.surroundings import Surroundings
from fpplab.targets import Target

CELL_PX = 4
"""Side of the squares of pixels that share a corner of the mesh."""
SMOOTHED_CELLS = 5
"""Side of the window of cells whose median is the depth of its middle."""
LEAST_KNOWN = 0.3
"""Share of the window that must be known."""
MOST_STEP = 0.03
"""Greatest ratio, less 1, of depths at the corners of a face: beyond lies an edge that nothing joins."""
BOARD_MARGIN = 0.25
"""Margin of the board's outline, as a share of its size, within which what moves with it may lie."""
OFF_BOARD_MM = 40.0
"""Distance from the board's plane within which a point in this margin counts as the board's."""
LEAST_POSES = 2
"""In so many poses a surface must have been seen, or it may have moved with the board."""
LEAST_FACES = 100
"""With fewer there are no surroundings worth the name."""
TRIAL = 0.1
"""Reflectance with which levels are computed: dark enough that none is saturated."""
LEAST_LEVEL = 0.01
"""Level of the twin at the trial's reflectance, a share of full scale, below which a surface is not lit."""
MOST_POSES = 8
"""From more poses the surroundings are not rebuilt: they are the same in all."""
RIM_REACH_PX = 100
"""Pixels beyond the board's outline in which its frame is looked for."""
RING_MM, LEAST_RING = 0.5, 50
"""Width of rings around the board in which pixels are counted, and how many must be seen of one."""
DARK = 0.4
"""Share of the expected light below which a pixel is hidden or shaded."""
LEAST_GAIN = 0.005
"""Least gain of the mean SSIM of whole images for which surroundings are worth their tracing."""
HIDDEN_PX = 12
"""Pixels beyond the board's outline that are not used for the reflectance."""


def rebuild_surroundings(
    reference: Reference,
    twin: Twin,
    poses: Sequence[int] | None = None,
    progress: Progress = no_progress,
) -> Surroundings | None:
    """Rebuild what stands beside the board.

    Parameters
    ----------
    reference : Reference
        What was recorded of the bench.
    twin : Twin
        Matched, without surroundings; it is left so.
    poses : sequence of int, optional
        Indices of the poses whose recordings are used; all by default.
    progress : Progress
        Told the share that is done.

    Returns
    -------
    Surroundings or None
        None where the recordings show nothing beside the board.
    """
    used = range(len(reference.sessions)) if poses is None else poses
    depths = _depths(reference, twin, used, lambda share: progress(0.6 * share))
    mesh = grid_mesh(depths, twin.parameters.calibration.camera)
    if len(mesh.faces) < LEAST_FACES:
        return None
    height, width = reference.frames(0, [0])[0].shape
    found = Surroundings(mesh, np.full((height, width), TRIAL, np.float32))
    twin.surround(found)
    try:
        painted = _reflectance(reference, twin, used, lambda share: progress(0.6 + 0.4 * share))
    finally:
        twin.surround(None)
    if not painted.any():
        return None
    found = replace(found, reflectance=painted)
    twin.surround(found)
    try:
        return replace(found, rim_mm=_rim_mm(reference, twin, used))
    finally:
        twin.surround(None)


def _depths(reference: Reference, twin: Twin, poses: Sequence[int], progress: Progress) -> Floats:
    """Median depth of the surroundings over poses in cells of pixels, NaN where nothing is known."""
    found = []
    parameters = twin.parameters
    for done, pose in enumerate(poses):
        try:
            _, cloud = reconstruct(reference.sessions[pose], parameters.calibration, as_recorded=True)
        except FppError:  # a pose that shows too little to be triangulated
            continue
        found.append(_cells(_without_board(cloud, parameters.poses[pose], reference.target)))
        progress((done + 1) / len(poses))
    if not found:
        return np.full((1, 1), np.nan)
    every = np.stack(found)
    often = np.isfinite(every).sum(axis=0) >= min(LEAST_POSES, len(every))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a cell that is known in no pose
        return np.where(often, np.nanmedian(every, axis=0), np.nan)


def _without_board(cloud: Cloud, T_camera_board: RigidTransform, target: Target) -> Cloud:
    """Take out what lies on the board or in its margin."""
    on_board = T_camera_board.inverse().apply(cloud.points.astype(np.float64))
    reach = (0.5 + BOARD_MARGIN) * np.array(target.size_mm)
    is_board = (np.abs(on_board[:, :2]) < reach).all(axis=1) & (np.abs(on_board[:, 2]) < OFF_BOARD_MM)
    return cloud.only(~is_board)


def _cells(cloud: Cloud) -> Floats:
    """Median depth (rows, columns) in cells of pixels, NaN where there is no point."""
    assert cloud.pixels is not None
    assert cloud.size is not None
    width, height = cloud.size
    depths = np.full((-(-height // CELL_PX) * CELL_PX, -(-width // CELL_PX) * CELL_PX), np.nan)
    depths[cloud.pixels[:, 1], cloud.pixels[:, 0]] = cloud.points[:, 2]
    rows, columns = depths.shape[0] // CELL_PX, depths.shape[1] // CELL_PX
    cells = depths.reshape(rows, CELL_PX, columns, CELL_PX).swapaxes(1, 2).reshape(rows, columns, -1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an empty cell
        return np.asarray(np.nanmedian(cells, axis=-1))


def grid_mesh(depths: Floats, camera: Pinhole) -> trimesh.Trimesh:
    """Join depths in cells of pixels to a mesh, where neighbours are near.

    Parameters
    ----------
    depths : Floats
        (rows, columns) in mm along the camera's axis, of cells of `CELL_PX` pixels; NaN where unknown.
    camera : Pinhole
        Of the pixels.

    Returns
    -------
    trimesh.Trimesh
        In the camera's frame in mm, front sides towards the camera.
    """
    smooth = _smoothed(depths)
    number = np.full(smooth.shape, -1)
    known = np.isfinite(smooth)
    number[known] = np.arange(known.sum())
    v, u = np.nonzero(known)
    middle = CELL_PX * (np.stack([u, v], axis=-1) + 0.5) - 0.5
    slopes = camera.normalise(middle.astype(np.float64))
    vertices = smooth[known][:, None] * np.column_stack([slopes, np.ones(len(slopes))])
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    corners = corners.reshape(-1, 4)
    corners = corners[(corners >= 0).all(axis=1)]
    depth = vertices[:, 2][corners]
    corners = corners[depth.max(axis=1) < (1.0 + MOST_STEP) * depth.min(axis=1)]
    faces = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.remove_unreferenced_vertices()
    return mesh


def _smoothed(depths: Floats) -> Floats:
    """Median over windows of cells; NaN where too little of the window is known, or not the middle itself."""
    margin = SMOOTHED_CELLS // 2
    wide = np.pad(depths, margin, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(wide, (SMOOTHED_CELLS, SMOOTHED_CELLS))
    enough = np.isfinite(windows).mean(axis=(2, 3)) >= LEAST_KNOWN
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a window of unknown cells
        found = np.nanmedian(windows, axis=(2, 3))
    return np.where(enough, found, np.nan)


def _reflectance(
    reference: Reference, twin: Twin, poses: Sequence[int], progress: Progress
) -> NDArray[np.float32]:
    """Ratio (height, width) of recorded levels to the twin's, times the trial's reflectance; at most 1."""
    ratios = []
    for done, pose in enumerate(poses):
        ratios.append(_ratio(reference, twin, pose))
        progress((done + 1) / len(poses))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a pixel that is lit in no pose
        ratio: LevelStack = np.nanmedian(np.stack(ratios), axis=0)
    return np.clip(np.float32(TRIAL) * np.nan_to_num(ratio), 0, 1)


def _ratio(reference: Reference, twin: Twin, pose: int) -> LevelStack:
    """Recorded levels over the twin's at every pixel in one pose, NaN where nothing lit is seen."""
    every = tuple(range(len(reference.patterns)))
    black = twin.parameters.black_level * reference.full_scale
    real = reference.frames(pose, every) - black
    computed = twin.expected(pose, reference.shown(every), reference.settings) - black
    square = np.einsum("nvu,nvu->vu", computed, computed)
    both = np.einsum("nvu,nvu->vu", computed, real)
    is_lit = square > len(every) * (LEAST_LEVEL * reference.full_scale) ** 2
    is_lit &= ~_hidden(reference, twin, pose)
    ratio: LevelStack = np.divide(both, square, out=np.full_like(both, np.nan), where=is_lit)
    return ratio


def _hidden(reference: Reference, twin: Twin, pose: int) -> Mask:
    """Pixels that see the board, and some beyond."""
    now = twin.parameters
    return board_mask(now.calibration.camera, now.poses[pose], reference.target, -HIDDEN_PX)


def _rim_mm(reference: Reference, twin: Twin, poses: Sequence[int]) -> float:
    """Width in mm of a dark frame around the board: as far as it hides lit surroundings on all sides.

    A shadow of the frame beside it would count as well, but falls to one side alone.
    """
    widths = [width for pose in poses if (width := _dark_width_mm(reference, twin, pose)) is not None]
    return float(np.median(widths)) if widths else 0.0


def _dark_width_mm(reference: Reference, twin: Twin, pose: int) -> float | None:
    """Least width over the board's sides; None where too little of the surroundings is lit beside it."""
    now, images = twin.parameters, reference.one_of_each_set
    black, full = now.black_level * reference.full_scale, reference.full_scale
    lit = twin.expected(pose, reference.shown(images), reference.settings).mean(axis=0) - black
    real = reference.frames(pose, images).mean(axis=0) - black
    beside = board_mask(now.calibration.camera, now.poses[pose], reference.target, -RIM_REACH_PX)
    beside &= ~board_mask(now.calibration.camera, now.poses[pose], reference.target, -MARGIN_PX)
    rows, columns = np.nonzero(beside & (lit > LEAST_LEVEL * full))
    x, y = _on_board(now.calibration.camera, now.poses[pose], rows, columns)
    half_x, half_y = 0.5 * np.array(reference.target.size_mm)
    is_dark = real[rows, columns] < DARK * lit[rows, columns]
    sides = (
        (x - half_x, np.abs(y) < half_y),
        (-x - half_x, np.abs(y) < half_y),
        (y - half_y, np.abs(x) < half_x),
        (-y - half_y, np.abs(x) < half_x),
    )
    widths = [_dark_until(away[along], is_dark[along]) for away, along in sides]
    known = [width for width in widths if width is not None]
    return min(known) if known else None


def _dark_until(away_mm: Floats, is_dark: Mask) -> float | None:
    """Distance in mm up to which most pixels are dark; None where too few are seen nearby."""
    width = 0.0
    while True:
        ring = (away_mm >= width) & (away_mm < width + RING_MM)
        if ring.sum() < LEAST_RING:
            return width or None
        if is_dark[ring].mean() < 0.5:
            return width
        width += RING_MM


def _on_board(
    camera: Pinhole, pose: RigidTransform, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Where pixels' rays meet the board's plane, x and y in mm on it."""
    slopes = camera.normalise(np.stack([columns, rows], axis=-1).astype(np.float64))
    rays = np.column_stack([slopes, np.ones(len(slopes))])
    normal = pose.rotation[:, 2]
    depth = (normal @ pose.translation) / (rays @ normal)
    on_board = pose.inverse().apply(depth[:, None] * rays)
    return on_board[:, 0], on_board[:, 1]


@dataclass(frozen=True)
class SurroundingsTrial:
    """Whether surroundings make the twin's images more alike in a pose from which they were not rebuilt.

    Attributes
    ----------
    pose : str
        Name of the pose.
    ssim_without, ssim_with : float
        Mean SSIM of its whole images.
    faces : int
        Triangles of the mesh; 0 where nothing was rebuilt.
    """

    pose: str
    ssim_without: float
    ssim_with: float
    faces: int

    @property
    def accepted(self) -> bool:
        """Whether the images are more alike with them, by more than noise makes of it."""
        return self.faces > 0 and self.ssim_with > self.ssim_without + LEAST_GAIN

    def summary(self) -> dict[str, Any]:
        """Give plain values.

        Returns
        -------
        dict of str to Any
            The attributes by name.
        """
        return {**asdict(self), "accepted": self.accepted}


def add_surroundings(reference: Reference, twin: Twin, progress: Progress = no_progress) -> SurroundingsTrial:
    """Rebuild the surroundings, and show them where they prove themselves in a pose that was left out.

    Parameters
    ----------
    reference : Reference
        What was recorded of the bench.
    twin : Twin
        Matched, without surroundings.
    progress : Progress
        Told the share that is done.

    Returns
    -------
    SurroundingsTrial
        What came of it. The twin has the surroundings of all poses where it is accepted.
    """
    *others, held = reference.spread_poses(MOST_POSES)
    tried = rebuild_surroundings(reference, twin, others, lambda share: progress(0.45 * share))
    without = _similarity(reference, twin, held)
    twin.surround(tried)
    found = SurroundingsTrial(
        reference.sessions[held].path.name,
        without,
        _similarity(reference, twin, held) if tried else without,
        len(tried.mesh.faces) if tried else 0,
    )
    twin.surround(None)
    if found.accepted:
        every = rebuild_surroundings(
            reference, twin, [*others, held], lambda share: progress(0.5 + share / 2)
        )
        twin.surround(every)
    return found


def _similarity(reference: Reference, twin: Twin, pose: int) -> float:
    """Mean SSIM of whole images of one pose, one of every fringe set, without noise of the twin's."""
    images = reference.one_of_each_set
    computed = twin.expected(pose, reference.shown(images), reference.settings)
    board = _hidden(reference, twin, pose)
    pairs = zip(reference.frames(pose, images), computed, strict=True)
    return float(np.mean([ssim(real, own, reference.full_scale, board)[0] for real, own in pairs]))
