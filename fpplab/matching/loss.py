"""How far a twin is from its bench: `L = α log(1 + |ε_d|) + β (1 - SSIM)`, the paper's loss.

`ε_d = ε_r - ε_v` is the RMS reprojection error of the bench's characterisation less the twin's; the SSIM is
the standard one (Wang et al., "Image quality assessment", 2004) with levels from 0 to full scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Document
from fpplab.core.conventions import Floats, Mask, PixelIndices
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.targets import Target

EDGE_POINTS = 50
"""Points along each edge of a board's outline, which the lens bends."""
MARGIN_PX = 4
"""How far inside its outline a board begins: half of the SSIM's window of 7 px, rounded up."""

BEYOND_PX = 3
"""The board's edge tells where it is, so its surroundings belong to the picture."""
SOFT = 3.0
"""Residuals beyond this many robust standard deviations count linearly (Huber)."""
ROUNDING = 0.29
"""Standard deviation of rounding to integers, under which no residual can be."""


class Weights(Document):
    """Of the loss; what suits a system with much noise is a lesser beta."""

    alpha: float = 0.2
    beta: float = 0.8


@dataclass(frozen=True, eq=False)
class Similarity:
    """SSIM of images (n,): mean over the whole image, and over the board in it."""

    whole: Floats
    board: Floats


@dataclass(frozen=True, eq=False)
class Loss:
    """The loss with its parts: mean and spread over the images.

    epsilon_r, epsilon_v: joint RMS reprojection error of the bench and of the twin, in px.
    """

    weights: Weights
    epsilon_r: float
    epsilon_v: float
    similarity: Similarity

    @property
    def epsilon_d(self) -> float:
        """In px, signed: the bench's less the twin's."""
        return self.epsilon_r - self.epsilon_v

    @property
    def whole(self) -> float:
        """The loss with the SSIM of whole images."""
        return float(self._of(self.similarity.whole).mean())

    @property
    def board(self) -> float:
        """The loss with the SSIM over the board, which a dark ground cannot flatter."""
        return float(self._of(self.similarity.board).mean())

    def _of(self, ssim: Floats) -> Floats:
        geometric = self.weights.alpha * np.log1p(abs(self.epsilon_d))
        return np.asarray(geometric + self.weights.beta * (1.0 - ssim))

    def summary(self) -> dict[str, Any]:
        """Plain values: the loss over whole images and over the board, its parts, and their spread."""
        return {
            "loss": self.whole,
            "loss_board": self.board,
            "ssim": float(self.similarity.whole.mean()),
            "ssim_board": float(self.similarity.board.mean()),
            "ssim_spread": float(self.similarity.whole.std()),
            "ssim_board_spread": float(self.similarity.board.std()),
            "loss_spread": float(self._of(self.similarity.whole).std()),
            "epsilon_d_px": self.epsilon_d,
            "epsilon_r_px": self.epsilon_r,
            "epsilon_v_px": self.epsilon_v,
            "images": len(self.similarity.whole),
        }


def ssim(bench: NDArray[Any], twin: NDArray[Any], full_scale: float, board: Mask) -> tuple[float, float]:
    """SSIM of two images [v, u] in raw levels: of the whole image, and over the mask `board`."""
    from skimage import metrics

    compared: Any = metrics.structural_similarity
    mean, every = compared(
        bench.astype(np.float32), twin.astype(np.float32), data_range=full_scale, full=True
    )
    return float(mean), float(every[board].mean())


def board_mask(
    camera: Pinhole, T_camera_board: RigidTransform, target: Target, margin_px: int = MARGIN_PX
) -> Mask:
    """Pixels [v, u] that look at the board, `margin_px` or more inside its outline (outside, if negative)."""
    half_x, half_y = 0.5 * np.array(target.size_mm)
    along = np.linspace(-1.0, 1.0, EDGE_POINTS, endpoint=False)
    one = np.ones_like(along)
    x = np.concatenate([along, one, -along, -one]) * half_x
    y = np.concatenate([-one, along, one, -along]) * half_y
    outline = camera.project(np.stack([x, y, np.zeros_like(x)], axis=-1), T_camera_board)
    width, height = camera.size
    area = np.zeros((height, width), np.uint8)
    cv2.fillPoly(area, [np.rint(outline * 16).astype(np.int32)], (1,), shift=4)
    if margin_px:
        reach = 2 * abs(margin_px) + 1
        square = np.ones((reach, reach), np.uint8)
        away = cv2.erode(area, square, borderValue=(0,)) if margin_px > 0 else cv2.dilate(area, square)
        area = np.asarray(away, np.uint8)
    return np.asarray(area, np.bool_)


def thinned(area: Mask, most: int) -> PixelIndices:
    """An area's pixels, evenly thinned to about `most`."""
    v, u = np.nonzero(area)
    thin = max(1, int(np.sqrt(len(u) / most)))
    chosen = (v % thin == 0) & (u % thin == 0)
    return v[chosen], u[chosen]


def soft_weights(residual: Floats) -> tuple[Floats, float]:
    """Huber's weights, 1 for what is no outlier, and the robust standard deviation, in raw levels."""
    sigma = max(1.4826 * float(np.median(np.abs(residual))), ROUNDING)
    return np.minimum(1.0, SOFT * sigma / np.maximum(np.abs(residual), 1e-12)), sigma
