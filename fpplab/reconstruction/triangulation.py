"""Triangulation of projector coordinates on the camera's rays, with the distortion of both devices.

The depth on a ray X = z (a, b, 1) is where the point's image in the projector, distortion included, has the
decoded coordinates, by Gauss-Newton. With two coded axes the rest is the distance from the epipolar curve.
"""

import threading
from collections import OrderedDict
from typing import NamedTuple, TypeVar

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.calibration.displacements import CoordinateNoise
from fpplab.calibration.model import Calibration
from fpplab.clouds.selection import select_rows
from fpplab.core import buffers
from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Axis, Floats, Map, Mask
from fpplab.core.errors import DataError
from fpplab.core.geometry import INVERSION_STEPS, PIXEL_TOLERANCE, Pinhole, distort
from fpplab.phase import Decoded
from fpplab.reconstruction.limits import RECONSTRUCTION_LIMITS as LIMITS

T = TypeVar("T", bound=np.generic)

Numbers = tuple[float, ...]
"""Parameters of a compiled kernel; as a tuple they stay in registers, an array might alias its output."""

_slopes: OrderedDict[tuple[object, ...], Floats] = OrderedDict()
_lock = threading.Lock()

_UNKNOWN = np.empty((0, 0), np.float32)


class CodedMaps(NamedTuple):
    """What is known of every pixel, (height, width); maps without rows are not known."""

    u: Map  # px
    v: Map  # px
    sigma: Map  # px
    phase_error: Map  # px
    texture: NDArray[np.uint8]  # grey levels
    v_per_u: float  # ratio of the standard deviation of v to that of u


Ray = tuple[float, float, float, float, float, float]
"""In the projector's frame: direction of a camera ray, for a depth of 1, and the camera's place in mm."""

RaySolution = tuple[float, float, float, float, float]
"""Depth in mm, sensitivity squared in (px/mm)², distance from the epipolar curve in px; distortion."""

# Rows of the buffer of a stretch of pixels, which do not lie multiples of a memory page apart.
_ROW = LIMITS.stretch_px + 48
_SHIFT_X, _SHIFT_Y, _DEPTH, _SQUARE, _EPIPOLAR = (np.uintp(k * _ROW) for k in range(5))

CoordinateResiduals = tuple[float, float, float, float, float, float, float, float, float, float]
"""CoordinateResiduals u, v; derivatives u, v; coordinates u, v; slopes x, y, and the same distorted."""


class ProjectorModel(NamedTuple):
    """The projector as the kernel takes it."""

    intrinsics: Numbers  # see `Pinhole.intrinsics`
    pose: Numbers  # T_projector_camera, row by row
    size: tuple[int, int]  # px
    reach: float  # slope up to which its distortion can be inverted


class Solutions(NamedTuple):
    """Points of the N pixels with coordinates, row by row; empty arrays are left out."""

    points: Map  # (N, 3) mm, NaN without a solution
    pixels: NDArray[np.int32]  # (N, 2)
    sigma: Map  # (N,) mm along the ray, by noise
    phase_error: Map  # (N,) mm along the ray, by errors that all pixels of one phase share
    epipolar: Map  # (N,) px
    colour: NDArray[np.uint8]  # (N,)


def coded_maps(decoded: Decoded, texture: NDArray[np.uint8] | None = None) -> CodedMaps:
    # texture (height, width)
    use_u, use_v = any_known(decoded.u), any_known(decoded.v)
    if not (use_u or use_v):
        raise DataError("decoded maps: no pixel has a projector coordinate; look at exposure and modulation")
    phase_error = _UNKNOWN if decoded.sigma_phase_error is None else decoded.sigma_phase_error
    return CodedMaps(
        u=np.ascontiguousarray(decoded.u if use_u else _UNKNOWN, np.float32),
        v=np.ascontiguousarray(decoded.v if use_v else _UNKNOWN, np.float32),
        sigma=np.ascontiguousarray(decoded.sigma, np.float32),
        phase_error=np.ascontiguousarray(phase_error, np.float32),
        texture=np.ascontiguousarray(_UNKNOWN if texture is None else texture, np.uint8),
        v_per_u=float(decoded.v_per_u),
    )


def coordinate_noise(decoded: Decoded) -> CoordinateNoise:
    if not any_known(decoded.u):
        return np.inf, 1.0
    return 1.0, decoded.v_per_u if any_known(decoded.v) else np.inf


