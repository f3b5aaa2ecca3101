"""Rays of the camera shader `sim/blender/camera.osl`, in double precision."""

import numba
import numpy as np

from fpplab.core.compiled import kernel_part
from fpplab.core.conventions import Floats
from fpplab.core.geometry import distort

distorted = numba.njit(inline="always")(distort)  # `distort`, to be compiled into a caller's loop


@kernel_part(error_model="numpy")
def undistort_ray(xd: float, yd: float, lens: Floats, reach: float) -> tuple[float, float]:
    """Undistort a ray by Newton's method; a step beyond the distortion model's reach is halved."""
    # lens (8,)
    x, y, x0, y0 = xd, yd, 0.0, 0.0
    for _ in range(20):
        if x * x + y * y >= reach * reach:
            x, y = 0.5 * (x + x0), 0.5 * (y + y0)
            continue
        x0, y0 = x, y
        bent_x, bent_y, xx, xy, yy = distorted(x, y, lens)
        off_x, off_y = xd - bent_x, yd - bent_y
        determinant = xx * yy - xy * xy
        step_x, step_y = (yy * off_x - xy * off_y) / determinant, (xx * off_y - xy * off_x) / determinant
        x, y = x + step_x, y + step_y
        if step_x * step_x + step_y * step_y < 1e-20:  # squared slopes, far below what a pixel resolves
            break
    return x, y


@kernel_part(error_model="numpy")
def slopes_at(u: float, v: float, matrix: Floats, lens: Floats, reach: float) -> tuple[float, float]:
    # matrix (3, 3)
    return undistort_ray((u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1], lens, reach)


@kernel_part()
def _rotated(x: np.uint32, bits: int) -> np.uint32:
    return np.uint32((x << np.uint32(bits)) | (x >> np.uint32(32 - bits)))


@kernel_part()
def cell_noise(column: int, row: int) -> float:
    """Reproduce `cellnoise` of Open Shading Language at whole numbers."""
    a = b = c = np.uint32((0xDEADBEEF + (2 << 2) + 13) & 0xFFFFFFFF)
    b = np.uint32(b + np.uint32(row & 0xFFFFFFFF))
    a = np.uint32(a + np.uint32(column & 0xFFFFFFFF))
    c = np.uint32((c ^ b) - _rotated(b, 14))
    a = np.uint32((a ^ c) - _rotated(c, 11))
    b = np.uint32((b ^ a) - _rotated(a, 25))
    c = np.uint32((c ^ b) - _rotated(b, 16))
    a = np.uint32((a ^ c) - _rotated(c, 4))
    b = np.uint32((b ^ a) - _rotated(a, 14))
    c = np.uint32((c ^ b) - _rotated(b, 24))
    return float(np.float32(c) * np.float32(1.0 / 4294967295.0))


@numba.njit(cache=True, inline="always")
def lens_turn(column: int, row: int, height: int) -> tuple[float, float]:
    """Compute by how much the points of the lens are turned in a pixel."""
    turn = 2 * np.pi * cell_noise(column, height - 1 - row)
    return np.sin(turn), np.cos(turn)


@numba.njit(cache=True, inline="always")
def on_lens(radius: float, x: float, y: float, sine: float, cosine: float) -> tuple[float, float]:
    return radius * (x * cosine - y * sine), -radius * (x * sine + y * cosine)
