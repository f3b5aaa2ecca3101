"""The print of a flat item, blurred by spots of several sizes.

Sizes are the same for all items, so that a board that moves, or a lens that is focused, keeps what was
blurred before. What is blurred is where the item is and where its ground is; reflectances come in afterwards.
"""

import math
import threading
from collections import OrderedDict
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats

SIZE_RATIO = 1.2
"""Ratio of the variances of successive sizes of spots; between them the print is interpolated (chosen)."""
RIM_SIGMAS = 4.0
"""Margin of the blurred print beyond the item's edges, in standard deviations of the blur (chosen)."""
KEEP_BYTES = 1 << 28
"""Size of all prints that are kept (chosen). One has three quarters of it for all sizes that were asked for:
the same board is drawn at two resolutions, as poses are near or far, and the finer takes most."""

_Picture = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class BlurredPictures:
    """What is printed on a rectangle, for several sizes of spots."""

    pictures: _Picture  # (sizes, rows, columns): share of the ground in what is seen, 0 beyond the item
    across: _Picture  # (sizes, columns) and (sizes, rows)
    down: _Picture  # (sizes, columns) and (sizes, rows)
    rim: tuple[int, int]  # columns on either side, and rows above and below, that lie beyond the item
    variances_mm2: Floats  # (sizes,) in mm², rising


def unblurred_picture(picture: NDArray[np.uint8] | None) -> BlurredPictures:
    share = np.ones((1, 1), np.float32) if picture is None else picture / np.float32(255)
    rows, columns = share.shape
    even = np.ones((1, max(rows, columns)), np.float32)
    return BlurredPictures(share[None], even[:, :columns], even[:, :rows], (0, 0), np.zeros(1))


@dataclass(frozen=True, eq=False)
class _Kept:
    """A picture blurred for the sizes from `first` to `last` as powers of `SIZE_RATIO`."""

    picture: NDArray[np.uint8]
    first: int
    last: int
    blurred: BlurredPictures

    @property
    def nbytes(self) -> int:
        return self.blurred.pictures.nbytes


class BlurredPictureCache:
    """Blurred pictures of the pictures asked for last, for all sizes that were asked for."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[int, float, float], _Kept] = OrderedDict()

    def blurred(
        self,
        picture: NDArray[np.uint8],
        px_per_mm: tuple[float, float],
        min_variance_mm2: float,
        max_variance_mm2: float,
    ) -> BlurredPictures:
        """Blur a print for all spots between two sizes, unless it is there."""
        first, last = (
            math.floor(math.log(v) / math.log(SIZE_RATIO)) for v in (min_variance_mm2, max_variance_mm2)
        )
        first, last, key = first - 1, last + 2, (id(picture), *px_per_mm)
        with self._lock:
            kept = self._kept.get(key)
            if kept is not None:
                if kept.first <= first and last <= kept.last:
                    self._kept.move_to_end(key)
                    return kept.blurred
                widest = min(kept.first, first), max(kept.last, last)
                if 4 * picture.size * (widest[1] - widest[0] + 1) <= 0.75 * KEEP_BYTES:
                    first, last = widest
            blurred = _blur_picture(picture, px_per_mm, SIZE_RATIO ** np.arange(first, last + 1.0))
            # with the picture itself, so that no other has its number
            self._kept[key] = _Kept(picture, first, last, blurred)
            self._kept.move_to_end(key)
            while len(self._kept) > 1 and sum(entry.nbytes for entry in self._kept.values()) > KEEP_BYTES:
                self._kept.popitem(last=False)
            return blurred


def _blur_picture(
    picture: NDArray[np.uint8], px_per_mm: tuple[float, float], variances_mm2: Floats
) -> BlurredPictures:
    rim_x, rim_y = (
        math.ceil(RIM_SIGMAS * math.sqrt(variances_mm2[-1]) * of_axis) + 1 for of_axis in px_per_mm
    )
    share = np.pad(picture / np.float32(255), ((rim_y, rim_y), (rim_x, rim_x)))
    rows, columns = picture.shape
    along, upright = (np.pad(np.ones(n), rim) for n, rim in ((columns, rim_x), (rows, rim_y)))
    pictures = np.empty((len(variances_mm2), *share.shape), np.float32)
    across, down = [], []
    for out, sigma in zip(pictures, np.sqrt(variances_mm2).tolist(), strict=True):
        x, y = (_gaussian(sigma * of_axis) for of_axis in px_per_mm)
        cv2.sepFilter2D(share, -1, x, y, out, borderType=cv2.BORDER_CONSTANT)
        across.append(np.convolve(along, x, "same"))
        down.append(np.convolve(upright, y, "same"))
    return BlurredPictures(
        pictures, np.array(across, np.float32), np.array(down, np.float32), (rim_x, rim_y), variances_mm2
    )


def _gaussian(sigma: float) -> Floats:
    reach = math.ceil(RIM_SIGMAS * sigma)
    return np.asarray(cv2.getGaussianKernel(2 * reach + 1, sigma)[:, 0], np.float64)
