"""Initial values: each device calibrated separately by Zhang's method, then the pose between them.

Z. Zhang, "A flexible new technique for camera calibration", 2000, with k1 k2 p1 p2. RMS figures are per
point: the root of the mean squared distance in px.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from fpplab.calibration.model import INTRINSICS
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import ImageSize, Solution, vectors_of
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError, UndeterminedError
from fpplab.core.geometry import RigidTransform

BoardPixels = list[Floats]  # points of each pose, (K, 2) or (K, 3)


def calibrate_separately(
    observations: Sequence[Observation], board: Floats, camera_size: ImageSize, projector_size: ImageSize
) -> tuple[Solution, Floats, dict[str, float]]:
    """Calibrate each device by itself, and take the pose between them that agrees best with all poses."""
    # board (P, 3) mm; camera_size (width, height) px; projector_size (width, height) px; returns
    # projector_poses (M, 6)
    boards = [board[o.ids] for o in observations]
    camera_rms, camera, poses = calibrate_by_zhang(
        "camera", boards, [o.camera_px for o in observations], camera_size
    )
    projector_rms, projector, projector_poses = calibrate_by_zhang(
        "projector", boards, [o.projector_px for o in observations], projector_size
    )
    solutions = [
        Solution(camera, projector, vectors_of(transform(p) @ transform(c).inverse()), poses, board)
        for c, p in zip(poses, projector_poses, strict=True)
    ]
    agreed = min(solutions, key=lambda s: float(np.median(rms_of_poses(observations, s))))
    return agreed, projector_poses, {"camera": camera_rms, "projector": projector_rms}


def check_not_mirrored(poses: Floats, projector_poses: Floats) -> None:
    """Refuse boards that a device sees from behind: a mirrored flat board fits so, too."""
    # poses (M, 6); projector_poses (M, 6)
    behind = [
        np.mean([_from_behind(pose) for pose in device_poses]) > 0.5
        for device_poses in (poses, projector_poses)
    ]
    if all(behind):
        raise CalibrationError(
            "the board is mirrored: camera and projector see its points in the order they have from behind; "
            "check that the print is not reversed, and that the target file describes its front"
        )
    if any(behind):
        raise CalibrationError(
            "camera and projector see the board mirrored to each other; switch off mirroring "
            "in the camera's settings (reverse x or y), and flipping in the projector's"
        )


def _from_behind(pose: Floats) -> bool:
    away = transform(pose).rotation[:, 2]
    return bool(away @ pose[3:] < 0)


def calibrate_by_zhang(
    device: str, boards: BoardPixels, pixels: BoardPixels, size: ImageSize
) -> tuple[float, Floats, Floats]:
    """Calibrate a device by Zhang's method from several guesses of the principal point."""
    # A projector's lens is often shifted so far that its principal point lies at the image border, where a
    # start from the centre may end in a wrong minimum.
    # boards (K, 3) mm; pixels (K, 2) px; size (width, height) px; returns intrinsics (12,), poses (M, 6)
    # rad
    width, height = size
    places = ((0.5, 0.5), (0.5, 1.0), (0.5, 0.0), (1.0, 0.5), (0.0, 0.5))
    guesses = [(across * (width - 1), down * (height - 1)) for across, down in places]
    fits = [fit for guess in guesses if (fit := _zhang_from(guess, boards, pixels, size)) is not None]
    if not fits:
        raise UndeterminedError(
            f"the poses do not determine the {device}: they are parallel or nearly so; "
            "tilt the board by 20° or more, each time differently"
        )
    return min(fits, key=lambda fit: fit[0])


def _zhang_from(
    guess: tuple[float, float], boards: BoardPixels, pixels: BoardPixels, size: ImageSize
) -> tuple[float, Floats, Floats] | None:
    flat = [b.astype(np.float32) for b in boards]
    image_points = [p.astype(np.float32) for p in pixels]
    centre = 0.5 * (np.array(size) - 1)
    moved = [(p - guess + centre).astype(np.float32) for p in pixels]
    matrix: Any = np.asarray(cv2.initCameraMatrix2D(flat, moved, size, 0), np.float64)
    matrix[:2, 2] = guess
    focal = matrix[[0, 1], [0, 1]]
    if not np.all(np.isfinite(focal)) or focal.min() <= 0:
        # The closed form fails for a wrong guess or small tilts; Zhang's iteration often does not.
        matrix[[0, 1], [0, 1]] = 2.0 * max(size)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    try:
        rms, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            flat, image_points, size, matrix, np.zeros(5), flags=flags
        )
    except cv2.error:
        return None
    terms = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()]
    intrinsics = np.pad(terms, (0, len(INTRINSICS) - len(terms)))
    poses = np.hstack([np.array(turns).reshape(-1, 3), np.array(shifts).reshape(-1, 3)])
    sound = np.isfinite(rms) and np.all(np.isfinite(intrinsics)) and intrinsics[:2].min() > 0
    return (float(rms), intrinsics, poses) if sound and poses[:, 5].min() > 0 else None


def fit_pose_between_devices(
    observations: Sequence[Observation], start: Solution, size: ImageSize
) -> tuple[Floats, float]:
    # size (width, height) px; returns pair (6,) rad
    rms, *_, rotation, translation, _, _ = cv2.stereoCalibrate(
        [start.board[o.ids].astype(np.float32) for o in observations],
        [o.camera_px.astype(np.float32) for o in observations],
        [o.projector_px.astype(np.float32) for o in observations],
        matrix_of(start.camera),
        start.camera[4:],
        matrix_of(start.projector),
        start.projector[4:],
        size,
        flags=cv2.CALIB_FIX_INTRINSIC,
    )
    pair = RigidTransform(np.asarray(rotation, np.float64), np.asarray(translation, np.float64).ravel())
    return vectors_of(pair), float(rms)


def matrix_of(intrinsics: Floats) -> Floats:
    """Write the camera matrix of intrinsic parameters."""
    # returns (3, 3) px
    fx, fy, cx, cy = intrinsics[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def transform(vectors: Floats) -> RigidTransform:
    """Make a rigid transform of six numbers; inverse of `vectors_of`."""
    # vectors (6,) rad
    return RigidTransform.from_vectors(vectors[:3], vectors[3:])


def rms_of_poses(observations: Sequence[Observation], solution: Solution) -> Floats:
    # returns (M,) px
    return np.array([rms(solution.residuals(i, o)) for i, o in enumerate(observations)])


def rms(residuals: Sequence[Floats]) -> float:
    """Compute the root mean square length of residuals."""
    # residuals (K, 2)
    return float(np.sqrt(np.mean(np.sum(np.concatenate(list(residuals)) ** 2, axis=1))))
