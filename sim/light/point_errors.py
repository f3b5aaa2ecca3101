"""Errors of a board's points in its image: what the camera sees, and what the projector shows, is displaced.

The errors are interpolated from the points to all pixels that see the board.
"""

import hashlib

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation.pose_effects import smooth_functions
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from sim.build import SceneState
from sim.effects import EFFECTS
from sim.items import board_target, item_poses
from sim.light.table import LightTable
from sim.world import BoardItem, World

GRID_PX, NEIGHBOURS = 8, 40
"""Spacing of the pixels between which errors are interpolated linearly, and points that each depends on (both
chosen: points lie further apart, and thin plates reach little further than their neighbours)."""


def point_error_sizes(world: World) -> Floats | None:
    """Standard deviations (2, 2) of points and of poses, in camera and projector; None without errors."""
    sizes = [effect.point_errors_px(world) for effect in EFFECTS]
    present = [size for size in sizes if size is not None and size.any()]
    return np.sqrt(np.sum(np.square(present), axis=0)) if present else None


def error_draw(pose: RigidTransform) -> int:
    """Number by which the errors of a pose are drawn: the same for a board that is put back about there."""
    # A matching moves poses by less than these 0.1 and 10 mm, and compares sizes of errors of the same draw.
    about = np.append(np.round(pose.rotation, 1), np.round(pose.translation, -1)) + 0.0  # no negative zeros
    digest = hashlib.sha256(about.tobytes()).digest()
    return int.from_bytes(digest[:8], "little")


def displaced_by_errors(world: World, setup: SceneState, table: LightTable, to_texture: Floats) -> LightTable:
    """Displace the samples of a board's table by the errors of its points."""
    # to_texture (2, 2), from px of the projector to columns and rows of its texture
    board, sizes = world.items[setup.item], point_error_sizes(world)
    if sizes is None or setup.error_draw is None or not isinstance(board, BoardItem):
        return table
    points = board_target(setup.item, board).points()
    pose = setup.held or item_poses(world, setup.item)[setup.pose]
    _, height, width, _ = table.samples.shape
    left, top = table.corner
    errors = _interpolated(
        world.camera_model().project(points, pose) - (left, top),
        _drawn([world.seed, setup.error_draw], points, sizes),
        (height, width),
    )
    camera, projector = errors[..., :2], errors[..., 2:] @ to_texture.T.astype(np.float32)
    samples = np.stack([_shifted(view, camera) for view in table.samples])
    samples[..., :2] += projector
    albedo = table.albedo.copy()
    part = albedo[top : top + height, left : left + width]
    part[:] = _shifted(np.stack([part] * 4, axis=-1), camera)[..., 3]
    return LightTable(samples, albedo, table.corner)


def _drawn(seed: list[int], points: Floats, sizes: Floats) -> Floats:
    """Draw errors (K, 4) of the points in camera and projector."""
    random = np.random.default_rng(seed)
    single, shared = np.repeat(sizes, 2, axis=1)
    functions = smooth_functions(points[:, :2])
    alone = random.standard_normal((len(points), 4))
    # Without what poses have, so that the mean squares of both add up in every draw.
    alone -= functions @ np.linalg.lstsq(functions, alone, rcond=None)[0]
    return np.asarray(single * alone + functions @ (shared * random.standard_normal((functions.shape[1], 4))))


def _interpolated(places: Floats, values: Floats, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Interpolate values (K, n) at places (K, 2) in px to an image; beyond the places they stay the same."""
    from scipy.interpolate import RBFInterpolator

    height, width = shape
    rows, columns = -(-height // GRID_PX) + 1, -(-width // GRID_PX) + 1
    v, u = np.mgrid[0:rows, 0:columns].reshape(2, -1) * GRID_PX
    at = np.stack([u, v], axis=1).clip(places.min(axis=0), places.max(axis=0))
    neighbours = min(NEIGHBOURS, len(places))
    coarse = RBFInterpolator(places, values, neighbors=neighbours)(at).reshape(rows, columns, -1)
    to_grid = np.array([[1 / GRID_PX, 0, 0], [0, 1 / GRID_PX, 0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(coarse.astype(np.float32), to_grid, (width, height), flags=flags))


def _shifted(view: NDArray[np.float32], by: NDArray[np.float32]) -> NDArray[np.float32]:
    """Shift samples (h, w, 4) of a view to first order by (h, w, 2) px; unlit ones have no place to shift."""
    shifted = view.copy()
    lit = view[..., 3] > 0
    for axis, along in ((1, 0), (0, 1)):
        slope = np.zeros_like(view)
        middle, before, after = (
            tuple(part if a == axis else slice(None) for a in (0, 1))
            for part in (slice(1, -1), slice(None, -2), slice(2, None))
        )
        slope[middle] = 0.5 * (view[after] - view[before])
        known = np.zeros_like(lit)
        known[middle] = lit[before] & lit[middle] & lit[after]
        shifted -= np.where(known[..., None], slope * by[..., along, None], np.float32(0))
    shifted[..., 3] = np.maximum(shifted[..., 3], 0)
    return shifted