def solve_pixels(coded: CodedMaps, calibration: Calibration) -> Solutions:
    use_u, use_v = len(coded.u) > 0, len(coded.v) > 0
    use_phase_error, use_texture = len(coded.phase_error) > 0, len(coded.texture) > 0
    counts = _coded_pixels_by_row(coded.u if use_u else coded.v, coded.v if use_v else coded.u)
    total = int(counts.sum())
    solutions = Solutions(
        points=buffers.empty((total, 3)),
        pixels=buffers.empty((total, 2), np.int32),
        sigma=buffers.empty(total),
        phase_error=buffers.empty(total if use_phase_error else 0),
        epipolar=buffers.empty(total if use_u and use_v else 0),
        colour=buffers.empty(total if use_texture else 0, np.uint8),
    )
    model = _model_of(calibration)
    _fill_solutions(camera_slopes(calibration.camera), coded, model, np.cumsum(counts) - counts, solutions)
    solved = _are_solved(solutions.points)
    if not solved.any():
        raise DataError(
            "decoded maps: no pixel triangulates; check that the calibration is of this rig and that the "
            "fringes run across the baseline"
        )
    if solved.all():
        return solutions
    return Solutions._make(_kept(values, solved) for values in solutions)


def predict_coordinate(known: Map, axis: Axis, calibration: Calibration) -> Map:
    """Predict the projector coordinate along an axis from the one along the other, without noise's part."""
    # known (height, width) px, NaN where unknown; returns (height, width) px
    other = np.empty(known.shape, np.float32)
    slopes, model = camera_slopes(calibration.camera), _model_of(calibration)
    _fill_predictions(slopes, np.ascontiguousarray(known, np.float32), axis == "y", model, other)
    return other


def _model_of(calibration: Calibration) -> ProjectorModel:
    projector = calibration.projector
    return ProjectorModel(
        intrinsics=tuple(projector.intrinsics.tolist()),
        pose=tuple(calibration.T_projector_camera.matrix[:3].ravel().tolist()),
        size=projector.size,
        reach=projector.reach,
    )


def _kept(values: NDArray[T], solved: Mask) -> NDArray[T]:
    return select_rows([values], solved)[0] if len(values) else values


def camera_slopes(camera: Pinhole) -> Floats:
    # The inverse of the distortion to `PIXEL_TOLERANCE`; the last results are cached.
    # returns (2, height, width)
    key = (camera.size, camera.matrix.tobytes(), camera.distortion.tobytes())
    with _lock:
        if key not in _slopes:
            slopes = np.empty((2, camera.size[1], camera.size[0]))
            _invert(tuple(camera.intrinsics.tolist()), camera.reach, slopes)
            slopes.flags.writeable = False
            _slopes[key] = slopes
        _slopes.move_to_end(key)
        while len(_slopes) > LIMITS.cached_cameras:
            _slopes.popitem(last=False)
        return _slopes[key]


def camera_rays(camera: Pinhole) -> Floats:
    # returns (height, width, 3)
    slopes = camera_slopes(camera)
    return np.stack([*slopes, np.ones(slopes.shape[1:])], axis=-1)


def forget_cameras() -> None:
    with _lock:
        _slopes.clear()


_distort = njit(inline="always")(distort)


@kernel_part(error_model="numpy")
def _undistort_pixel(u: float, v: float, device: Numbers, reach: float) -> tuple[float, float]:
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


