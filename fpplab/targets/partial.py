"""Boards of which only part is in the picture, where it is certain which part.

Points are first found as a patch of a lattice, wherever that lies on the board. Then every way to
lay the patch on the board is tried. A way holds when each point of the board that should be in the
picture is there, in its own colours, when the lattice ends where the board does, and when the board's
edge is seen where it should be in the picture: what hides points of the board hides its edge as well, and
would otherwise pass for its end. Only when a single way holds are the points known; otherwise the reason
is given.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.targets.detection import (
    CHECKERBOARD_FLAGS,
    LEAST_POINTS,
    Detection,
    apply_homography,
    blobs,
    homography,
    local_frames,
    model,
    refined,
    stretched,
    window,
)

if TYPE_CHECKING:
    from fpplab.targets.target import Target

Cells = NDArray[np.intp]
"""Places (n, 2) on a lattice, in whole steps."""

MOST_TILT = 2.4
"""Greatest ratio of a board's scales along two directions, that of a tilt of 65 degrees."""

OFF_LATTICE = 0.2
"""How far a point of the lattice may be from where it is expected, in steps."""

LIKENESS = 0.75
"""Least correlation of the picture around a point with what the board has there."""

LEAST_PIXELS = 25
"""Pixels that tell what is at a place."""

EDGE = 0.9
"""Least share of each side's edge in view at which ground must end."""

LIKE_GROUND = 0.25
"""How far from the ground's brightness ground may be, and what is not ground must be, in contrasts."""

TURNS = [np.array(m).reshape(2, 2) for m in product(range(-2, 3), repeat=4) if m[0] * m[3] - m[1] * m[2] == 1]
"""Changes of a lattice's basis that keep it seen from the front."""


class UnclearPart(CalibrationError):  # noqa: N818 - what is wrong is the view
    """Part of a board is in view but not which."""


@dataclass(frozen=True, eq=False)
class _Patch:
    """Points of one lattice. cells (n, 2): in a basis of its own, seen from the front. pixels (n, 2)."""

    cells: Cells
    pixels: Floats


def detect_part(target: Target, image: NDArray[Any]) -> Detection | None:
    """Find part of a checkerboard or a board of circles in a grey picture [v, u] of any real type.

    None when there is no part of such a board. Raises `UnclearPart` with the reason when there
    is one and its points cannot be told for certain.
    """
    level = np.nan_to_num(np.asarray(image, np.float64))
    patch = _FINDERS[target.kind](target, stretched(level)) if target.kind in _FINDERS else None
    if patch is None or len(patch.cells) < LEAST_POINTS or not _is_of_points(target, patch, level):
        return None
    ways = [way for way in _ways(target, patch) if _holds(target, way, level)]
    if not ways:
        raise UnclearPart(
            f"{len(patch.cells)} points of a board are there but no part of this one fits with all it has in "
            f"view, its edge included; show it uncovered before something darker, or mend its description"
        )
    if len(ways) > 1:
        raise UnclearPart(
            f"{len(patch.cells)} points of the board are there but could be any of {len(ways)} parts of it; "
            f"show a corner of the board, or all of it"
        )
    return refined(target, _in_view(target, ways[0], level), level)


def _is_of_points(target: Target, patch: _Patch, level: Floats) -> bool:
    """Whether these are points on a plane's lattice at all: noise has corners and blobs as well."""
    _, step_mm, basis = _lattice(target)
    board: Floats = np.asarray(patch.cells @ basis.T * step_mm, np.float64)
    found, _ = cv2.findHomography(board, patch.pixels, 0)
    if found is None:
        return False
    matrix = np.asarray(found, np.float64)
    off = np.abs(apply_homography(matrix, board) - patch.pixels).max(axis=1)
    steps = np.abs(np.linalg.det(local_frames(matrix, board))) ** 0.5 * step_mm.min()
    if np.any(off > OFF_LATTICE * steps):
        return False
    # Blobs have been looked at as such already, and their lattice may still be seen askew.
    alike = [abs(look[0]) > LIKENESS for look in _looks(target, matrix, board, level)]
    return target.kind == "circles" or bool(np.mean(alike) > 0.5)


def _ways(target: Target, patch: _Patch) -> list[Detection]:
    """Every way to lay the patch on the board that a camera could see."""
    places, step_mm, basis = _lattice(target)
    known = {tuple(place): id_ for id_, place in enumerate(places.tolist())}
    ways = []
    for turn in TURNS:
        laid = patch.cells @ (basis @ turn).T
        if not _could_be_seen(target, np.asarray(laid * step_mm, np.float64), patch.pixels):
            continue
        for place in places:
            ids = [known.get((x, y)) for x, y in (laid + place - laid[0]).tolist()]
            if None not in ids:
                ways.append(Detection(np.array(ids, np.intp), patch.pixels))
    return ways


