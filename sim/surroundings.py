"""The surroundings of a world as a surface, and the files that hold them."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from trimesh.exchange.ply import export_ply

from fpplab.clouds import load_mesh
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError, FppError
from fpplab.core.files import write_atomic
from fpplab.core.geometry import Pinhole
from fpplab.sessions.image_files import grey_images, places_in
from sim.appearance import BenchSurroundings
from sim.scene import Paint, Surface
from sim.world import SurroundingsSection, World


def surroundings_surfaces(world: World) -> tuple[Surface, ...]:
    """Make the surface of a world's surroundings, where it has any."""
    section = world.surroundings
    if section is None:
        return ()
    vertices, faces = _read_mesh_cached(Path(section.mesh), _changed_ns(section.mesh))
    picture = _read_picture_cached(Path(section.picture), _changed_ns(section.picture))
    return (_surface(vertices, faces, picture, section.reflectance, world.camera_model()),)


def _surface(
    vertices: Floats, faces: NDArray[np.int64], picture: NDArray[np.uint8], white: float, camera: Pinhole
) -> Surface:
    uv = np.asarray((camera.project(vertices) + 0.5) / np.array(camera.size))
    # Light that comes to the items by way of the surroundings, or past them, is a lamp of the room in a twin.
    return Surface(vertices, faces, np.eye(4), Paint(white), picture, uv, shades_room=False)


def _reflectance_picture(surroundings: BenchSurroundings) -> tuple[NDArray[np.uint8], float]:
    white = max(float(surroundings.reflectance.max()), 1e-3)  # below it surroundings are black
    return np.rint(surroundings.reflectance * np.float32(255 / white)).astype(np.uint8), white


def save_surroundings(surroundings: BenchSurroundings, folder: Path) -> SurroundingsSection:
    mesh, picture = (folder.resolve() / f"surroundings{suffix}" for suffix in (".ply", ".png"))
    grey, white = _reflectance_picture(surroundings)
    content = export_ply(surroundings.mesh)
    write_atomic(mesh, lambda stream: stream.write(content))
    write_atomic(picture, lambda stream: Pillow.fromarray(grey).save(stream, "PNG"))
    return SurroundingsSection(mesh=str(mesh), picture=str(picture), reflectance=white)


def _changed_ns(name: str) -> int:
    path = Path(name)
    return path.stat().st_mtime_ns if path.is_file() else 0


@lru_cache(maxsize=4)
def _read_mesh_cached(path: Path, changed_ns: int) -> tuple[Floats, NDArray[np.int64]]:
    try:
        mesh = load_mesh(path)
    except FppError as error:
        raise ConfigError(f"world: 'surroundings.mesh': {error}") from error
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    if vertices[:, 2].min() <= 0:
        raise ConfigError(
            f"world: 'surroundings.mesh': {path} has a corner with z = {vertices[:, 2].min():g} mm: must be "
            "before the camera, z > 0"
        )
    return vertices, faces


@lru_cache(maxsize=4)
def _read_picture_cached(path: Path, changed_ns: int) -> NDArray[np.uint8]:
    try:
        pictures = list(grey_images(places_in(path)))
    except (FppError, OSError) as error:
        raise ConfigError(f"world: 'surroundings.picture': {error}") from error
    if len(pictures) != 1 or pictures[0][1].dtype != np.uint8:
        raise ConfigError(f"world: 'surroundings.picture': {path} must be one grey image of 8 bits")
    return np.asarray(pictures[0][1], np.uint8)
