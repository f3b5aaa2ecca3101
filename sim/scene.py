"""The scene as the Blender process receives it: plain numbers, no configuration, no bpy.

Frame: the camera's (OpenCV), mm. A scene is all that a render depends on, except the
projector's texture and the render settings, so the process keeps no other state.
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
    """A pinhole with OpenCV's distortion."""

    size: tuple[int, int]  # (width, height) of the image in px
    matrix: Floats  # intrinsic matrix (3, 3) in px
    distortion: Floats  # OpenCV's coefficients (8,): k1 k2 p1 p2 k3 k4 k5 k6


@dataclass(frozen=True, eq=False)
class Aperture:
    """A thin lens in the place of the pinhole."""

    diameter_mm: float = 0.0  # diameter of the aperture in mm; 0 for a pinhole, which is sharp at every depth
    focus_mm: float = 1.0  # depth that is in focus, in mm

    def circle_per_px(self, depth_mm: Floats) -> Floats:
        """Compute the diameter of the circle of confusion over the focal length: `A |1/z - 1/z_focus|`."""
        return np.asarray(self.diameter_mm * np.abs(1.0 / depth_mm - 1.0 / self.focus_mm))


@dataclass(frozen=True, eq=False)
class Lamp:
    """The projector as a light."""

    optics: PinholeOptics  # of the projector, in mirrors
    T_camera_projector: Floats  # pose (4, 4) of the projector in the camera's frame, in mm
    affine: Floats  # (2, 3), from projector pixels (u, v, 1) to columns and rows of mirrors
    texture_shape: tuple[int, int]  # (rows, columns) of the texture that is sent with the scene, if any
    places_per_mirror: int  # texels of that texture along each axis of a mirror
    exact: bool  # whether mirrors have sharp edges; otherwise that texture is interpolated by cubic splines
    fill: float  # side of a mirror with sharp edges, in texels
    distance_mm: float  # distance at which a white surface that faces the white projector has irradiance 1
    half_angle: float  # of the cone around the axis that holds the image, in rad
    aperture: Aperture  # of the projector's lens
    texels_per_slope: float  # focal length in texels, by which the circle of confusion is scaled
    circles: tuple[float, ...]  # (L,) rising diameters in texels for which textures are given


@dataclass(frozen=True)
class Relief:
    """Sinusoidal ridges."""

    axis: tuple[float, float, float]  # direction across the ridges, of length 1 in the item's frame
    period_mm: float  # distance from ridge to ridge in mm
    depth_mm: float  # height from valley to crest in mm; 0 for no ridges


@dataclass(frozen=True)
class Grain:
    """Random facets."""

    slope: float  # root mean square of the surface's gradient; 0 for no facets
    size_mm: float  # square root of a facet's mean area, in mm


NO_RELIEF, NO_GRAIN = Relief((0.0, 0.0, 1.0), 1.0, 0.0), Grain(0.0, 1.0)
"""A surface without ridges, and one without facets."""


@dataclass(frozen=True)
class BaseLayer:
    """What a surface is made of below its gloss coat."""

    shader: str  # name of the shader that draws it, a key of `sim.blender.materials.BASE_SHADERS`
    parameters: tuple[tuple[str, float], ...] = ()  # what that shader asks for besides reflectance and normal


def matt(roughness: float = 0.0) -> BaseLayer:
    return BaseLayer("diffuse", (("roughness", roughness),))


LAMBERTIAN = matt()  # the base layer that reflects equally in all directions


@dataclass(frozen=True)
class Paint:
    """What a surface is made of."""

    reflectance: float  # of the base layer, 0 to 1, where a picture on the surface is white
    base: BaseLayer = LAMBERTIAN  # the layer below the gloss coat
    gloss: float = 0.0  # share of the light that a gloss coat reflects; 0 for no coat
    gloss_roughness: float = 0.3  # square root of the width parameter of GGX, of the coat
    relief: Relief = NO_RELIEF  # ridges
    grain: Grain = NO_GRAIN  # facets
    ink: float = 0.0  # reflectance where a picture on the surface is black


