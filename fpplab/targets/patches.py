"""Patches of a lattice grown from points in an image, for boards that are only partly in view."""

import cv2
import numpy as np
from scipy.spatial import cKDTree

from fpplab.core.conventions import Floats
from fpplab.targets.layout import Cells, GridPatch
from fpplab.targets.limits import TARGET_LIMITS as LIMITS
from fpplab.targets.views import apply_homography


def facing_front(cells: Cells, pixels: Floats) -> GridPatch:
    """Make a patch whose lattice basis is right-handed as seen from the front."""
    # cells (n, 2); pixels (n, 2) px
    slope = np.linalg.lstsq(cells - cells.mean(axis=0), pixels - pixels.mean(axis=0), rcond=None)[0]
    return GridPatch(cells if np.linalg.det(slope) > 0 else cells[:, ::-1], pixels)


def patch_of_blobs(blobs: Floats) -> GridPatch | None:
    # blobs (n, 2) px
    if len(blobs) < LIMITS.min_points:
        return None
    middle = np.argsort(np.linalg.norm(blobs - np.median(blobs, axis=0), axis=1))
    patches = [_grow_patch(blobs, seed) for seed in middle[:8]]
    best = max(patches, key=lambda patch: len(patch.cells))
    return best if np.all(np.ptp(best.cells, axis=0) > 0) else None


def _grow_patch(blobs: Floats, seed: int) -> GridPatch:
    offsets = blobs - blobs[seed]
    order = np.argsort(np.linalg.norm(offsets, axis=1))[1:]
    first = offsets[order[0]]
    across = [o for o in offsets[order] if abs(_sine(first, o)) > 0.4]
    if not across:
        return GridPatch(np.zeros((1, 2), np.intp), blobs[[seed]], verified=True)
    second = across[0] if _sine(first, across[0]) > 0 else -across[0]
    view = np.array(
        [[*np.stack([first, second], axis=1)[k], blobs[seed][k]] for k in range(2)] + [[0, 0, 1.0]]
    )
    kept, cells = np.array([seed]), np.zeros((1, 2), np.intp)
    for _ in range(60):
        places = apply_homography(np.linalg.inv(view), blobs)
        whole = np.rint(places)
        near = cKDTree(cells).query(whole)[0] < 1.5  # next to what is known already
        fits = np.flatnonzero(near & (np.abs(places - whole).max(axis=1) < LIMITS.max_lattice_offset))
        cells_now, first_of = np.unique(whole[fits].astype(np.intp), axis=0, return_index=True)
        kept_now = fits[first_of]
        if np.array_equal(kept_now, kept) or len(kept_now) < 4:
            break
        kept, cells = kept_now, cells_now
        matrix, _ = cv2.findHomography(cells.astype(np.float64), blobs[kept], 0)
        if matrix is None or abs(np.linalg.det(matrix)) < 1e-9:
            break
        view = matrix
    return GridPatch(cells, blobs[kept], verified=True)


def _sine(a: Floats, b: Floats) -> float:
    return float((a[0] * b[1] - a[1] * b[0]) / (np.linalg.norm(a) * np.linalg.norm(b)))