def _lattice(target: Target) -> tuple[Cells, Floats, Cells]:
    """Places (P, 2) of the board's points in whole steps, the step (2,) in mm, and a basis (2, 2)."""
    columns, rows = target.counts
    j, i = np.mgrid[0:rows, 0:columns]
    if target.staggered:
        places = np.stack([i, 2 * j + i % 2], axis=-1).reshape(-1, 2)
        return places, np.array(target.spacing_mm) * (1.0, 0.5), np.array([[1, 1], [-1, 1]])
    return np.stack([i, j], axis=-1).reshape(-1, 2), np.array(target.spacing_mm), np.eye(2, dtype=np.intp)


def _could_be_seen(target: Target, board: Floats, pixels: Floats) -> bool:
    """Whether points (n, 2) in mm would be seen at these pixels without a board at grazing angles.

    Of a board that is the same after half a turn, the way that points right or down is the one.
    """
    matrix, _ = cv2.findHomography(board, pixels, 0)
    if matrix is None:
        return False
    frames = local_frames(np.asarray(matrix, np.float64), board)
    largest, least = np.linalg.svd(frames, compute_uv=False).T
    turned = target.symmetric and frames.mean(axis=0)[:, 0].sum() < 0
    return bool(np.all(largest < MOST_TILT * least) and np.all(np.linalg.det(frames) > 0) and not turned)


def _holds(target: Target, way: Detection, level: Floats) -> bool:
    """Whether all that should be in the picture is there, and the board ends where it should."""
    matrix = homography(target, way)
    grounds, seen = [], _in_view(target, way, level)
    for id_, look in zip(seen.ids, _looks(target, matrix, target.points()[seen.ids, :2], level), strict=True):
        likeness, bright, dark = look
        row, column = divmod(int(id_), target.counts[0])
        if _sign(target, row, column) * likeness < LIKENESS:
            return False
        grounds.append((bright, dark) if target.background > target.foreground else (dark, bright))
    if len(grounds) < LEAST_POINTS or not _edge_is_seen(target, way, seen, np.array(grounds), level):
        return False
    beyond = _beyond(target)
    in_view = _inside(target, matrix, beyond, level)
    return all(abs(look[0]) < LIKENESS for look in _looks(target, matrix, beyond[in_view], level))


def _looks(
    target: Target, matrix: Floats, board: Floats, level: Floats
) -> Iterator[tuple[float, float, float]]:
    """At places (n, 2) in mm: likeness with a point -1 … 1, brightness where its model is high, and low."""
    shape, start, half_mm = model(target)
    pixels, frames = apply_homography(matrix, board), local_frames(matrix, board)
    for pixel, frame in zip(pixels, frames, strict=True):
        x, y, values = window(level, pixel, frame, half_mm)
        expected = shape(start(frame), x, y)
        if len(values) < LEAST_PIXELS or np.ptp(values) == 0 or np.ptp(np.sign(expected)) == 0:
            yield 0.0, 0.0, 0.0
            continue
        likeness = float(np.corrcoef(values, expected)[0, 1])
        ends = values[expected > 0].mean(), values[expected <= 0].mean()
        yield likeness, float(max(ends)), float(min(ends))


def _beyond(target: Target) -> Floats:
    """Places (n, 2) in mm where the lattice would go on, one step outside the board."""
    columns, rows = target.counts
    i, j = (a.ravel() for a in np.meshgrid(np.arange(-1, columns + 1), np.arange(-1, rows + 1)))
    outside = (i < 0) | (i == columns) | (j < 0) | (j == rows)
    half = 0.5 * (i % 2) if target.staggered else 0.0
    steps = np.stack([i, j + half], axis=-1)[outside]
    return np.asarray(target.points()[0, :2] + steps * target.spacing_mm)


def _in_view(target: Target, way: Detection, level: Floats) -> Detection:
    """All points of the board that are in the picture with their surroundings."""
    matrix, board = homography(target, way), target.points()[:, :2]
    inside = _inside(target, matrix, board, level)
    return Detection(np.flatnonzero(inside), apply_homography(matrix, board[inside]))


def _inside(target: Target, matrix: Floats, board: Floats, level: Floats) -> NDArray[np.bool_]:
    """Which of the places (n, 2) in mm are in the picture with their surroundings."""
    pixels = apply_homography(matrix, board)
    margin = model(target)[2] * np.abs(local_frames(matrix, board)).sum(axis=2)
    before = (board @ matrix[2, :2] + matrix[2, 2]) * matrix[2, 2] > 0
    fits = (pixels >= margin) & (pixels <= np.array(level.shape[1::-1]) - 1 - margin)
    return np.asarray(fits.all(axis=1) & before)


def _sign(target: Target, row: int, column: int) -> int:
    """Whether a point's model or the reverse of it is what the board has there."""
    odd = target.kind == "checkerboard" and (row + column) % 2 == 1
    return -1 if odd != (target.foreground > target.background) else 1


