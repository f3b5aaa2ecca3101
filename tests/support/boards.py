"""Pictures of boards as a perfect camera would take them, with the truth beside them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.targets import Target

SUPERSAMPLING = 4


def pose(tilt_deg: tuple[float, float, float], position_mm: tuple[float, float, float]) -> RigidTransform:
    return RigidTransform.from_vectors(np.radians(tilt_deg), np.array(position_mm))


def plane_homography(camera: Pinhole, T_camera_board: RigidTransform) -> Floats:
    """Board (x, y) in mm to pixels, (3, 3), of a camera without distortion."""
    r, t = T_camera_board.rotation, T_camera_board.translation
    return np.asarray(camera.matrix @ np.column_stack([r[:, 0], r[:, 1], t]))


def render(
    target: Target, board_to_pixel: Floats, size: tuple[int, int], blur_px: float = 0.7, ground: float = 0.3
) -> NDArray[np.float64]:
    """The board in grey levels of 255 [v, u], antialiased, on an even ground."""
    px_per_mm = 24.0
    texture = target.image(px_per_mm).astype(np.float32)
    height, width = texture.shape
    texture_to_board = np.array(
        [[1, 0, 0.5 - width / 2], [0, 1, 0.5 - height / 2], [0, 0, px_per_mm]]
    )  # homogeneous: the last row divides by the scale
    n = SUPERSAMPLING
    fine = np.array([[n, 0, (n - 1) / 2], [0, n, (n - 1) / 2], [0, 0, 1.0]])
    picture = cv2.warpPerspective(
        cv2.GaussianBlur(texture, (0, 0), 1.0),
        fine @ board_to_pixel @ texture_to_board,
        (n * size[0], n * size[1]),
        flags=cv2.INTER_LINEAR,
        borderValue=255 * ground,
    )
    picture = cv2.GaussianBlur(picture, (0, 0), n * blur_px)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float64)
