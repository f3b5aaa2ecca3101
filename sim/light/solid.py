"""Direct light on matt bodies by ray tracing, for some pixels alone: as Blender renders it.

Every sample is Blender's own: the same points of pixel and lens, and the same turn of the lens in every
pixel, by the rays of `sim.light.rays`. Which triangle is seen is found by Embree, where by the triangle's
plane, in double precision. With the unit normal n of the triangle and depth z before the lamp, the law of
`sim.light.plane` reads

    E = D² |n · (lamp - point)| / z³

where camera and lamp are on the same side of the triangle and nothing is between lamp and point.
"""

from dataclasses import replace

import numba
import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats, PixelIndices
from fpplab.core.geometry import Pinhole
from sim.light.rays import lens_turn, on_lens, slopes_at
from sim.light.table import Irradiance, LightTable
from sim.scene import ALBEDO, CHANNELS, DIRECT, Paint, RenderScene, SubpixelView, X, Y, Z


def can_trace(scene: RenderScene) -> bool:
    """Return whether a scene can be traced: bodies of one evenly matt paint each, without relief or print."""
    return all(
        surface.picture is None and surface.paint == Paint(surface.paint.reflectance)
        for surface in scene.surfaces
    )


def traced(
    scene: RenderScene, views: list[SubpixelView], pixels: PixelIndices, shown: int | None = None
) -> LightTable:
    """Trace the table that a survey of this scene gives, see `LightTable.of`, for some pixels."""
    return Bodies(scene, shown).traced(views, pixels)


def shape_of(scene: RenderScene) -> RayTracedShape:
    placed = [
        trimesh.Trimesh(surface.vertices, surface.faces, process=False).apply_transform(surface.T_camera_item)
        for surface in scene.surfaces
    ]
    whole = trimesh.util.concatenate(placed)
    assert isinstance(whole, trimesh.Trimesh)
    return RayTracedShape(whole)


class Bodies:
    """All surfaces of a scene as triangles in the camera's frame, of which some of the first may reflect."""

    def __init__(self, scene: RenderScene, shown: int | None = None) -> None:
        self._scene, camera = scene, scene.camera
        self._reach = Pinhole(camera.size, camera.matrix, camera.distortion).reach
        self._shape = shape_of(scene)
        self._first_of = np.cumsum([0, *(len(surface.faces) for surface in scene.surfaces)])
        self._last_seen = self._first_of[-1 if shown is None else shown]

    def traced(self, views: list[SubpixelView], pixels: PixelIndices) -> LightTable:
        """Trace some pixels as the function of this name does; what was prepared serves every call."""
        (left, top, right, bottom), (row, column) = self._scene.window, pixels
        drawn = np.flatnonzero((row >= top) & (row < bottom) & (column >= left) & (column < right))
        survey = np.zeros((len(views), 1, len(row), CHANNELS), np.float32)
        for view, of_view in zip(views, survey[:, 0], strict=True):
            self._see_through(view, row[drawn], column[drawn], drawn, of_view)
        return LightTable.of(survey, replace(self._scene, window=(0, 0, len(row), 1)))

    def _reflectance(self, faces: NDArray[np.int64], points: Floats) -> Irradiance:
        """Reflectance (N,) at points of faces; 0 where the surface is not asked for."""
        reflectance = np.zeros(len(faces), np.float32)
        owner = np.searchsorted(self._first_of, faces, side="right") - 1
        for number, surface in enumerate(self._scene.surfaces):
            of = np.flatnonzero((owner == number) & (faces < self._last_seen))
            if surface.picture is None or surface.uv is None:
                reflectance[of] = surface.paint.reflectance
                continue
            own = faces[of] - self._first_of[number]
            places = np.asarray(surface.uv[surface.faces[own]], np.float64)
            share = np.empty(len(of), np.float32)
            _interpolate_picture(points[of], self._shape.triangles[faces[of]], places, surface.picture, share)
            ink = surface.paint.ink
            reflectance[of] = ink + (surface.paint.reflectance - ink) * share / np.float32(255)
        return reflectance

    def _see_through(
        self,
        view: SubpixelView,
        rows: NDArray[np.intp],
        columns: NDArray[np.intp],
        places: NDArray[np.intp],
        survey: Irradiance,
    ) -> None:
        """Fill in the channels (P, CHANNELS) of pixels, which have these places in `survey`."""
        scene, shape = self._scene, self._shape
        camera, lamp = scene.camera, scene.lamp
        starts, directions = np.empty((len(rows), 3)), np.empty((len(rows), 3))
        _rays(
            columns=columns,
            rows=rows,
            height=camera.size[1],
            view=np.array([*view.shift, *view.lens], np.float64),
            matrix=camera.matrix,
            lens=camera.distortion,
            reach=self._reach,
            radius=0.5 * scene.aperture.diameter_mm,
            focus=scene.aperture.focus_mm,
            starts=starts,
            directions=directions,
        )
        faces = shape.first_face(starts, directions)
        hit = np.flatnonzero(faces >= 0)
        faces, places = faces[hit], places[hit]
        centre = lamp.T_camera_projector[:3, 3]
        points, direct = np.empty((len(hit), 3)), np.empty(len(hit))
        _meet(
            starts=starts[hit],
            directions=directions[hit],
            corners=shape.triangles[faces, 0],
            normals=shape.normals[faces],
            lamp=centre,
            axis=lamp.T_camera_projector[:3, 2],
            cosine=np.cos(lamp.half_angle),
            distance=lamp.distance_mm,
            points=points,
            direct=direct,
        )
        reflectance = self._reflectance(faces, points)
        direct *= reflectance
        lit = np.flatnonzero(direct)
        direct[lit] *= shape.unoccluded(centre, points[lit])
        survey[places, X], survey[places, Y], survey[places, Z] = points.T
        survey[places, DIRECT] = direct
        survey[places, ALBEDO] = reflectance


