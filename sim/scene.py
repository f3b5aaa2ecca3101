"""The scene as the Blender process receives it: plain numbers, no configuration, no bpy.

Frame: the camera's (OpenCV), mm. A scene is all that a render depends on, except the
projector's texture and the rendering effort, so the process keeps no other state.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # Blender's own Python, in which the extension has this file, lacks fpplab
    from fpplab.core.conventions import Floats


@dataclass(frozen=True, eq=False)
class PinholeOptics:
    """A pinhole with OpenCV's distortion.

    Attributes
    ----------
    size : tuple of int
        (width, height) of the image in px.
    matrix : Floats
        Intrinsic matrix (3, 3) in px.
    distortion : Floats
        OpenCV's coefficients (8,): k1 k2 p1 p2 k3 k4 k5 k6.
    """

    size: tuple[int, int]
    matrix: Floats
    distortion: Floats


@dataclass(frozen=True, eq=False)
class Aperture:
    """A thin lens in the place of the pinhole.

    Attributes
    ----------
    diameter_mm : float
        Diameter of the aperture in mm; 0 for a pinhole, which is sharp at every depth.
    focus_mm : float
        Depth that is in focus, in mm.
    """

    diameter_mm: float = 0.0
    focus_mm: float = 1.0

    def circle_per_px(self, depth_mm: Floats) -> Floats:
        """Compute the diameter of the circle of confusion over the focal length: `A |1/z - 1/z_focus|`.

        Parameters
        ----------
        depth_mm : Floats
            Depths before the lens in mm, of any shape.

        Returns
        -------
        Floats
            Of the same shape, in px of diameter for each px of focal length.
        """
        return np.asarray(self.diameter_mm * np.abs(1.0 / depth_mm - 1.0 / self.focus_mm))


@dataclass(frozen=True, eq=False)
class Lamp:
    """The projector as a light.

    Attributes
    ----------
    optics : PinholeOptics
        Of the projector, in mirrors.
    T_camera_projector : Floats
        Pose (4, 4) of the projector in the camera's frame, in mm.
    affine : Floats
        (2, 3), from projector pixels (u, v, 1) to columns and rows of mirrors.
    texture_shape : tuple of int
        (rows, columns) of the texture that is sent with the scene, if any.
    places_per_mirror : int
        Texels of that texture along each axis of a mirror.
    exact : bool
        Whether mirrors have sharp edges; otherwise that texture is interpolated by cubic splines.
    fill : float
        Side of a mirror with sharp edges, in texels.
    distance_mm : float
        Distance at which a white surface that faces the white projector has irradiance 1.
    half_angle : float
        Of the cone around the axis that holds the image, in rad; beyond it the lens's polynomial may fold
        back into the image.
    aperture : Aperture
        Of the projector's lens.
    texels_per_slope : float
        Focal length in texels, by which the circle of confusion is scaled.
    circles : tuple of float
        (L,) rising diameters in texels for which textures are given; between two of them their mixture is
        linear in the diameter's square, as variances are.
    """

    optics: PinholeOptics
    T_camera_projector: Floats
    affine: Floats
    texture_shape: tuple[int, int]
    places_per_mirror: int
    exact: bool
    fill: float
    distance_mm: float
    half_angle: float
    aperture: Aperture
    texels_per_slope: float
    circles: tuple[float, ...]


@dataclass(frozen=True)
class Relief:
    """Sinusoidal ridges.

    Attributes
    ----------
    axis : tuple of float
        Direction across the ridges, of length 1 in the item's frame.
    period_mm : float
        Distance from ridge to ridge in mm.
    depth_mm : float
        Height from valley to crest in mm; 0 for no ridges.
    """

    axis: tuple[float, float, float]
    period_mm: float
    depth_mm: float


@dataclass(frozen=True)
class Grain:
    """Random facets.

    Attributes
    ----------
    slope : float
        Root mean square of the surface's gradient; 0 for no facets.
    size_mm : float
        Square root of a facet's mean area, in mm.
    """

    slope: float
    size_mm: float


NO_RELIEF, NO_GRAIN = Relief((0.0, 0.0, 1.0), 1.0, 0.0), Grain(0.0, 1.0)
"""A surface without ridges, and one without facets."""


@dataclass(frozen=True)
class BaseLayer:
    """What a surface is made of below its gloss coat.

    Attributes
    ----------
    shader : str
        Name of the shader that draws it, a key of `sim.blender.materials.BASE_SHADERS`.
    parameters : tuple of (str, float)
        What that shader asks for besides reflectance and normal, by name.
    """

    shader: str
    parameters: tuple[tuple[str, float], ...] = ()


def matt(roughness: float = 0.0) -> BaseLayer:
    """Make the base layer of matt paint.

    Parameters
    ----------
    roughness : float
        Of Oren and Nayar's model in Fujii's form, 0 (Lambertian) to 1 (roughest).

    Returns
    -------
    BaseLayer
        Drawn by the shader "diffuse".
    """
    return BaseLayer("diffuse", (("roughness", roughness),))


LAMBERTIAN = matt()
"""The base layer that reflects equally in all directions."""


@dataclass(frozen=True)
class Paint:
    """What a surface is made of.

    Attributes
    ----------
    reflectance : float
        Of the base layer, 0 to 1, where a picture on the surface is white.
    base : BaseLayer
        The layer below the gloss coat.
    gloss : float
        Share of the light that a gloss coat reflects; 0 for no coat.
    gloss_roughness : float
        Square root of the width parameter of GGX, of the coat.
    relief : Relief
        Ridges.
    grain : Grain
        Facets.
    ink : float
        Reflectance where a picture on the surface is black.
    """

    reflectance: float
    base: BaseLayer = LAMBERTIAN
    gloss: float = 0.0
    gloss_roughness: float = 0.3
    relief: Relief = NO_RELIEF
    grain: Grain = NO_GRAIN
    ink: float = 0.0


@dataclass(frozen=True, eq=False)
class Surface:
    """A body of triangles.

    Attributes
    ----------
    vertices : Floats
        Corners (V, 3) in mm in the item's frame.
    faces : ndarray of int64
        Indices (F, 3) of the corners of every triangle.
    T_camera_item : Floats
        Pose (4, 4) in the camera's frame, in mm.
    paint : Paint
        What it is made of.
    picture : ndarray of uint8 or None
        Print [v, u], from the paint's ink at 0 to its reflectance at 255; None for none.
    uv : Floats or None
        Places (V, 2) of the vertices in the picture, 0 to 1, v downwards; None without a picture.
    shades_room : bool
        Whether it throws shadows of the room's lamps.
    """

    vertices: Floats
    faces: NDArray[np.int64]
    T_camera_item: Floats
    paint: Paint
    picture: NDArray[np.uint8] | None = None
    uv: Floats | None = None
    shades_room: bool = True


@dataclass(frozen=True, eq=False)
class RenderScene:
    """Camera, light and surfaces.

    Attributes
    ----------
    camera : PinholeOptics
        The camera, at the origin.
    aperture : Aperture
        Of the camera's lens.
    lamp : Lamp
        The projector.
    surfaces : tuple of Surface
        Everything that is in view.
    window : tuple of int
        (left, top, right, bottom) in px, the right and bottom ones excluded: the part of the image that holds
        the surfaces. The rest is black without being rendered.
    """

    camera: PinholeOptics
    aperture: Aperture
    lamp: Lamp
    surfaces: tuple[Surface, ...]
    window: tuple[int, int, int, int]


@dataclass(frozen=True)
class Effort:
    """How thoroughly to render, on what device, and which channels to return.

    Attributes
    ----------
    samples : int
        Light paths for each sub-pixel.
    bounces : int
        Reflections between surfaces that are followed.
    seed : int
        Of the random light paths.
    device : str
        What Cycles computes on, as `sim.world.Render.device`.
    survey : bool
        Whether the channels of a survey are returned too: the points that are seen and their direct light.
        Otherwise only the picture is.
    """

    samples: int = 1
    bounces: int = 0
    seed: int = 0
    device: str = "CPU"
    survey: bool = False

    @property
    def channels(self) -> int:
        """How many numbers a render gives for each pixel."""
        return CHANNELS if self.survey else COLOURS


@dataclass(frozen=True)
class SubpixelView:
    """One point of every pixel and of the lens that a picture is taken through.

    Attributes
    ----------
    shift : tuple of float
        (u, v) from the pixel's centre in px.
    lens : tuple of float
        Point of the aperture, on a disc of radius 1; turned about the axis by a different angle in every
        pixel, so that few points do not make ghost images.
    """

    shift: tuple[float, float]
    lens: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class PointLamp:
    """A lamp of the room.

    Attributes
    ----------
    place : tuple of float
        In mm in the camera's frame.
    irradiance : float
        Light at a distance of 1 mm on a surface that faces it, relative to the projector's white.
    """

    place: tuple[float, float, float]
    irradiance: float


@dataclass(frozen=True, eq=False)
class PatternRender:
    """All that it takes to render what the camera sees of a scene under one pattern.

    The irradiance is `falloff * (mean of the views + (ambient + light of the room's lamps) * reflectance)`.

    Attributes
    ----------
    scene : RenderScene
        Camera, lamp and surfaces.
    textures : ndarray of float32
        Of the lamp, (circles, rows, columns), see `sim.texture.MirrorTexture.fine`.
    views : tuple of SubpixelView
        Points of the pixels and of the lens to look through.
    effort : Effort
        How thoroughly to render.
    ambient : float
        Uniform ambient light, relative to the projector's white.
    falloff : ndarray of float32 or None
        The lens's transmission to each pixel, (height, width); None where it is 1.
    room_lamps : tuple of PointLamp
        Lamps of the room.
    """

    scene: RenderScene
    textures: NDArray[np.float32]
    views: tuple[SubpixelView, ...]
    effort: Effort
    ambient: float
    falloff: NDArray[np.float32] | None
    room_lamps: tuple[PointLamp, ...] = ()


@dataclass(frozen=True)
class GreyScale:
    """Mean grey level by irradiance: a straight line that ends where the sensor saturates.

    Attributes
    ----------
    black : float
        Grey level without light.
    slope : float
        Grey levels for irradiance 1.
    saturated : float
        The greatest mean grey level.
    full_scale : int
        The greatest grey level that a frame can hold.
    """

    black: float
    slope: float
    saturated: float
    full_scale: int

    def levels(self, irradiance: NDArray[np.float32]) -> NDArray[np.float32]:
        """Compute the mean of many frames: without noise, and without rounding.

        Parameters
        ----------
        irradiance : ndarray of float32
            Of any shape, 1 for white.

        Returns
        -------
        ndarray of float32
            Grey levels of the same shape, 0 to full scale.
        """
        levels = irradiance * np.float32(self.slope)
        levels += np.float32(self.black)
        return np.minimum(levels, np.float32(self.saturated), out=levels)


class RenderRefused(Exception):  # noqa: N818 - the world asks for what cannot be rendered
    """The world asks for something that cannot be rendered; one sentence says what, and what to change."""


COLOURS = 3
"""Channels of a picture: radiance in three colours."""

DIRECT, ALBEDO, X, Y, Z = range(COLOURS, COLOURS + 5)
CHANNELS = COLOURS + 5
"""Channels of a survey, after the picture's: of the first colour, the light that came straight from the
projector; the surface's reflectance; and the point that was seen, in mm, zeros where none was."""


POSITION, REFLECTANCE = "position", "reflectance"
"""Render passes in which every material outputs the point that is seen, and its reflectance."""
