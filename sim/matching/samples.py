"""Samples of the bench's recordings, to which the twin's light is fitted: pixels of the board's images."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, PixelIndices
from sim.matching.loss import SURROUNDINGS_PX, board_mask, subsample_pixels
from sim.matching.reference import Reference
from sim.parameters import TwinParameters
from sim.twin import Twin

TILES = 5  # tiles along each side of the board, in which residuals count as dependent (chosen)


class LightSample(Protocol):
    """Levels of the bench at some pixels, which the twin's are compared with."""

    @property
    def clusters(self) -> NDArray[np.int64]:
        """Numbers (3, N) of the clusters of every residual, by three groupings.

        What the twin lacks is shared by residuals that have one of them in common.
        """

    def residual(self, reference: Reference, twin: Twin) -> Floats:
        """Bench less twin (N,), in raw levels of the reference."""


@dataclass(frozen=True, eq=False)
class PixelSample:
    """Some pixels of some images of a pose."""

    pose: int  # index of the pose
    images: tuple[int, ...]  # indices of the n images in the plan
    pixels: PixelIndices  # rows and columns of the P pixels
    levels: Floats  # raw levels (n, P) of the reference

    @property
    def tiles(self) -> NDArray[np.int64]:
        """Number of the tile of every pixel, (P,): residuals within one count as dependent."""
        return tile_numbers(self.pixels)

    @property
    def clusters(self) -> NDArray[np.int64]:
        """Numbers (3, n P) of tile, pose and image of every residual."""
        count, tiles = len(self.images), self.tiles
        poses = np.full(count * len(tiles), self.pose)
        return np.array([np.tile(tiles, count), poses, np.repeat(self.images, len(tiles))], np.int64)

    def residual(self, reference: Reference, twin: Twin) -> Floats:
        # returns (n P,)
        patterns = reference.shown(self.images)
        here = twin.expected_at(self.pose, patterns, reference.settings, self.pixels).astype(np.float64)
        return np.where(self._is_valid(reference, here), self.levels - here, 0.0).ravel()

    def laplacian(self, reference: Reference, twin: Twin) -> Floats:
        """Compute the Laplacian of the twin's levels (n P,), to which a slight blur is proportional."""
        patterns, (rows, columns) = reference.shown(self.images), self.pixels
        width, height = twin.parameters.calibration.camera.size
        step = 1 if reference.mosaic is None else 2  # to the next pixel of the same colour

        def at(down: int, right: int) -> Floats:
            pixels = (rows + down).clip(0, height - 1), (columns + right).clip(0, width - 1)
            return twin.expected_at(self.pose, patterns, reference.settings, pixels).astype(np.float64)

        here = at(0, 0)
        around = at(step, 0) + at(-step, 0) + at(0, step) + at(0, -step)
        return np.where(self._is_valid(reference, here), around - 4.0 * here, 0.0).ravel()

    def _is_valid(self, reference: Reference, here: Floats) -> NDArray[np.bool_]:
        # Where there is no light there is hardly any noise, and all levels are rounded to the same side.
        lit = self.levels > reference.darkest_level + 2.0
        return lit & (self.levels < reference.full_scale) & (here < reference.full_scale)


def tile_numbers(pixels: PixelIndices) -> NDArray[np.int64]:
    # returns (P,)
    row, column = (TILES * (index - index.min()) // (np.ptp(index) + 1) for index in pixels)
    return np.asarray(TILES * row + column, np.int64)


def sample_pixels(
    reference: Reference, parameters: TwinParameters, poses: Sequence[int], images: Sequence[int]
) -> list[PixelSample]:

    def one(pose: int) -> PixelSample:
        area = board_mask(
            parameters.calibration.camera, parameters.poses[pose], reference.target, -SURROUNDINGS_PX
        )
        pixels = subsample_pixels(area, 8_000)
        levels = reference.frames(pose, images)[:, *pixels].astype(np.float64)
        return PixelSample(pose, tuple(images), pixels, levels)

    return [one(pose) for pose in poses]
