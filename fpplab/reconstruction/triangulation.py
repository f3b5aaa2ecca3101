"""Triangulation of projector coordinates on the camera's rays, with the distortion of both devices.

A camera pixel's ray X = z (a, b, 1) is known exactly from the camera's model. Its depth z is
where the point's image in the projector, distortion included, has the decoded coordinates:
the projector's surface u = const is curved, so the distorted projection itself is solved by
Gauss-Newton. One coded axis gives one equation; two give least squares along the ray, and
what remains is the distance from the epipolar curve. The cloud is in the camera's frame.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import replace
from typing import Protocol

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.clouds.pixelgrid import at_pixels
from fpplab.clouds.selection import select
from fpplab.core import buffers
from fpplab.core.conventions import Floats, Map, Mask
from fpplab.core.errors import DataError
from fpplab.core.geometry import INVERSION_STEPS, PIXEL_TOLERANCE, Pinhole, distort

DEPTH_TOLERANCE = 1e-5
"""Relative size of the last step in depth; each step squares the error, so the depth is good to 1e-10."""
ITERATIONS = 20
BLOCK = 16
"""Rows that one thread solves in sequence, each starting from the row above."""
LEAST_SENSITIVITY = 1e-3
"""Least change of the projector coordinates, in px per mm of depth, that determines the depth."""
FARTHEST_PX = 1e6
"""A coordinate beyond this, or an infinite one, is taken as not known."""
CACHED_CAMERAS = 2
"""Number of cameras whose ray slopes are kept in memory."""

_slopes: OrderedDict[tuple[object, ...], Floats] = OrderedDict()
_lock = threading.Lock()


class DecodedMaps(Protocol):
    """Projector coordinates of a camera's pixels: what triangulation reads of decoded maps."""

    @property
    def u(self) -> Map:
        """Projector coordinate u in px, float32 (height, width), NaN where unknown; all NaN if not coded."""

    @property
    def v(self) -> Map:
        """Projector coordinate v in px, float32 (height, width), NaN as for u."""

    @property
    def sigma(self) -> Map:
        """Standard deviation in px of u, or of v where only that is coded, float32 (height, width)."""

    @property
    def v_per_u(self) -> float:
        """Ratio of the standard deviation of v to that of u."""

    @property
    def sigma_phase_error(self) -> Map | None:
        """As `sigma`, by errors that are common to all pixels of one phase; None where not known."""


def triangulate(
    decoded: DecodedMaps,
    calibration: Calibration,
    texture: NDArray[np.uint8] | None = None,
    normals: bool = True,
) -> Cloud:
    """Intersect camera rays with the projector's coordinate surfaces.

    Where two axes are coded a pixel needs both, and each is weighted by its inverse variance. Left out are
    points behind a device, outside the projector's image or where its distortion folds back, and pixels
    without a solution.
    """
    # decoded (height, width) px; texture (height, width); returns (N, 3) mm
    height, width = decoded.u.shape
    calibration.check_camera((width, height), "decoded maps")
    if texture is not None and texture.shape != (height, width):
        raise DataError(
            f"texture: {texture.shape[1]} x {texture.shape[0]} pixels, but the maps have {width} x {height}; "
            "take it from the same session"
        )
    use_u, use_v = any_known(decoded.u), any_known(decoded.v)
    if not (use_u or use_v):
        raise DataError("decoded maps: no pixel has a projector coordinate; look at exposure and modulation")
    slopes = camera_slopes(calibration.camera)
    unknown, phase_error = np.empty((0, width), np.float32), decoded.sigma_phase_error
    u, v = decoded.u if use_u else unknown, decoded.v if use_v else unknown
    error = unknown if phase_error is None else phase_error
    u, v, sigma, error = (np.ascontiguousarray(m, np.float32) for m in (u, v, decoded.sigma, error))
    counts = _count(u if use_u else v, v if use_v else u)
    total = int(counts.sum())
    points, pixels = buffers.empty((total, 3)), buffers.empty((total, 2), np.int32)
    sigma_mm = buffers.empty(total)
    error_mm = buffers.empty(0 if phase_error is None else total)
    epipolar = buffers.empty(total if use_u and use_v else 0)
    projector, pose = calibration.projector, calibration.T_projector_camera.matrix[:3].ravel()
    _solve(
        slopes,
        u,
        v,
        sigma,
        error,
        use_u,
        use_v,
        float(decoded.v_per_u),
        _intrinsics(projector),
        tuple(pose.tolist()),
        projector.size,
        projector.reach,
        np.cumsum(counts) - counts,
        points,
        pixels,
        sigma_mm,
        error_mm,
        epipolar,
    )
    solved = _are_solved(points)
    if not solved.any():
        raise DataError(
            "decoded maps: no pixel triangulates; check that the calibration is of this rig and that the "
            "fringes run across the baseline"
        )
    if not solved.all():
        outputs = points, pixels, sigma_mm, error_mm, epipolar
        points, pixels, sigma_mm, error_mm, epipolar = (
            select([values], solved)[0] if len(values) else values for values in outputs
        )
    cloud = Cloud(
        points=points,
        pixels=pixels,
        size=(width, height),
        colour=None if texture is None else at_pixels(np.asarray(texture, np.uint8), pixels),
        sigma_noise_mm=sigma_mm,
        epipolar_px=epipolar if use_u and use_v else None,
        sigma_phase_error_mm=None if phase_error is None else error_mm,
    )
    return replace(cloud, normals=cloud.grid().normals()) if normals else cloud


