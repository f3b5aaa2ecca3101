"""The conventions of every frame, pixel, angle and phase in fpplab, stated once.

Units
    Lengths in mm, times in s. Angles are degrees in files and radians in code.
    Errors are reported in µm and px.
Frames
    Right-handed. A camera or projector frame is OpenCV's: x right, y down, z
    forward. `T_b_a` takes coordinates in a to coordinates in b:
    `X_b = R_b_a X_a + t_b_a`. The world of a characterised rig is its camera's frame.
Pixels
    (0, 0) is the CENTRE of the first pixel, column first: (u, v). Arrays are
    indexed [v, u]. Sizes are (width, height).
Distortion
    OpenCV's (k1, k2, p1, p2, k3), for the camera and for the projector.
Fringes
    A set along axis x with `stripes` periods across W projector pixels shows
    `I_n(u) = offset + amplitude * cos(2π stripes (u + 0.5)/W - δ_n)`, with
    `δ_n = 2π n/N`, n = 0 … N-1. Decoding gives `φ = atan2(Σ I_n sin δ_n, Σ I_n cos δ_n)`
    in [0, 2π), the modulation `B = (2/N) sqrt(S² + C²)`, and after unwrapping
    `u = Φ W/(2π stripes) - 0.5`. `stripes` may be fractional. Axis y is the same in v and H.
Lattice
    On a `square` lattice mirror (column i, row j) is centred at u = i, v = j. On the
    DLP4500's `diamond` lattice odd rows are shifted by half a column: u = i + 0.5 (j mod 2).
Frames of a camera
    The sensor's raw integers. Linearising, averaging and masking happen in the
    pipeline, never in a driver.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fpplab.core.lattice import Lattice as Lattice

TWO_PI = 2.0 * np.pi

Axis = Literal["x", "y"]
AXES: tuple[Axis, Axis] = ("x", "y")  # in the order of a coordinate's components

Floats = NDArray[np.float64]
Map = NDArray[np.float32]  # a per-pixel quantity of the camera, indexed [v, u], NaN where it is not known
Mask = NDArray[np.bool_]
PixelIndices = tuple[NDArray[np.intp], NDArray[np.intp]]  # rows and columns (P,) of some pixels of an image
Image = NDArray[np.uint8] | NDArray[np.uint16]
"""Raw integers of a camera or grey levels of a projector, indexed [v, u]."""


def mirror_centres(size: tuple[int, int], lattice: Lattice) -> tuple[Floats, Floats]:
    # size (width, height) px; returns u (height, width), v (height, width)
    width, height = size
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    if lattice is Lattice.DIAMOND:
        u[1::2] += 0.5
    return u, v


def axis_length(size: tuple[int, int], axis: Axis) -> int:
    # size (width, height) px
    return size[0] if axis == "x" else size[1]


def phase_of_coordinate(coordinate: Floats, stripes: float, length: int) -> Floats:
    return TWO_PI * stripes * (coordinate + 0.5) / length


def phase_steps(steps: int) -> Floats:
    # Equal fractions n/N give identical numbers, such as 1/6 and 2/12.
    # returns (steps,) rad
    return TWO_PI * (np.arange(steps) / steps)


def full_scale(bits: int) -> int:
    return (1 << bits) - 1


def raw_dtype(bits: int) -> np.dtype[Any]:
    return np.dtype(np.uint8 if bits <= 8 else np.uint16)


def raw_per_grey(bits: int) -> int:
    """Return how many of a frame's integers make one grey level of 8 bits."""
    return 1 << (bits - 8)
