"""An independent ray caster: rays, analytic shapes and a point light, written from the mathematics.

Of the product it uses the pinhole model alone. Everything is in the camera's frame, in mm.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np

from fpplab.core.conventions import Floats, Mask
from fpplab.core.geometry import Pinhole, RigidTransform

Field = Callable[[Floats, Floats, Floats], Floats]
"""Light that the projector throws: of its coordinates u and v, in px, and of the depth z before it, in mm."""


class Shape(Protocol):
    """A surface that a ray can meet."""

    def meet(self, origin: Floats, rays: Floats) -> tuple[Floats, Floats]:
        """How many lengths of rays (..., 3) lead from `origin` (3,) to the surface, infinite for those that
        miss it, and its outward normals (..., 3) there."""
        ...


@dataclass(frozen=True)
class Plane:
    """An infinite plane through a point, seen from the side its normal points to."""

    point: Floats
    normal: Floats

    def meet(self, origin: Floats, rays: Floats) -> tuple[Floats, Floats]:
        length = (self.normal @ (self.point - origin)) / (rays @ self.normal)
        return np.where(length > 0, length, np.inf), np.broadcast_to(self.normal, rays.shape)


@dataclass(frozen=True)
class Sphere:
    """A sphere, from outside."""

    centre: Floats
    radius: float

    def meet(self, origin: Floats, rays: Floats) -> tuple[Floats, Floats]:
        to_centre = self.centre - origin
        a, b = (rays**2).sum(axis=-1), rays @ to_centre
        inside = b**2 - a * (to_centre @ to_centre - self.radius**2)
        length = np.where(inside >= 0, (b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
        reached = np.where(np.isfinite(length), length, 0)[..., None]
        return length, (origin + reached * rays - self.centre) / self.radius


@dataclass(frozen=True)
class Box:
    """A box between two corners in a frame of its own."""

    low: Floats
    high: Floats
    pose: RigidTransform

    def meet(self, origin: Floats, rays: Floats) -> tuple[Floats, Floats]:
        start, way = self.pose.inverse().apply(origin), rays @ self.pose.rotation
        first, second = (self.low - start) / way, (self.high - start) / way
        enter, leave = np.minimum(first, second), np.maximum(first, second).min(axis=-1)
        face = enter.argmax(axis=-1)
        length = enter.max(axis=-1)
        sign = -np.sign(np.take_along_axis(way, face[..., None], axis=-1))
        normals = sign * self.pose.rotation.T[face]
        return np.where((length < leave) & (length > 0), length, np.inf), normals


@dataclass(frozen=True)
class Seen:
    """Every sample (K², height, width): the seen point, its projector coordinates, its depth before the
    projector, and what it radiates under white light relative to a white surface that faces the projector
    at the stated distance. kind: tells apart what is smooth in itself, 0 where nothing is seen."""

    points: Floats
    u: Floats
    v: Floats
    depth: Floats
    shade: Floats
    kind: Floats

    def picture(self, light: Field) -> Floats:
        """What the camera sees (height, width)."""
        return np.asarray((self.shade * light(self.u, self.v, self.depth)).mean(axis=0))

    @cached_property
    def smooth(self) -> Mask:
        """Pixels (height, width) that see lit surface, two pixels and more away from any edge of it."""
        around = np.ones((5, 5), np.uint8)
        most = cv2.dilate(self.kind.max(axis=0), around)
        least = cv2.erode(self.kind.min(axis=0), around)
        return np.asarray((most == least) & (self.shade.min(axis=0) > 0))


@dataclass(frozen=True)
class Caster:
    """Camera, projector and what they look at."""

    camera: Pinhole
    projector: Pinhole
    T_projector_camera: RigidTransform
    distance_mm: float
    reflectance: float

    def look(self, shapes: Sequence[Shape], across: int) -> Seen:
        """Through `across` x `across` points of every pixel, row by row."""
        rays = self._rays(across)
        length, normals, kind = _first(shapes, np.zeros(3), rays)
        hit = np.isfinite(length)
        points = np.where(hit[..., None], np.where(hit, length, 1.0)[..., None] * rays, 0.0)
        lamp = self.T_projector_camera.inverse().translation
        beams = points - lamp
        local = self.T_projector_camera.apply(points)
        distance = np.linalg.norm(beams, axis=-1)
        blocked = _first(shapes, lamp, beams)[0] < 1 - 1e-6
        cos_incidence = -(beams * normals).sum(axis=-1) / distance
        cos_axis = local[..., 2] / distance
        lit = hit & ~blocked & (cos_incidence > 0) & (cos_axis > 0)
        shade = np.zeros(lit.shape)
        shade[lit] = self.reflectance * (self.distance_mm / distance[lit]) ** 2
        shade[lit] *= cos_incidence[lit] / cos_axis[lit] ** 3
        uv = self.projector.project(local)
        return Seen(points, uv[..., 0], uv[..., 1], local[..., 2], shade, kind * 2 + lit)

    def _rays(self, across: int) -> Floats:
        width, height = self.camera.size
        inside = (2 * np.arange(across) + 1 - across) / (2 * across)
        v, u, row, column = np.meshgrid(
            inside, inside, np.arange(height), np.arange(width), indexing="ij", sparse=True
        )
        pixels = np.stack(np.broadcast_arrays(column + u, row + v), axis=-1)
        slopes = self.camera.normalise(pixels.reshape(across**2, height, width, 2))
        return np.concatenate([slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1)


def _first(shapes: Sequence[Shape], origin: Floats, rays: Floats) -> tuple[Floats, Floats, Floats]:
    """Length to and normal of what rays meet first, and its kind: which shape, and which face of a box."""
    length, normals, kind = np.full(rays.shape[:-1], np.inf), np.zeros(rays.shape), np.zeros(rays.shape[:-1])
    for number, shape in enumerate(shapes, start=1):
        further, facing = shape.meet(origin, rays)
        nearer = further < length
        length[nearer], normals[nearer] = further[nearer], facing[nearer]
        faces = 0.0 if isinstance(shape, Sphere) else np.round(facing[nearer] @ [1.0, 10.0, 100.0], 4)
        kind[nearer] = 1000.0 * number + faces
    return length, normals, kind
