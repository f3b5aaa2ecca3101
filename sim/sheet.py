"""What a bench shows beyond its numbers, as surfaces and files: the sheet of its board, its surroundings."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
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
from fpplab.targets import Target
from sim.appearance import BenchSurroundings, BoardSheet
from sim.scene import Paint, Surface
from sim.world import BoardItem, SurroundingsSection, World

EVEN = 128
"""Grey level of a texture where the reflectance is that of the print (chosen: the middle of 8 bits)."""
TEXTURE = "board_texture.png"


def save_sheet(sheet: BoardSheet, folder: Path) -> dict[str, Any]:
    fields: dict[str, Any] = {
        "margins_mm": sheet.margins_mm,
        "rim_mm": sheet.rim_mm,
        "rim_reflectance": sheet.rim_reflectance,
        "texture": None,
    }
    if sheet.texture is not None:
        grey = np.clip(np.rint(sheet.texture * np.float32(EVEN)), 0, 255).astype(np.uint8)
        path = folder.resolve() / TEXTURE
        write_atomic(path, lambda stream: Pillow.fromarray(grey).save(stream, "PNG"))
        fields["texture"] = str(path)
    return fields


def board_relative_to(board: BoardItem, folder: Path) -> BoardItem:
    """Make the name of a texture relative that lies in a folder."""
    if board.texture is None or Path(board.texture).parent != folder.resolve():
        return board
    return board.model_copy(update={"texture": Path(board.texture).name})


def sheet_corners(size_mm: tuple[float, float], margins_mm: tuple[float, float, float, float]) -> Floats:
    """List the corners of a sheet, whose target is centred at the origin."""
    # size_mm (width, height); returns (4, 3) mm
    left, top, right, bottom = margins_mm
    x, y = 0.5 * size_mm[0], 0.5 * size_mm[1]
    low, high = (-x - left, -y - top), (x + right, y + bottom)
    return np.array([[*low, 0], [high[0], low[1], 0], [*high, 0], [low[0], high[1], 0]])


def drawn_sheet(
    ground: NDArray[np.uint8],
    target: Target,
    margins_mm: tuple[float, float, float, float],
    texture: str | None,
) -> tuple[NDArray[np.uint8], float]:
    key = (ground.shape, target, margins_mm, texture, texture and _changed_ns(texture))
    if key not in _DRAWN:
        if len(_DRAWN) >= 16:
            _DRAWN.clear()
        _DRAWN[key] = _draw(ground, target, margins_mm, texture)
    return _DRAWN[key]


_DRAWN: dict[Any, tuple[NDArray[np.uint8], float]] = {}


def _draw(
    ground: NDArray[np.uint8],
    target: Target,
    margins_mm: tuple[float, float, float, float],
    texture: str | None,
) -> tuple[NDArray[np.uint8], float]:
    across, down = np.array(ground.shape[::-1]) / np.array(target.size_mm)
    left, top, right, bottom = margins_mm
    vertical = (round(top * down), round(bottom * down))
    horizontal = (round(left * across), round(right * across))
    wide = np.pad(ground, (vertical, horizontal), constant_values=255)
    paper, ink = target.background, target.foreground
    reflectance = np.float32(ink) + np.float32((paper - ink) / 255) * wide
    if texture is not None:
        factor = _read_grey_image(Path(texture)) / np.float32(EVEN)
        reflectance *= cv2.resize(factor, wide.shape[::-1], interpolation=cv2.INTER_LINEAR)
    reflectance = np.minimum(reflectance, 1.0)
    white = float(reflectance.max())
    return np.rint(reflectance * np.float32(255 / white)).astype(np.uint8), white


def _changed_ns(name: str) -> int:
    path = Path(name)
    return path.stat().st_mtime_ns if path.is_file() else 0


def _read_grey_image(path: Path) -> NDArray[np.uint8]:
    try:
        pictures = list(grey_images(places_in(path)))
    except (FppError, OSError) as error:
        raise ConfigError(str(error)) from error
    if len(pictures) != 1 or pictures[0][1].dtype != np.uint8:
        raise ConfigError(f"{path} must be one grey image of 8 bits")
    return np.asarray(pictures[0][1], np.uint8)


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
        return _read_grey_image(path)
    except ConfigError as error:
        raise ConfigError(f"world: 'surroundings.picture': {error}") from error