def camera_slopes(camera: Pinhole) -> Floats:
    """Compute the ray slopes of every pixel's centre.

    The inverse of the distortion to `PIXEL_TOLERANCE`; the last `CACHED_CAMERAS` results are cached.
    """
    # returns (2, height, width)
    key = (camera.size, camera.matrix.tobytes(), camera.distortion.tobytes())
    with _lock:
        if key not in _slopes:
            slopes = np.empty((2, camera.size[1], camera.size[0]))
            _invert(_intrinsics(camera), camera.reach, slopes)
            slopes.flags.writeable = False
            _slopes[key] = slopes
        _slopes.move_to_end(key)
        while len(_slopes) > CACHED_CAMERAS:
            _slopes.popitem(last=False)
        return _slopes[key]


def camera_rays(camera: Pinhole) -> Floats:
    """Compute the rays of every pixel's centre, by `camera_slopes`."""
    # returns (height, width, 3)
    slopes = camera_slopes(camera)
    return np.stack([*slopes, np.ones(slopes.shape[1:])], axis=-1)


def forget_cameras() -> None:
    """Clear the cache of `camera_slopes`."""
    with _lock:
        _slopes.clear()


Numbers = tuple[float, ...]
"""Parameters of a compiled kernel; as a tuple they stay in registers, an array might alias its output."""


def _intrinsics(device: Pinhole) -> Numbers:
    """Return (fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6)."""
    k = device.matrix
    return tuple(map(float, (k[0, 0], k[1, 1], k[0, 2], k[1, 2], *device.distortion)))


_distort = njit(inline="always")(distort)


@njit(cache=True, error_model="numpy")
def _straighten(u: float, v: float, device: Numbers, reach: float) -> tuple[float, float]:
    """Undistort one pixel as `Pinhole.normalise` does."""
    fx, fy, lens = device[0], device[1], device[4:]
    target_x, target_y = (u - device[2]) / fx, (v - device[3]) / fy
    x, y, last = target_x, target_y, 0.0
    for _ in range(INVERSION_STEPS):
        square = x * x + y * y
        if square >= reach * reach:
            length = 0.5 * (np.sqrt(last) + reach)
            x, y = x * length / np.sqrt(square), y * length / np.sqrt(square)
            square = length * length
        last = square
        xd, yd, xx, xy, yy = _distort(x, y, lens)
        determinant = xx * yy - xy * xy
        ex, ey = target_x - xd, target_y - yd
        if abs(ex) * fx < PIXEL_TOLERANCE and abs(ey) * fy < PIXEL_TOLERANCE and determinant > 0.0:
            return x, y
        x += (yy * ex - xy * ey) / determinant
        y += (xx * ey - xy * ex) / determinant
    return np.nan, np.nan


@njit(parallel=True, cache=True, error_model="numpy")
def _invert(camera: Numbers, reach: float, slopes: Floats) -> None:
    for v in prange(slopes.shape[1]):
        for u in range(slopes.shape[2]):
            slopes[0, v, u], slopes[1, v, u] = _straighten(u, v, camera, reach)


@njit(cache=True)
def any_known(values: Map) -> bool:
    """Tell whether a map has any value."""
    # values (height, width)
    if (
        values.strides[0] == 0 and values.strides[1] == 0
    ):  # one value for all, as of an axis that is not coded
        return bool(np.isfinite(values[0, 0]))
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            if np.isfinite(values[row, column]):
                return True
    return False


@njit(parallel=True, cache=True)
def _are_solved(points: Map) -> Mask:
    solved = np.empty(len(points), np.bool_)
    for i in prange(len(points)):
        solved[i] = np.isfinite(points[i, 2])
    return solved


@njit(inline="always")
def _coded(u: float, v: float) -> bool:
    """Tell whether a pixel has both coordinates; by comparisons, which fast-math keeps."""
    return bool(abs(u) < FARTHEST_PX and abs(v) < FARTHEST_PX)


