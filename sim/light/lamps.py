"""Light of the room's lamps on what every pixel sees.

A small lamp at distance r from a point, with the angle i of incidence, gives the irradiance

    E = E0 (D/r)² cos i

where E0 is that on a facing surface at distance D. It is computed where the ray of the pixel's centre ends,
without light by way of other surfaces and without gloss; parts cast shadows, the surroundings do not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Floats, PixelIndices
from fpplab.core.geometry import Pinhole
from sim.effects import EFFECTS
from sim.light.cache import ByteLimitedCache, table_digest
from sim.light.plane import can_compute
from sim.light.solid import shape_of
from sim.light.table import Irradiance
from sim.scene import PointLamp, RenderScene
from sim.world import World

RoomLightAt = Callable[[PixelIndices | None], Irradiance | np.float32]
"""Gives the light on what some pixels see, or all for None, see `RoomLight.on`."""


class RoomLight:
    """All light of a world that is not the projector's: ambient light and lamps."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._kept: ByteLimitedCache[Irradiance] = ByteLimitedCache(1 << 28)

    def on(self, scene: RenderScene, pixels: PixelIndices | None = None) -> Irradiance | np.float32:
        # returns (P,)
        ambient = np.float32(self._world.ambient)
        if not point_lamps(self._world):
            return ambient

        def make() -> Irradiance:
            if pixels is None:
                return ambient + lamp_picture(self._world, scene)
            return ambient + lamp_light(self._world, scene, pixels)

        if can_compute(scene):  # as quick as to tell whether it is there
            return make()
        return self._kept.get(table_digest(scene, [], *(() if pixels is None else (pixels,))), make)


@dataclass(frozen=True, eq=False)
class _Met:
    """What the rays of pixels meet first.

    pixels: numbers (N,) of those that see something; points (N, 3) and unit normals (N, 3) towards the
    camera, in its frame; shape: what casts shadows, None for nothing and for a single flat item.
    """

    pixels: NDArray[np.intp]
    points: Floats
    normals: Floats
    shape: RayTracedShape | None

    @classmethod
    def on_planes(
        cls,
        pixels: NDArray[np.intp],
        rays: Floats,
        normals: Floats,
        corners: Floats,
        shape: RayTracedShape | None,
    ) -> _Met:
        """Meet planes through corners, ahead of the camera."""
        falls = np.einsum("pi,pi->p", rays, normals)
        lengths = np.sum(normals * corners, axis=1) / np.where(falls == 0, np.nan, falls)
        ahead = lengths > 0
        towards_camera = normals[ahead] * -np.sign(falls[ahead])[:, None]
        return cls(pixels[ahead], rays[ahead] * lengths[ahead, None], towards_camera, shape)


def point_lamps(world: World) -> tuple[PointLamp, ...]:
    return tuple(lamp for effect in EFFECTS for lamp in effect.point_lamps(world))


def lamp_light(world: World, scene: RenderScene, pixels: PixelIndices) -> Irradiance:
    """Compute the light of all lamps of the room on what some pixels see."""
    # returns (P,)
    met = _first_met(scene, pixels)
    light = np.zeros(len(pixels[0]), np.float32)
    for lamp in point_lamps(world):
        place = np.array(lamp.place)
        ways = place - met.points
        away = np.linalg.norm(ways, axis=1)
        cosine = np.einsum("pi,pi->p", ways, met.normals) / away
        here = lamp.irradiance / away**2 * np.maximum(cosine, 0.0)
        lit = np.flatnonzero(here)
        if met.shape is not None:
            here[lit] *= met.shape.unoccluded(place, met.points[lit])
        light[met.pixels] += here.astype(np.float32)
    return light


def lamp_picture(world: World, scene: RenderScene) -> Irradiance:
    """Compute the light of all lamps of the room on what every pixel of the image sees."""
    # returns (height, width)
    (width, height), (left, top, right, bottom) = scene.camera.size, scene.window
    rows, columns = np.mgrid[top:bottom, left:right]
    picture = np.zeros((height, width), np.float32)
    light = lamp_light(world, scene, (rows.ravel(), columns.ravel()))
    picture[top:bottom, left:right] = light.reshape(rows.shape)
    return picture


def _first_met(scene: RenderScene, pixels: PixelIndices) -> _Met:
    camera, (rows, columns) = scene.camera, pixels
    rays = _pixel_rays(
        camera.size,
        tuple(camera.matrix.ravel().tolist()),
        tuple(camera.distortion.tolist()),
        np.asarray(rows, np.int64).tobytes(),
        np.asarray(columns, np.int64).tobytes(),
    )
    if can_compute(scene):
        T = scene.surfaces[0].T_camera_item
        normals, corners = np.broadcast_to(T[:3, 2], rays.shape), T[:3, 3]
        return _Met.on_planes(np.arange(len(rays)), rays, normals, corners, None)
    shape = shape_of(scene)
    shading = tuple(surface for surface in scene.surfaces if surface.shades_room)
    shadows = shape if len(shading) == len(scene.surfaces) else None
    if shadows is None and shading:
        shadows = shape_of(replace(scene, surfaces=shading))
    faces = shape.first_face(np.zeros(3), rays)
    met = np.flatnonzero(faces >= 0)
    normals, corners = shape.normals[faces[met]], shape.triangles[faces[met], 0]
    return _Met.on_planes(met, rays[met], normals, corners, shadows)


@lru_cache(maxsize=12)
def _pixel_rays(
    size: tuple[int, int],
    matrix: tuple[float, ...],
    distortion: tuple[float, ...],
    rows: bytes,
    columns: bytes,
) -> Floats:
    """Rays (P, 3) with z = 1 of pixels; the same few sets of pixels are asked for again and again."""
    camera = Pinhole(size, np.reshape(matrix, (3, 3)), np.array(distortion))
    points = np.stack([np.frombuffer(indices, np.int64) for indices in (columns, rows)], axis=-1)
    slopes = camera.normalise(points.astype(np.float64))
    return np.column_stack([slopes, np.ones(len(slopes))])
