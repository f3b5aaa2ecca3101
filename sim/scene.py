"""What the Blender process is told: plain numbers, no configuration, no bpy.

Frame: the camera's (OpenCV), mm. A scene is all that a render depends on, except the
projector's texture and the rendering effort, so the process keeps no other state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats


@dataclass(frozen=True, eq=False)
class PinholeOptics:
    """A pinhole with OpenCV's distortion.

    size: (width, height) in px. matrix: (3, 3) in px. distortion: (8,), k1 k2 p1 p2 k3 k4 k5 k6.
    """

    size: tuple[int, int]
    matrix: Floats
    distortion: Floats


@dataclass(frozen=True, eq=False)
class Aperture:
    """A thin lens in the place of the pinhole: its diameter, 0 for none, and the depth that is sharp, mm."""

    diameter_mm: float = 0.0
    focus_mm: float = 1.0

    def circle_per_px(self, depth_mm: Floats) -> Floats:
        """Diameter of the circle of confusion over the focal length: `A |1/z - 1/z_focus|`."""
        return np.asarray(self.diameter_mm * np.abs(1.0 / depth_mm - 1.0 / self.focus_mm))


@dataclass(frozen=True, eq=False)
class Lamp:
    """The projector as a light.

    T_camera_projector: (4, 4). affine: (2, 3), projector pixels (u, v, 1) to texture columns and rows.
    texture_shape: (rows, columns). exact: mirrors with sharp edges, else interpolated linearly.
    fill: side of an exact mirror, in texels.
    distance_mm: where a white surface that faces the white projector has irradiance 1.
    half_angle: of the cone around the axis that holds the image, rad; beyond it the lens's polynomial may
    fold back into the image.
    aperture: of its lens. texels_per_slope: of the texture, by which the circle of confusion is scaled.
    circles: (L,) rising diameters in texels for which textures are given; between two of them their mixture
    is linear in the diameter's square, as variances are.
    """

    optics: PinholeOptics
    T_camera_projector: Floats
    affine: Floats
    texture_shape: tuple[int, int]
    exact: bool
    fill: float
    distance_mm: float
    half_angle: float
    aperture: Aperture
    texels_per_slope: float
    circles: tuple[float, ...]

    @property
    def sharp(self) -> float | None:
        """Side of mirrors with sharp edges, in texels; None for smooth optics."""
        return self.fill if self.exact else None


@dataclass(frozen=True)
class Relief:
    """Sinusoidal ridges across `axis`, of length 1 in the item's frame; `depth_mm` from crest to valley."""

    axis: tuple[float, float, float]
    period_mm: float
    depth_mm: float


@dataclass(frozen=True)
class Grain:
    """Random facets: RMS slope, and their size."""

    slope: float
    size_mm: float


LEVEL, EVEN = Relief((0.0, 0.0, 1.0), 1.0, 0.0), Grain(0.0, 1.0)
"""No relief, and no grain."""


@dataclass(frozen=True)
class Paint:
    """What a surface is made of.

    reflectance: 0 … 1, where a picture on the surface is white; ink: where it is black. roughness:
    Oren-Nayar's, 0 … 1. gloss: share of light that a gloss reflects. scatter_mm: mean free path below the
    surface, 0 for a surface that light does not enter.
    """

    reflectance: float
    roughness: float = 0.0
    gloss: float = 0.0
    gloss_roughness: float = 0.3
    scatter_mm: float = 0.0
    relief: Relief = LEVEL
    grain: Grain = EVEN
    ink: float = 0.0


@dataclass(frozen=True, eq=False)
class Surface:
    """A body of triangles.

    vertices: (V, 3) in mm in the item's frame. faces: (F, 3) indices. T_camera_item: (4, 4).
    picture: uint8 [v, u], from the paint's ink at 0 to its reflectance at 255, or None. uv: (V, 2) places of
    the vertices in the picture, 0 … 1, v downwards.
    """

    vertices: Floats
    faces: NDArray[np.int64]
    T_camera_item: Floats
    paint: Paint
    picture: NDArray[np.uint8] | None = None
    uv: Floats | None = None


@dataclass(frozen=True, eq=False)
class RenderScene:
    """Camera, light and surfaces.

    window: (left, top, right, bottom) in px, the right and bottom ones excluded: the part of the image that
    holds the surfaces. The rest is black without being rendered.
    """

    camera: PinholeOptics
    aperture: Aperture
    lamp: Lamp
    surfaces: tuple[Surface, ...]
    window: tuple[int, int, int, int]


@dataclass(frozen=True)
class Effort:
    """How hard to render: light paths a sub-pixel, bounces between surfaces, on what device, and what of it.

    survey: also say which points are seen and how they are lit; else it is a picture alone.
    """

    samples: int = 1
    bounces: int = 0
    seed: int = 0
    device: str = "CPU"
    survey: bool = False

    @property
    def channels(self) -> int:
        """Numbers for each pixel."""
        return CHANNELS if self.survey else COLOURS


@dataclass(frozen=True)
class SubpixelView:
    """One point of every pixel and of the lens that a picture is taken through.

    shift: (u, v) from the pixel's centre in px. lens: on a disc of radius 1; turned about the axis by an
    angle of each pixel's own, so that few points do not make ghosts.
    """

    shift: tuple[float, float]
    lens: tuple[float, float] = (0.0, 0.0)


class RenderRefused(Exception):  # noqa: N818 - the world asks for what cannot be had
    """What the world asks for and cannot be had, and what to change: one sentence."""


COLOURS = 3
"""What a picture gives for each pixel: radiance in three colours."""

DIRECT, ALBEDO, X, Y, Z = range(COLOURS, COLOURS + 5)
CHANNELS = COLOURS + 5
"""What a survey gives besides: of the first colour, what came straight from the projector; the surface's
reflectance; and the point that was seen, in mm, zeros where none was."""


POSITION, REFLECTANCE = "position", "reflectance"
"""The names under which every material says which point was seen, and what of the light it gives back."""
