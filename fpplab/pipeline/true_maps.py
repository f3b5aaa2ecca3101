"""Ground truth at the centre of every pixel, from the shapes and device models; nothing here is measured."""

from dataclasses import dataclass

import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Floats, Map, Mask
from fpplab.reconstruction.triangulation import camera_rays

GRAZING = 0.01
"""Cosine of incidence below which a surface counts as unseen.

Rays are traced in single precision, and their intersection with a surface that they nearly graze is
uncertain.
"""


@dataclass(frozen=True, eq=False)
class TrueMaps:
    """What the camera truly sees, (height, width) and float32 unless stated otherwise."""

    depth: Map  # coordinate z in mm in the camera's frame, NaN where nothing is seen
    normals: Map  # unit normals (3, height, width) of the mesh's facets, towards the camera
    mask: Mask  # whether the surface is seen and illuminated by the projector, shadows considered; bool
    u: Map  # projector column in px of what is seen, NaN outside the mask
    v: Map  # projector row in px of what is seen, NaN outside the mask


def trace_true_maps(mesh: trimesh.Trimesh, devices: Calibration) -> TrueMaps:
    """Trace the ray of every pixel's centre to the true surface, and from there to the projector's lens."""
    shape = RayTracedShape(mesh)
    rays = camera_rays(devices.camera)
    size, rays = rays.shape[:2], rays.reshape(-1, 3)
    faces = shape.first_face(np.zeros(3), rays)
    pixels = np.flatnonzero(faces >= 0)
    met, rays = faces[pixels], rays[pixels]
    normals = shape.normals[met]
    towards = -np.einsum("ij,ij->i", normals, rays)
    if not mesh.is_watertight:  # a plate has no inside: its normals point to the viewer
        normals, towards = np.sign(towards)[:, None] * normals, np.abs(towards)
    plain = towards > GRAZING * np.linalg.norm(rays, axis=1)
    pixels, met, rays, normals, towards = (values[plain] for values in (pixels, met, rays, normals, towards))
    # The face is found in single precision; the intersection with it is computed in double.
    depth = -np.einsum("ij,ij->i", normals, shape.triangles[met, 0]) / towards
    points = depth[:, None] * rays
    lit = _select_lit_points(devices, shape, points, normals)
    coordinates = devices.projector.project(points[lit], devices.T_projector_camera)
    mask = np.zeros(size, np.bool_)
    mask.flat[pixels[lit]] = True
    return TrueMaps(
        depth=_map_of_values(size, pixels, depth),
        normals=np.stack([_map_of_values(size, pixels, normals[:, axis]) for axis in range(3)]),
        mask=mask,
        u=_map_of_values(size, pixels[lit], coordinates[:, 0]),
        v=_map_of_values(size, pixels[lit], coordinates[:, 1]),
    )


def _select_lit_points(devices: Calibration, shape: RayTracedShape, points: Floats, normals: Floats) -> Mask:
    lamp = devices.projector_centre
    facing = np.einsum("ij,ij->i", normals, lamp - points) > 0
    reached = devices.projector.sees(points, devices.T_projector_camera) & shape.unoccluded(lamp, points)
    return np.asarray(facing & reached)


def _map_of_values(
    size: tuple[int, ...], pixels: np.ndarray[tuple[int, ...], np.dtype[np.int64]], values: Floats
) -> Map:
    filled = np.full(size, np.nan, np.float32)
    filled.flat[pixels] = values
    return filled
