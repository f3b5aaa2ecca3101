"""Triangulation against OpenCV: both devices' points undistorted, then the linear triangulation."""

import time
from collections.abc import Callable
from statistics import median
from typing import TypeVar

import cv2
import numpy as np

from benchmarks import Result
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats, Map
from fpplab.core.errors import DataError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.phase import Decoded
from fpplab.reconstruction.points import triangulate
from fpplab.reconstruction.triangulation import camera_slopes, forget_cameras

T = TypeVar("T")

SIZE = (2736, 1824)
ROUNDS = 3
AGREEMENT_MM = 1e-3


def run() -> list[Result]:
    """Measure seconds for a two-axis decode of 5 Mpx, product and baseline in turn, medians.

    `triangulate_vs_cv2` gives points, pixels, sigma and epipolar distances with the camera's rays at hand,
    as after the first scan; `..._first` has to make them; `..._normals` adds normals.
    """
    calibration = _bench()
    maps, pixels, coordinates = _scene(calibration)
    triangulate(maps, calibration)  # compiles
    seconds: dict[str, list[float]] = {"": [], "_first": [], "_normals": [], "baseline": []}
    for _ in range(ROUNDS):
        cloud = _timed(seconds[""], lambda: triangulate(maps, calibration, normals=False))
        _timed(seconds["_normals"], lambda: triangulate(maps, calibration))
        forget_cameras()
        _timed(seconds["_first"], lambda: triangulate(maps, calibration, normals=False))
        baseline = _timed(seconds["baseline"], lambda: _opencv(calibration, pixels, coordinates))
        _agree(cloud, baseline)
    slow = median(seconds.pop("baseline"))
    return [
        Result(f"triangulate_vs_cv2{name}", median(times), "s", slow, slow / median(times))
        for name, times in seconds.items()
    ]


def _timed(seconds: list[float], work: Callable[[], T]) -> T:
    start = time.perf_counter()
    result = work()
    seconds.append(time.perf_counter() - start)
    return result


def _bench() -> Calibration:
    """A camera 450 mm above a field of 169 mm, the projector 150 mm beside it, both distorted."""
    focal = SIZE[0] / 169.0 * 450.0
    centre = (SIZE[0] / 2 - 3.0, SIZE[1] / 2 + 5.0)
    camera = Pinhole.from_focal(SIZE, (focal, focal), centre, (-0.12, 0.08, 0.001, -0.0007, 0.02))
    projector = Pinhole.from_focal(
        (912, 1140), (1700.0, 1700.0), (450.0, 600.0), (-0.08, 0.05, -0.001, 0.0009, 0.01)
    )
    turn = RigidTransform.from_vectors(np.array([0.01, -np.arctan2(150.0, 450.0), 0.005]), np.zeros(3))
    place = np.array([-150.0, 4.0, 6.0])
    return Calibration(camera, projector, RigidTransform(turn.rotation, -turn.rotation @ place), {})


def _scene(calibration: Calibration) -> tuple[Decoded, Floats, Floats]:
    """A waved surface: what decoding gives, and the same as pixels (N, 2) and coordinates (N, 2)."""
    a, b = camera_slopes(calibration.camera)
    z = 450.0 + 15.0 * np.sin(40.0 * a) * np.cos(30.0 * b) + 40.0 * a
    exact = calibration.projector.project(
        np.stack([a * z, b * z, z], axis=-1), calibration.T_projector_camera
    )
    seen: Map = exact.astype(np.float32)
    inside = ((seen >= -0.5) & (seen <= np.array(calibration.projector.size) - 0.5)).all(axis=-1)
    seen[~inside] = np.nan
    v, u = np.nonzero(inside)
    sigma = np.full(inside.shape, 0.02, np.float32)
    maps = Decoded(seen[..., 0].copy(), seen[..., 1].copy(), np.ones_like(sigma), sigma)
    return maps, np.stack([u, v], axis=1).astype(np.float64), seen[inside].astype(np.float64)


def _opencv(calibration: Calibration, pixels: Floats, coordinates: Floats) -> Floats:
    camera, projector = calibration.camera, calibration.projector
    left = cv2.undistortPoints(pixels[:, None], camera.matrix, camera.distortion)
    right = cv2.undistortPoints(coordinates[:, None], projector.matrix, projector.distortion)
    pose = calibration.T_projector_camera.matrix[:3]
    points = cv2.triangulatePoints(np.eye(3, 4), pose, left[:, 0].T, right[:, 0].T)
    return np.asarray((points[:3] / points[3]).T)


def _agree(cloud: Cloud, baseline: Floats) -> None:
    if len(cloud) != len(baseline):
        raise DataError(f"triangulate_vs_cv2: {len(cloud)} points instead of the baseline's {len(baseline)}")
    worst = float(np.abs(cloud.points - baseline).max())
    if not worst <= AGREEMENT_MM:
        raise DataError(
            f"triangulate_vs_cv2: differs from the baseline by {worst * 1e3:.2f} µm, more than 1 µm"
        )