def _edge_is_seen(target: Target, way: Detection, seen: Detection, grounds: Floats, level: Floats) -> bool:
    """Whether each side of the board ends where it should, as far as it is in the picture.

    grounds: (K, 2) brightness of ground and of ink at the points seen.
    """
    half = 0.5 * np.array(target.size_mm)
    drawn = np.abs(target.points()[:, :2]).max(axis=0) + target.reach()
    inset = 0.5 * float(np.min(half - drawn))
    along = np.linspace(-1, 1, 80)
    nearest = cKDTree(seen.pixels)
    for axis, side in product((0, 1), (-1, 1)):
        edge = np.insert(along[:, None], axis, side, axis=1)
        pixels = apply_homography(
            homography(target, way), np.stack([edge * (half - inset), edge * (half + inset)])
        )
        in_view = ((pixels >= 1) & (pixels <= np.array(level.shape[1::-1]) - 2)).all(axis=(0, 2))
        if not in_view.any():
            continue
        inner, outer = pixels[:, in_view]
        ground, ink = grounds[nearest.query(inner)[1]].T
        off = [
            np.abs(map_coordinates(level, p[:, ::-1].T, order=1) - ground) / np.abs(ground - ink)
            for p in (inner, outer)
        ]
        if np.mean((off[0] < LIKE_GROUND) & (off[1] > LIKE_GROUND)) < EDGE:
            return False
    return True


def _patch_of_corners(target: Target, grey: NDArray[np.uint8]) -> _Patch | None:
    """The largest grid of corners that OpenCV finds."""
    flags = CHECKERBOARD_FLAGS | cv2.CALIB_CB_LARGER
    found, pixels, meta = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
    if not found:
        return None
    rows, columns = meta.shape[:2]
    grid = np.asarray(pixels, np.float64).reshape(rows, columns, 2)
    j, i = np.mgrid[0:rows, 0:columns]
    return _from_front(np.stack([i, j], axis=-1).reshape(-1, 2), grid.reshape(-1, 2))


def _from_front(cells: Cells, pixels: Floats) -> _Patch:
    slope = np.linalg.lstsq(cells - cells.mean(axis=0), pixels - pixels.mean(axis=0), rcond=None)[0]
    return _Patch(cells if np.linalg.det(slope) > 0 else cells[:, ::-1], pixels)


def _patch_of_circles(target: Target, grey: NDArray[np.uint8]) -> _Patch | None:
    """The largest lattice that dark or bright blobs form."""
    found = blobs(target, grey)
    if len(found) < LEAST_POINTS:
        return None
    middle = np.argsort(np.linalg.norm(found - np.median(found, axis=0), axis=1))
    patches = [_grown(found, seed) for seed in middle[:8]]
    best = max(patches, key=lambda patch: len(patch.cells))
    return best if np.all(np.ptp(best.cells, axis=0) > 0) else None


def _grown(found: Floats, seed: int) -> _Patch:
    """The patch around one blob, whose nearest neighbours are taken for steps of the lattice."""
    offsets = found - found[seed]
    order = np.argsort(np.linalg.norm(offsets, axis=1))[1:]
    first = offsets[order[0]]
    across = [o for o in offsets[order] if abs(_sine(first, o)) > 0.4]
    if not across:
        return _Patch(np.zeros((1, 2), np.intp), found[[seed]])
    second = across[0] if _sine(first, across[0]) > 0 else -across[0]
    view = np.array(
        [[*np.stack([first, second], axis=1)[k], found[seed][k]] for k in range(2)] + [[0, 0, 1.0]]
    )
    kept, cells = np.array([seed]), np.zeros((1, 2), np.intp)
    for _ in range(60):
        places = apply_homography(np.linalg.inv(view), found)
        whole = np.rint(places)
        near = cKDTree(cells).query(whole)[0] < 1.5  # next to what is known already
        fits = np.flatnonzero(near & (np.abs(places - whole).max(axis=1) < OFF_LATTICE))
        cells_now, first_of = np.unique(whole[fits].astype(np.intp), axis=0, return_index=True)
        kept_now = fits[first_of]
        if np.array_equal(kept_now, kept) or len(kept_now) < 4:
            break
        kept, cells = kept_now, cells_now
        matrix, _ = cv2.findHomography(cells.astype(np.float64), found[kept], 0)
        if matrix is None or abs(np.linalg.det(matrix)) < 1e-9:
            break
        view = matrix
    return _Patch(cells, found[kept])


def _sine(a: Floats, b: Floats) -> float:
    return float((a[0] * b[1] - a[1] * b[0]) / (np.linalg.norm(a) * np.linalg.norm(b)))


_FINDERS = {"checkerboard": _patch_of_corners, "circles": _patch_of_circles}