@kernel(parallel=True, error_model="numpy", fastmath={"contract"})
def _invert(camera: Numbers, reach: float, slopes: Floats) -> None:
    _, height, width = slopes.shape
    for block in prange((height + LIMITS.block_rows - 1) // LIMITS.block_rows):
        first = block * LIMITS.block_rows
        for v in range(first, min(first + LIMITS.block_rows, height)):
            x, y = slopes[0, v], slopes[1, v]
            x[:] = np.nan
            if v > first:
                _invert_from_above(v, slopes[0, v - 1], slopes[1, v - 1], camera, reach, x, y)
            for u in range(width):
                if np.isnan(x[u]):
                    x[u], y[u] = _undistort_pixel(u, v, camera, reach)


@kernel(error_model="numpy", fastmath={"contract"})
def _invert_from_above(
    v: int, above_x: Floats, above_y: Floats, camera: Numbers, reach: float, x: Floats, y: Floats
) -> None:
    """Undistort a row by two steps from the row above, without branches; NaN where it does not suffice."""
    fx, fy, cx, lens = camera[0], camera[1], camera[2], camera[4:]
    per_fx, per_fy, target_y = 1.0 / fx, 1.0 / fy, (v - camera[3]) / fy
    for j in range(len(x)):
        i = np.uintp(j)
        target_x, a, b = (j - cx) * per_fx, above_x[i], above_y[i] + per_fy
        for _ in range(2):
            xd, yd, xx, xy, yy = _distort(a, b, lens)
            ex, ey, per_determinant = target_x - xd, target_y - yd, 1.0 / (xx * yy - xy * xy)
            a += (yy * ex - xy * ey) * per_determinant
            b += (xx * ey - xy * ex) * per_determinant
        xd, yd, xx, xy, yy = _distort(a, b, lens)
        good = (abs(target_x - xd) * fx < PIXEL_TOLERANCE) & (abs(target_y - yd) * fy < PIXEL_TOLERANCE)
        good &= (xx * yy > xy * xy) & (a * a + b * b < reach * reach)
        x[i], y[i] = a if good else np.nan, b


@kernel()
def any_known(values: Map) -> bool:
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


@kernel(parallel=True)
def _are_solved(points: Map) -> Mask:
    solved = np.empty(len(points), np.bool_)
    for i in prange(len(points)):
        solved[i] = np.isfinite(points[i, 2])
    return solved


@njit(inline="always")
def _is_coded(u: float, v: float) -> bool:
    """Return whether a pixel has both coordinates; by comparisons, which fast-math keeps."""
    return bool(abs(u) < LIMITS.max_coordinate_px and abs(v) < LIMITS.max_coordinate_px)


@kernel(parallel=True)
def _coded_pixels_by_row(u: Map, v: Map) -> NDArray[np.int64]:
    counts = np.zeros(len(u), np.int64)
    for row in prange(len(u)):
        count = 0
        for column in range(u.shape[1]):
            count += _is_coded(u[row, column], v[row, column])
        counts[row] = count
    return counts


@njit(inline="always")
def _weights(use_u: bool, use_v: bool, v_per_u: float) -> tuple[float, float]:
    return (1.0 if use_u else 0.0), ((1.0 / v_per_u if use_u else 1.0) if use_v else 0.0)


@njit(inline="always")
def _in_projector(a: float, b: float, pose: Numbers) -> Ray:
    xa, xb, xc, tx, ya, yb, yc, ty, za, zb, zc, tz = pose
    return xa * a + xb * b + xc, ya * a + yb * b + yc, za * a + zb * b + zc, tx, ty, tz


@njit(inline="always")
def _linear_depth(x: float, y: float, ray: Ray, weights: tuple[float, float]) -> float:
    """Depth of the point whose image in an undistorted projector has the slopes x, y."""
    dx, dy, dz, tx, ty, tz = ray
    mx, my = weights[0] * (x * dz - dx), weights[1] * (y * dz - dy)
    return (mx * (tx - x * tz) + my * (ty - y * tz)) / (mx * mx + my * my + 1e-300)


@njit(inline="always")
def _residuals(
    z: float, ray: Ray, u: float, v: float, weights: tuple[float, float], projector: Numbers
) -> CoordinateResiduals:
    """Weighted residuals of both coordinates at a depth, their derivatives by it, and the image there."""
    dx, dy, dz, tx, ty, tz = ray
    fx, fy, cx, cy = projector[0], projector[1], projector[2], projector[3]
    near = 1.0 / (z * dz + tz)
    x, y = (z * dx + tx) * near, (z * dy + ty) * near
    xd, yd, xx, xy, yy = _distort(x, y, projector[4:])
    x_z, y_z = (dx - x * dz) * near, (dy - y * dz) * near
    ju, jv = weights[0] * fx * (xx * x_z + xy * y_z), weights[1] * fy * (xy * x_z + yy * y_z)
    pu, pv = fx * xd + cx, fy * yd + cy
    eu, ev = weights[0] * (u - pu), weights[1] * (v - pv)
    return eu, ev, ju, jv, pu, pv, x, y, xd, yd


@njit(inline="always")
def _is_in_image(u: float, v: float, size: tuple[int, int]) -> bool:
    return bool(-0.5 <= u <= size[0] - 0.5 and -0.5 <= v <= size[1] - 0.5)


@njit(inline="always")
def _epipolar_distance_px(
    off_u: float, off_v: float, ju: float, jv: float, weights: tuple[float, float]
) -> float:
    """Distance of the coordinates from the epipolar curve, which has the direction of the sensitivities."""
    along_u, along_v = ju * weights[1], jv * weights[0]  # which are weighted
    across = abs(along_u * off_v - along_v * off_u)
    return float(across / np.sqrt(along_u * along_u + along_v * along_v))


# Contracting to multiply-adds changes the last bits only, and NaN keeps its meaning.
@kernel(error_model="numpy", fastmath={"contract"})
def _solve_pixel(
    ray: Ray,
    u: float,
    v: float,
    shift: tuple[float, float],
    weights: tuple[float, float],
    device: Numbers,
    size: tuple[int, int],
    reach: float,
) -> RaySolution:
    """Solve a pixel by as many steps as it takes."""
    # With the distortion taken as known the equations are linear in z.
    x, y = (u - device[2]) / device[0] - shift[0], (v - device[3]) / device[1] - shift[1]
    if np.isnan(x):
        x, y = _undistort_pixel(u, v, device, reach)
    z = _linear_depth(x, y, ray, weights)
    for _ in range(LIMITS.max_steps):
        if not (z > 0.0 and z * ray[2] + ray[5] > 0.0):
            break
        eu, ev, ju, jv, pu, pv, x, y, xd, yd = _residuals(z, ray, u, v, weights, device)
        square = ju * ju + jv * jv
        if square < LIMITS.min_sensitivity_px_per_mm * LIMITS.min_sensitivity_px_per_mm:
            break
        step = (ju * eu + jv * ev) / square
        z += step
        if abs(step) <= LIMITS.depth_tolerance * z:
            inside = _is_in_image(pu, pv, size) and x * x + y * y < reach * reach
            off_px = _epipolar_distance_px(u - pu, v - pv, ju, jv, weights)
            return z if inside else np.nan, square, off_px, xd - x, yd - y
    return np.nan, np.nan, np.nan, shift[0], shift[1]


@kernel(error_model="numpy", fastmath={"contract"})
def _solve_stretch(
    across: Floats,
    down: Floats,
    known_u: Map,
    known_v: Map,
    weights: tuple[float, float],
    device: Numbers,
    pose: Numbers,
    size: tuple[int, int],
    reach: float,
    work: Floats,
) -> None:
    """Solve neighbouring pixels by one step each, without branches; NaN where it does not suffice."""
    cx, cy, per_fx, per_fy = device[2], device[3], 1.0 / device[0], 1.0 / device[1]
    for j in range(len(across)):
        i = np.uintp(j)
        u, v, ray = float(known_u[i]), float(known_v[i]), _in_projector(across[i], down[i], pose)
        old_x, old_y = work[i + _SHIFT_X], work[i + _SHIFT_Y]
        z = _linear_depth((u - cx) * per_fx - old_x, (v - cy) * per_fy - old_y, ray, weights)
        good = (z > 0.0) & (z * ray[2] + ray[5] > 0.0)
        eu, ev, ju, jv, pu, pv, x, y, xd, yd = _residuals(z, ray, u, v, weights, device)
        square = ju * ju + jv * jv
        step = (ju * eu + jv * ev) / square
        z += step
        good &= square >= LIMITS.min_sensitivity_px_per_mm * LIMITS.min_sensitivity_px_per_mm
        good &= (abs(step) <= LIMITS.depth_tolerance * z) & (x * x + y * y < reach * reach)
        good &= (pu >= -0.5) & (pu <= size[0] - 0.5) & (pv >= -0.5) & (pv <= size[1] - 0.5)
        work[i + _DEPTH], work[i + _SQUARE] = z if good else np.nan, square
        work[i + _EPIPOLAR] = _epipolar_distance_px(u - pu, v - pv, ju, jv, weights)
        work[i + _SHIFT_X], work[i + _SHIFT_Y] = xd - x if good else old_x, yd - y if good else old_y


@njit(inline="always")
def _count_coded(u: Map, v: Map) -> int:
    count = 0
    for i in range(len(u)):
        count += _is_coded(u[i], v[i])
    return count


@kernel(parallel=True, error_model="numpy", fastmath={"contract"})
def _fill_solutions(
    slopes: Floats, coded: CodedMaps, projector: ProjectorModel, starts: NDArray[np.int64], out: Solutions
) -> None:
    (height, width), reach = coded.sigma.shape, projector.reach
    use_u, use_v = len(coded.u) > 0, len(coded.v) > 0
    # In a parallel loop tuples cannot hold tuples, and what they hold cannot be written.
    points, pixels, epipolar, colour = out.points, out.pixels, out.epipolar, out.colour
    spread, common_spread = out.sigma, out.phase_error
    device, pose, size = projector.intrinsics, projector.pose, projector.size
    weights = _weights(use_u, use_v, coded.v_per_u)
    middle_u, middle_v = np.full(width, np.float32(device[2])), np.full(width, np.float32(device[3]))
    for block in prange((height + LIMITS.block_rows - 1) // LIMITS.block_rows):
        first, work = block * LIMITS.block_rows, np.empty(5 * _ROW)
        rows = min(LIMITS.block_rows, height - first)
        ends = starts[first : first + rows].copy()
        for begin in range(0, width, LIMITS.stretch_px):
            end = min(begin + LIMITS.stretch_px, width)
            # The distortion of the pixel above is an initial value that needs only one step.
            work[:] = np.nan
            for row in range(first, first + rows):
                known_u = coded.u[row, begin:end] if use_u else middle_u[begin:end]
                known_v = coded.v[row, begin:end] if use_v else middle_v[begin:end]
                count = _count_coded(known_u, known_v)
                if count == 0:
                    continue
                across, down = slopes[0, row, begin:end], slopes[1, row, begin:end]
                if count < LIMITS.min_coded_share * (end - begin):
                    work[_DEPTH : _DEPTH + _ROW] = np.nan
                else:
                    _solve_stretch(across, down, known_u, known_v, weights, device, pose, size, reach, work)
                at = ends[row - first]
                for j in range(end - begin):
                    u, v, i, column = float(known_u[j]), float(known_v[j]), np.uintp(j), begin + j
                    if not _is_coded(u, v):
                        continue
                    a, b = across[j], down[j]
                    z, square, off_px = work[i + _DEPTH], work[i + _SQUARE], work[i + _EPIPOLAR]
                    if np.isnan(z):
                        ray, shift = _in_projector(a, b, pose), (work[i + _SHIFT_X], work[i + _SHIFT_Y])
                        z, square, off_px, work[i + _SHIFT_X], work[i + _SHIFT_Y] = _solve_pixel(
                            ray, u, v, shift, weights, device, size, reach
                        )
                    points[at, 0], points[at, 1], points[at, 2] = z * a, z * b, z
                    pixels[at, 0], pixels[at, 1] = column, row
                    spread[at] = coded.sigma[row, column] * np.sqrt((1.0 + a * a + b * b) / square)
                    if len(common_spread) > 0:
                        share = coded.phase_error[row, column] / coded.sigma[row, column]
                        common_spread[at] = spread[at] * share
                    if len(colour) > 0:
                        colour[at] = coded.texture[row, column]
                    if use_u and use_v:
                        epipolar[at] = off_px
                    at += 1
                ends[row - first] = at


@kernel(parallel=True, error_model="numpy", fastmath={"contract"})
def _fill_predictions(
    slopes: Floats, known: Map, gives_v: bool, projector: ProjectorModel, other: Map
) -> None:
    device, pose, reach = projector.intrinsics, projector.pose, projector.reach
    weights = (1.0, 0.0) if gives_v else (0.0, 1.0)
    for row in prange(len(known)):
        for column in range(known.shape[1]):
            other[row, column] = np.nan
            value = float(known[row, column])
            if not abs(value) < LIMITS.max_coordinate_px:
                continue
            u, v = (value, device[3]) if gives_v else (device[2], value)
            ray = _in_projector(slopes[0, row, column], slopes[1, row, column], pose)
            x, y = _undistort_pixel(u, v, device, reach)
            z = _linear_depth(x, y, ray, weights)
            for _ in range(LIMITS.max_steps):
                if not (z > 0.0 and z * ray[2] + ray[5] > 0.0):
                    break
                eu, ev, ju, jv, pu, pv, x, y, _, _ = _residuals(z, ray, u, v, weights, device)
                square = ju * ju + jv * jv
                if square < LIMITS.min_sensitivity_px_per_mm * LIMITS.min_sensitivity_px_per_mm:
                    break
                step = (ju * eu + jv * ev) * (1.0 / square)
                z += step
                if abs(step) <= LIMITS.depth_tolerance * z:
                    if x * x + y * y < reach * reach:
                        other[row, column] = pv if gives_v else pu
                    break
