"""Orientation of a detected grid of points: which of its corners is the board's first point."""

from collections.abc import Callable

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.targets.layout import BoardLayout
from fpplab.targets.views import Detection, apply_homography, homography, whole_board


def in_order(
    layout: BoardLayout, grid: Floats, accepts: Callable[[Floats], bool] | None = None
) -> Detection | None:
    # grid (rows, columns, 2) px
    turns = [grid, grid[::-1, ::-1], grid[::-1], grid[:, ::-1]]
    fits = [(_misfit(layout, turn), turn) for turn in turns if _seen_from_front(turn)]
    best = min(misfit for misfit, _ in fits)
    spacing = float(np.linalg.norm(np.diff(grid, axis=1), axis=-1).min())
    if best > 0.25 * spacing:
        return None
    candidates = [turn for misfit, turn in fits if misfit < best + 0.1 * spacing]
    if accepts is not None:
        candidates = [turn for turn in candidates if accepts(turn)]
    return whole_board(max(candidates, key=_uprightness)) if candidates else None


def _seen_from_front(grid: Floats) -> bool:
    x, y = np.diff(grid, axis=1).mean(axis=(0, 1)), np.diff(grid, axis=0).mean(axis=(0, 1))
    return bool(x[0] * y[1] - x[1] * y[0] > 0)


def _misfit(layout: BoardLayout, grid: Floats) -> float:
    """RMS distance in px of a grid from the best perspective view of the board."""
    detection = whole_board(grid)
    fitted = apply_homography(homography(layout, detection), layout.points()[:, :2])
    return float(np.sqrt(np.mean(np.sum((fitted - detection.pixels) ** 2, axis=1))))


def _uprightness(grid: Floats) -> float:
    # The decision boundary is a diagonal, an orientation in which boards are rarely held.
    right, down = np.diff(grid, axis=1).mean(axis=(0, 1))
    return float(right + down)
