"""The loss of a twin against the reference: `L = α log(1 + |ε_d|) + β (1 - SSIM)`, as in the paper.

`ε_d = ε_r - ε_v` is the RMS reprojection error of the reference's characterisation less that of the twin's.
The SSIM is the standard one with levels from 0 to full scale.

Source: Wang et al., "Image quality assessment", 2004.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Document
from fpplab.core.conventions import Floats, Mask, PixelIndices
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.core.robust import huber_weights, robust_spread
from fpplab.targets import Target

WINDOW_PX = 7  # side of the windows of the SSIM (source: scikit-image)
SURROUNDINGS_PX = 3
"""Width of the surroundings of the board that are compared too: its edge shows where it is (chosen)."""


class Weights(Document):
    """Weights of the two parts of the loss; a system with much noise needs a smaller beta."""

    alpha: float = 0.2
    """Weight of `log(1 + |ε_d|)`, ε_d in px."""
    beta: float = 0.8
    """Weight of 1 - SSIM."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """SSIM of n images."""

    whole: Floats  # mean over the whole image, (n,)
    board: Floats  # mean over the board in the image, (n,)


@dataclass(frozen=True, eq=False)
class Loss:
    """The loss with its parts; each figure has a mean and a spread over the images."""

    weights: Weights  # of the two parts
    reference_rms_px: float  # joint RMS reprojection error of the reference in px
    twin_rms_px: float  # joint RMS reprojection error of the twin in px
    similarity: Similarity  # SSIM of every compared image

    @property
    def rms_difference_px(self) -> float:
        """RMS reprojection error of the reference less that of the twin, in px, signed."""
        return self.reference_rms_px - self.twin_rms_px

    @property
    def whole(self) -> float:
        return float(self._of(self.similarity.whole).mean())

    @property
    def board(self) -> float:
        """The loss with the SSIM over the board, which a dark background does not improve."""
        return float(self._of(self.similarity.board).mean())

    def _of(self, ssim: Floats) -> Floats:
        geometric = self.weights.alpha * np.log1p(abs(self.rms_difference_px))
        return np.asarray(geometric + self.weights.beta * (1.0 - ssim))

    def summary(self) -> dict[str, Any]:
        """Give plain values: the loss over whole images and over the board, its parts, and their spread."""
        return {
            "loss": self.whole,
            "loss_board": self.board,
            "ssim": float(self.similarity.whole.mean()),
            "ssim_board": float(self.similarity.board.mean()),
            "ssim_spread": float(self.similarity.whole.std()),
            "ssim_board_spread": float(self.similarity.board.std()),
            "loss_spread": float(self._of(self.similarity.whole).std()),
            "epsilon_d_px": self.rms_difference_px,
            "epsilon_r_px": self.reference_rms_px,
            "epsilon_v_px": self.twin_rms_px,
            "images": len(self.similarity.whole),
        }


def ssim(reference: NDArray[Any], twin: NDArray[Any], full_scale: float, board: Mask) -> tuple[float, float]:
    """Compute the SSIM over the image without its margin, and over the board, as scikit-image does."""
    # OpenCV's windows take less than half of the time, and a matching compares hundreds of images.
    a, b = reference.astype(np.float32), twin.astype(np.float32)

    def windowed(image: NDArray[Any]) -> NDArray[Any]:
        return cv2.boxFilter(image, -1, (WINDOW_PX, WINDOW_PX), borderType=cv2.BORDER_REFLECT)

    mean_a, mean_b = windowed(a), windowed(b)
    unbiased = np.float32(WINDOW_PX**2 / (WINDOW_PX**2 - 1))
    squares = unbiased * (windowed(a * a + b * b) - mean_a**2 - mean_b**2)
    product = unbiased * (windowed(a * b) - mean_a * mean_b)
    dim, even = np.float32((0.01 * full_scale) ** 2), np.float32((0.03 * full_scale) ** 2)
    every = (2 * mean_a * mean_b + dim) * (2 * product + even)
    every /= (mean_a**2 + mean_b**2 + dim) * (squares + even)
    inner = slice(WINDOW_PX // 2, -(WINDOW_PX // 2))
    return float(every[inner, inner].mean(dtype=np.float64)), float(every[board].mean())


def board_mask(camera: Pinhole, T_camera_board: RigidTransform, target: Target, margin_px: int = 4) -> Mask:
    """Find the pixels that see the board; the margin is half of the SSIM's window of 7 px, rounded up."""
    half = 0.5 * np.array(target.size_mm)
    return rectangle_mask(camera, T_camera_board, -half, half, margin_px)


def rectangle_mask(
    camera: Pinhole, T_camera_board: RigidTransform, low: Floats, high: Floats, margin_px: int = 0
) -> Mask:
    # low, high (2,) mm
    along = np.linspace(-1.0, 1.0, 50, endpoint=False)  # many points: the lens bends the edges
    edge = np.ones_like(along)
    square = np.stack(
        [np.concatenate([along, edge, -along, -edge]), np.concatenate([-edge, along, edge, -along])]
    )
    places = 0.5 * (low + high) + 0.5 * (high - low) * square.T
    outline = camera.project(np.pad(places, ((0, 0), (0, 1))), T_camera_board)
    width, height = camera.size
    area = np.zeros((height, width), np.uint8)
    cv2.fillPoly(area, [np.rint(outline * 16).astype(np.int32)], (1,), shift=4)
    if margin_px:
        reach = 2 * abs(margin_px) + 1
        window = np.ones((reach, reach), np.uint8)
        away = cv2.erode(area, window, borderValue=(0,)) if margin_px > 0 else cv2.dilate(area, window)
        area = np.asarray(away, np.uint8)
    return np.asarray(area, np.bool_)


def subsample_pixels(area: Mask, count: int) -> PixelIndices:
    v, u = np.nonzero(area)
    stride = max(1, round(float(np.sqrt(len(u) / count))))
    chosen = (v % stride == 0) & (u % stride == 0)
    return v[chosen], u[chosen]


def level_weights(residual: Floats) -> tuple[Floats, float]:
    """Compute Huber's weights of residuals of grey levels, 1 up to three robust standard deviations."""
    sigma = robust_spread(residual, 0.29)  # at least that of rounding to whole levels, √(1/12)
    return huber_weights(residual, sigma, 3.0), sigma
