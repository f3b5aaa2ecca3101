"""Detection of a board of which only part is in the image, where it is certain which part.

A patch of the lattice is found, and every placement of it on the board tried. One is valid when each point
that should be in the image is there, and the board ends where the lattice does and its edge is visible:
whatever occludes points of the board occludes its edge as well, and would otherwise be taken for its end.
"""

from collections.abc import Iterator
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.targets.detection import refine_points
from fpplab.targets.layout import BoardLayout, GridPatch
from fpplab.targets.limits import TARGET_LIMITS as LIMITS
from fpplab.targets.views import (
    Detection,
    apply_homography,
    homography,
    homography_jacobians,
    stretch_to_8_bits,
    window_around_point,
)

TURNS = [np.array(m).reshape(2, 2) for m in product(range(-2, 3), repeat=4) if m[0] * m[3] - m[1] * m[2] == 1]
"""Changes of a lattice's basis that preserve its orientation."""


class UnclearPart(CalibrationError):  # noqa: N818 - the view is at fault, not the software
    """Part of a board is in view but it is not certain which."""


def detect_part(layout: BoardLayout, image: NDArray[Any]) -> Detection | None:
    # image (height, width)
    level = np.nan_to_num(np.asarray(image, np.float64))
    patch = layout.find_patch(stretch_to_8_bits(level))
    if patch is None or len(patch.cells) < LIMITS.min_points or not _is_of_points(layout, patch, level):
        return None
    valid = [way for way in _placements(layout, patch) if _is_valid(layout, way, level)]
    if not valid:
        raise UnclearPart(
            f"{len(patch.cells)} points of a board were found but no part of this board fits with all that "
            f"should be in view, its edge included; show it unobstructed in front of something darker, or "
            f"correct its description"
        )
    if len(valid) > 1:
        raise UnclearPart(
            f"{len(patch.cells)} points of the board were found but could be any of {len(valid)} parts of "
            f"it; show a corner of the board, or all of it"
        )
    return refine_points(layout, _in_view(layout, valid[0], level), level)


def _is_of_points(layout: BoardLayout, patch: GridPatch, level: Floats) -> bool:
    """Whether the patch is a plane's lattice at all: noise has corners and blobs as well."""
    lattice = layout.lattice()
    board: Floats = np.asarray(patch.cells @ lattice.basis.T * lattice.step_mm, np.float64)
    homography_found, _ = cv2.findHomography(board, patch.pixels, 0)
    if homography_found is None:
        return False
    matrix = np.asarray(homography_found, np.float64)
    off = np.abs(apply_homography(matrix, board) - patch.pixels).max(axis=1)
    steps = np.abs(np.linalg.det(homography_jacobians(matrix, board))) ** 0.5 * lattice.step_mm.min()
    if np.any(off > LIMITS.max_lattice_offset * steps):
        return False
    # The lattice of a verified patch may still be in a skew basis, in which its points look different.
    fits = [abs(look[0]) > LIMITS.min_correlation for look in _compare_marks(layout, matrix, board, level)]
    return patch.verified or bool(np.mean(fits) > 0.5)


def _placements(layout: BoardLayout, patch: GridPatch) -> list[Detection]:
    lattice = layout.lattice()
    id_of_place = {tuple(place): id_ for id_, place in enumerate(lattice.places.tolist())}
    placements = []
    for turn in TURNS:
        laid = patch.cells @ (lattice.basis @ turn).T
        if not _could_a_camera_see(layout, np.asarray(laid * lattice.step_mm, np.float64), patch.pixels):
            continue
        for place in lattice.places:
            ids = [id_of_place.get((x, y)) for x, y in (laid + place - laid[0]).tolist()]
            if None not in ids:
                placements.append(Detection(np.array(ids, np.intp), patch.pixels))
    return placements


def _could_a_camera_see(layout: BoardLayout, board: Floats, pixels: Floats) -> bool:
    """Whether points (n, 2) in mm could be seen at these pixels without a board at grazing angles."""
    # Of a board that is the same after half a turn, the placement whose x axis points right or down is taken.
    matrix, _ = cv2.findHomography(board, pixels, 0)
    if matrix is None:
        return False
    jacobians = homography_jacobians(np.asarray(matrix, np.float64), board)
    largest, smallest = np.linalg.svd(jacobians, compute_uv=False).T
    turned = layout.symmetric and jacobians.mean(axis=0)[:, 0].sum() < 0
    return bool(
        np.all(largest < LIMITS.max_scale_ratio * smallest)
        and np.all(np.linalg.det(jacobians) > 0)
        and not turned
    )


