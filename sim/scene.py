"""What the Blender process is told: plain numbers, no configuration, no bpy.

Frame: the camera's (OpenCV), mm. A scene is all that a render depends on, except the
projector's texture and the rendering effort, so the process keeps no other state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.conventions import Floats


@dataclass(frozen=True, eq=False)
class Optics:
    """A pinhole with OpenCV's distortion. size: (width, height) in px. matrix: (3, 3) in px."""

    size: tuple[int, int]
    matrix: Floats
    distortion: Floats


@dataclass(frozen=True, eq=False)
class Lamp:
    """The projector as a light.

    T_camera_projector: (4, 4). affine: (2, 3), projector pixels (u, v, 1) to texture columns and rows.
    texture_shape: (rows, columns). exact: mirrors with sharp edges, else interpolated linearly.
    distance_mm: where a white surface that faces the white projector has irradiance 1.
    half_angle: of the cone around the axis that holds the image, rad; beyond it the lens's polynomial may
    fold back into the image.
    """

    optics: Optics
    T_camera_projector: Floats
    affine: Floats
    texture_shape: tuple[int, int]
    exact: bool
    distance_mm: float
    half_angle: float


@dataclass(frozen=True, eq=False)
class Surface:
    """A diffuse body of triangles.

    vertices: (V, 3) in mm in the item's frame. faces: (F, 3) indices. T_camera_item: (4, 4).
    reflectance: of the paint, 0 … 1. picture: uint8 [v, u] that scales it, or None.
    uv: (V, 2) places of the vertices in the picture, 0 … 1, v downwards.
    """

    vertices: Floats
    faces: NDArray[np.int64]
    T_camera_item: Floats
    reflectance: float
    picture: NDArray[np.uint8] | None = None
    uv: Floats | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """Camera, light and surfaces.

    window: (left, top, right, bottom) in px, the right and bottom ones excluded: the part of the image that
    holds the surfaces. The rest is black without being rendered.
    """

    camera: Optics
    lamp: Lamp
    surfaces: tuple[Surface, ...]
    window: tuple[int, int, int, int]


@dataclass(frozen=True)
class Effort:
    """How hard to render: light paths a sub-pixel, and how often light may bounce between surfaces."""

    samples: int = 1
    bounces: int = 0
    seed: int = 0


CHANNELS = 4
"""What a render gives for each pixel: radiance in three colours, and the surface's reflectance."""