@kernel(parallel=True, error_model="numpy")
def _interpolate_picture(
    points: Floats, corners: Floats, places: Floats, picture: NDArray[np.uint8], grey: Irradiance
) -> None:
    """Interpolate a picture at points (N, 3) of triangles (N, 3, 3) with corners at places (N, 3, 2)."""
    rows, columns = picture.shape
    for i in numba.prange(len(points)):
        first, second, point = corners[i, 1] - corners[i, 0], corners[i, 2] - corners[i, 0], points[i]
        offset = point - corners[i, 0]
        aa, ab, bb = np.dot(first, first), np.dot(first, second), np.dot(second, second)
        ao, bo = np.dot(first, offset), np.dot(second, offset)
        area = aa * bb - ab * ab
        s, t = (bb * ao - ab * bo) / area, (aa * bo - ab * ao) / area
        x = places[i, 0, 0] + s * (places[i, 1, 0] - places[i, 0, 0])
        x += t * (places[i, 2, 0] - places[i, 0, 0])
        y = places[i, 0, 1] + s * (places[i, 1, 1] - places[i, 0, 1])
        y += t * (places[i, 2, 1] - places[i, 0, 1])
        u = min(max(x * columns - 0.5, 0.0), columns - 1.0)
        v = min(max(y * rows - 0.5, 0.0), rows - 1.0)
        left, top = int(u), int(v)
        right, below = min(left + 1, columns - 1), min(top + 1, rows - 1)
        across, down = u - left, v - top
        upper = picture[top, left] * (1 - across) + picture[top, right] * across
        lower = picture[below, left] * (1 - across) + picture[below, right] * across
        grey[i] = upper * (1 - down) + lower * down


@kernel(parallel=True, error_model="numpy")
def _rays(
    columns: NDArray[np.intp],
    rows: NDArray[np.intp],
    height: int,
    view: Floats,
    matrix: Floats,
    lens: Floats,
    reach: float,
    radius: float,
    focus: float,
    starts: Floats,
    directions: Floats,
) -> None:
    """Compute where the rays of pixels begin and lead to; view: shift u, v and lens x, y."""
    for i in numba.prange(len(rows)):
        u, v = columns[i], rows[i]
        x, y = slopes_at(u + view[0], v + view[1], matrix, lens, reach)
        ox, oy = 0.0, 0.0
        if radius > 0:
            sine, cosine = lens_turn(u, v, height)
            ox, oy = on_lens(radius, view[2], view[3], sine, cosine)
        starts[i, 0], starts[i, 1], starts[i, 2] = ox, oy, 0.0
        dx, dy = x - ox / focus, y - oy / focus
        length = np.sqrt(dx * dx + dy * dy + 1.0)
        directions[i, 0], directions[i, 1], directions[i, 2] = dx / length, dy / length, 1.0 / length


@kernel(parallel=True, error_model="numpy")
def _meet(
    starts: Floats,
    directions: Floats,
    corners: Floats,
    normals: Floats,
    lamp: Floats,
    axis: Floats,
    cosine: float,
    distance: float,
    points: Floats,
    direct: Floats,
) -> None:
    """Compute where rays meet the planes of their triangles, and the white light there without shadows."""
    for i in numba.prange(len(starts)):
        ahead, fall, facing, z, away = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            ahead += normals[i, k] * (corners[i, k] - starts[i, k])
            fall += normals[i, k] * directions[i, k]
        for k in range(3):
            points[i, k] = starts[i, k] + ahead / fall * directions[i, k]
            towards = points[i, k] - lamp[k]
            facing += normals[i, k] * towards
            z += axis[k] * towards
            away += towards * towards
        lit = facing * fall > 0 and z > cosine * np.sqrt(away)
        direct[i] = distance * distance * abs(facing) / (z * z * z) if lit else 0.0