def _is_valid(layout: BoardLayout, placement: Detection, level: Floats) -> bool:
    """Whether all that should be in the image is there, and the board ends where it should."""
    matrix = homography(layout, placement)
    grounds, visible = [], _in_view(layout, placement, level)
    looks = _compare_marks(layout, matrix, layout.points()[visible.ids, :2], level)
    for id_, (likeness, bright, dark) in zip(visible.ids, looks, strict=True):
        row, column = divmod(int(id_), layout.counts[0])
        if layout.polarity(row, column) * likeness < LIMITS.min_correlation:
            return False
        grounds.append((bright, dark) if layout.background > layout.foreground else (dark, bright))
    if len(grounds) < LIMITS.min_points or not _edge_is_seen(
        layout, placement, visible, np.array(grounds), level
    ):
        return False
    beyond = _places_beyond_board(layout)
    in_view = _are_inside_image(layout, matrix, beyond, level)
    return all(
        abs(look[0]) < LIMITS.min_correlation
        for look in _compare_marks(layout, matrix, beyond[in_view], level)
    )


def _compare_marks(
    layout: BoardLayout, matrix: Floats, board: Floats, level: Floats
) -> Iterator[tuple[float, float, float]]:
    """Compare places (n, 2) in mm with a point's model: correlation, brightness where it is high, and low."""
    model = layout.point_model()
    pixels, jacobians = apply_homography(matrix, board), homography_jacobians(matrix, board)
    for pixel, jacobian in zip(pixels, jacobians, strict=True):
        x, y, values = window_around_point(level, pixel, jacobian, model.half_mm)
        expected = model.brightness(model.initial_parameters(jacobian), x, y)
        if len(values) < LIMITS.min_model_pixels or np.ptp(values) == 0 or np.ptp(np.sign(expected)) == 0:
            yield 0.0, 0.0, 0.0
            continue
        likeness = float(np.corrcoef(values, expected)[0, 1])
        ends = values[expected > 0].mean(), values[expected <= 0].mean()
        yield likeness, float(max(ends)), float(min(ends))


def _places_beyond_board(layout: BoardLayout) -> Floats:
    """Places (n, 2) in mm where the grid would continue, one step outside the board."""
    columns, rows = layout.counts
    i, j = (a.ravel() for a in np.meshgrid(np.arange(-1, columns + 1), np.arange(-1, rows + 1)))
    outside = (i < 0) | (i == columns) | (j < 0) | (j == rows)
    steps = layout.offsets(i[outside].astype(np.float64), j[outside].astype(np.float64))
    return np.asarray(layout.points()[0, :2] + steps)


def _in_view(layout: BoardLayout, placement: Detection, level: Floats) -> Detection:
    """All points of the board that are in the image with their surroundings."""
    matrix, board = homography(layout, placement), layout.points()[:, :2]
    inside = _are_inside_image(layout, matrix, board, level)
    return Detection(np.flatnonzero(inside), apply_homography(matrix, board[inside]))


def _are_inside_image(layout: BoardLayout, matrix: Floats, board: Floats, level: Floats) -> NDArray[np.bool_]:
    """Which of the places (n, 2) in mm are in the image with their surroundings."""
    pixels = apply_homography(matrix, board)
    margin = layout.point_model().half_mm * np.abs(homography_jacobians(matrix, board)).sum(axis=2)
    before = (board @ matrix[2, :2] + matrix[2, 2]) * matrix[2, 2] > 0
    fits = (pixels >= margin) & (pixels <= np.array(level.shape[1::-1]) - 1 - margin)
    return np.asarray(fits.all(axis=1) & before)


def _edge_is_seen(
    layout: BoardLayout, placement: Detection, visible: Detection, grounds: Floats, level: Floats
) -> bool:
    """Whether each side of the board ends where it should, as far as it is in the image."""
    # grounds: (K, 2) brightness of background and of foreground at the visible points.
    half = 0.5 * np.array(layout.size_mm)
    drawn = np.abs(layout.points()[:, :2]).max(axis=0) + layout.reach()
    inset = 0.5 * float(np.min(half - drawn))
    along = np.linspace(-1, 1, 80)
    nearest = cKDTree(visible.pixels)
    for axis, side in product((0, 1), (-1, 1)):
        edge = np.insert(along[:, None], axis, side, axis=1)
        pixels = apply_homography(
            homography(layout, placement), np.stack([edge * (half - inset), edge * (half + inset)])
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
        if (
            np.mean((off[0] < LIMITS.ground_tolerance) & (off[1] > LIMITS.ground_tolerance))
            < LIMITS.min_edge_share
        ):
            return False
    return True