@dataclass(frozen=True, eq=False)
class Surface:
    """A body of triangles."""

    vertices: Floats  # corners (V, 3) in mm in the item's frame
    faces: NDArray[np.int64]  # indices (F, 3) of the corners of every triangle
    T_camera_item: Floats  # pose (4, 4) in the camera's frame, in mm
    paint: Paint  # what it is made of
    picture: NDArray[np.uint8] | None = None
    uv: Floats | None = None  # places (V, 2) of the vertices in the picture, 0 to 1, v downwards
    shades_room: bool = True  # whether it throws shadows of the room's lamps


@dataclass(frozen=True, eq=False)
class RenderScene:
    """Camera, light and surfaces."""

    camera: PinholeOptics  # the camera, at the origin
    aperture: Aperture  # of the camera's lens
    lamp: Lamp  # the projector
    surfaces: tuple[Surface, ...]  # everything that is in view
    window: tuple[int, int, int, int]  # (left, top, right, bottom) in px, the right and bottom ones excluded


@dataclass(frozen=True)
class RenderSettings:
    """How thoroughly to render, on what device, and which channels to return."""

    samples: int = 1  # light paths for each sub-pixel
    bounces: int = 0  # reflections between surfaces that are followed
    seed: int = 0  # of the random light paths
    device: str = "CPU"  # what Cycles computes on, as `sim.world.Render.device`
    survey: bool = False  # whether the channels of a survey are returned too

    @property
    def channels(self) -> int:
        """How many numbers a render gives for each pixel."""
        return CHANNELS if self.survey else COLOURS


@dataclass(frozen=True)
class SubpixelView:
    """One point of every pixel and of the lens that a picture is taken through."""

    shift: tuple[float, float]  # (u, v) from the pixel's centre in px
    lens: tuple[float, float] = (0.0, 0.0)  # point of the aperture, on a disc of radius 1


@dataclass(frozen=True)
class PointLamp:
    """A lamp of the room."""

    place: tuple[float, float, float]  # in mm in the camera's frame
    irradiance: float  # light at a distance of 1 mm on a surface that faces it


@dataclass(frozen=True, eq=False)
class PatternRender:
    """All that it takes to render what the camera sees of a scene under one pattern.

    The irradiance is `falloff * (mean of the views + (ambient + light of the room's lamps) * reflectance)`.
    """

    scene: RenderScene  # camera, lamp and surfaces
    textures: NDArray[np.float32]  # of the lamp
    views: tuple[SubpixelView, ...]  # points of the pixels and of the lens to look through
    settings: RenderSettings  # how thoroughly to render
    ambient: float  # uniform ambient light, relative to the projector's white
    falloff: NDArray[np.float32] | None  # the lens's transmission to each pixel, (height, width)
    room_lamps: tuple[PointLamp, ...] = ()  # lamps of the room


@dataclass(frozen=True)
class GreyScale:
    """Mean grey level by irradiance: a straight line that ends where the sensor saturates."""

    black: float  # grey level without light
    slope: float  # grey levels for irradiance 1
    saturated: float  # the greatest mean grey level
    full_scale: int  # the greatest grey level that a frame can hold

    def levels(self, irradiance: NDArray[np.float32]) -> NDArray[np.float32]:
        """Compute the mean of many frames: without noise, and without rounding."""
        levels = irradiance * np.float32(self.slope)
        levels += np.float32(self.black)
        return np.minimum(levels, np.float32(self.saturated), out=levels)


class RenderRefused(Exception):  # noqa: N818 - the world asks for what cannot be rendered
    """The world asks for something that cannot be rendered; one sentence says what, and what to change."""


COLOURS = 3  # channels of a picture: radiance in three colours, as Blender renders

DIRECT, ALBEDO, X, Y, Z = range(COLOURS, COLOURS + 5)
CHANNELS = COLOURS + 5
"""Channels of a survey, after the picture's: of the first colour, the light that came straight from the
projector; the surface's reflectance; and the point that was seen, in mm, zeros where none was."""


POSITION, REFLECTANCE = "position", "reflectance"
"""Render passes in which every material outputs the point that is seen, and its reflectance."""