@njit(parallel=True, cache=True)
def _count(u: Map, v: Map) -> NDArray[np.int64]:
    """Count the pixels of each row with both coordinates."""
    counts = np.zeros(len(u), np.int64)
    for row in prange(len(u)):
        found = 0
        for column in range(u.shape[1]):
            found += _coded(u[row, column], v[row, column])
        counts[row] = found
    return counts


# Contracting to multiply-adds changes the last bits only, and NaN keeps its meaning.
@njit(parallel=True, cache=True, error_model="numpy", fastmath={"contract"})
def _solve(
    slopes: Floats,
    coded_u: Map,
    coded_v: Map,
    sigma: Map,
    phase_error: Map,
    use_u: bool,
    use_v: bool,
    v_per_u: float,
    projector: Numbers,
    pose: Numbers,
    size: tuple[int, int],
    reach: float,
    starts: NDArray[np.int64],
    points: Map,
    pixels: NDArray[np.int32],
    spread: Map,
    common_spread: Map,
    epipolar: Map,
) -> None:
    """Fill points, pixels, both sigmas along the ray in mm and epipolar distance in px, row by row.

    A pixel with coordinates but without a solution has NaN for its point.
    """
    height, width = sigma.shape
    fx, fy, cx, cy = projector[0], projector[1], projector[2], projector[3]
    lens, reach_squared = projector[4:], reach * reach
    per_fx, per_fy = 1.0 / fx, 1.0 / fy
    xa, xb, xc, tx, ya, yb, yc, ty, za, zb, zc, tz = pose
    wu, wv = (1.0 if use_u else 0.0), ((1.0 / v_per_u if use_u else 1.0) if use_v else 0.0)
    for block in prange((height + BLOCK - 1) // BLOCK):
        # The distortion of the pixel above is an initial value that needs only one step.
        shift_x, shift_y = np.full(width, np.nan), np.full(width, np.nan)
        for row in range(block * BLOCK, min((block + 1) * BLOCK, height)):
            at = starts[row] - 1
            for column in range(width):
                u = float(coded_u[row, column]) if use_u else cx
                v = float(coded_v[row, column]) if use_v else cy
                if not _coded(u, v):
                    continue
                at += 1
                points[at, 0] = points[at, 1] = points[at, 2] = np.nan
                a, b = slopes[0, row, column], slopes[1, row, column]
                dx, dy, dz = xa * a + xb * b + xc, ya * a + yb * b + yc, za * a + zb * b + zc
                # With the distortion taken as known the equations are linear in z.
                x, y = (u - cx) * per_fx - shift_x[column], (v - cy) * per_fy - shift_y[column]
                if np.isnan(x):
                    x, y = _straighten(u, v, projector, reach)
                mx, my = wu * (x * dz - dx), wv * (y * dz - dy)
                z = (mx * (tx - x * tz) + my * (ty - y * tz)) / (mx * mx + my * my + 1e-300)
                for _ in range(ITERATIONS):
                    pz = z * dz + tz
                    if not (z > 0.0 and pz > 0.0):
                        break
                    near = 1.0 / pz
                    x, y = (z * dx + tx) * near, (z * dy + ty) * near
                    xd, yd, xx, xy, yy = _distort(x, y, lens)
                    x_z, y_z = (dx - x * dz) * near, (dy - y * dz) * near
                    ju, jv = wu * fx * (xx * x_z + xy * y_z), wv * fy * (xy * x_z + yy * y_z)
                    pu, pv = fx * xd + cx, fy * yd + cy
                    eu, ev = wu * (u - pu), wv * (v - pv)
                    square = ju * ju + jv * jv
                    if square < LEAST_SENSITIVITY * LEAST_SENSITIVITY:
                        break
                    per_square = 1.0 / square
                    step = (ju * eu + jv * ev) * per_square
                    z += step
                    if abs(step) <= DEPTH_TOLERANCE * z:
                        shift_x[column], shift_y[column] = xd - x, yd - y
                        inside = -0.5 <= pu <= size[0] - 0.5 and -0.5 <= pv <= size[1] - 0.5
                        if inside and x * x + y * y < reach_squared:
                            points[at, 0], points[at, 1], points[at, 2] = z * a, z * b, z
                            pixels[at, 0], pixels[at, 1] = column, row
                            mm_per_px = np.sqrt((1.0 + a * a + b * b) * per_square)
                            spread[at] = sigma[row, column] * mm_per_px
                            if len(common_spread) > 0:
                                share = phase_error[row, column] / sigma[row, column]
                                common_spread[at] = spread[at] * share
                            if use_u and use_v:
                                iu, iv = ju, jv * v_per_u
                                across = abs(iu * (v - pv) - iv * (u - pu))
                                epipolar[at] = across / np.sqrt(iu * iu + iv * iv)
                        break
