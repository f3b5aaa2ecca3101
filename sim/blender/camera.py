"""The camera: Brown-Conrady distortion per ray, and every sub-pixel where it is asked for."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path
from typing import Any

import _cycles
import bpy
from mathutils import Matrix

from sim.scene import Optics

SOURCE = Path(__file__).with_name("camera.osl")


def compile_shader() -> str:
    """The camera shader's byte code. The operator that Blender has for it needs a module the wheel lacks."""
    with tempfile.TemporaryDirectory() as folder:
        compiled = Path(folder) / "camera.oso"
        if not _cycles.osl_compile(str(SOURCE), str(compiled)):
            raise RuntimeError(f"{SOURCE.name} does not compile")
        return compiled.read_text()


def add_camera(scene: Any, optics: Optics, bytecode: str) -> Any:
    """A camera at the origin that looks along +z with y down, as OpenCV's does."""
    data = bpy.data.cameras.new("camera")
    data.type, data.custom_mode = "CUSTOM", "INTERNAL"
    data.custom_bytecode = bytecode
    data.custom_bytecode_hash = hashlib.md5(bytecode.encode()).hexdigest()
    data.clip_start, data.clip_end = 1.0, 1e5
    item = bpy.data.objects.new("camera", data)
    item.matrix_world = Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))
    scene.collection.objects.link(item)
    scene.camera = item
    scene.render.resolution_x, scene.render.resolution_y = optics.size
    k = optics.matrix
    values = (*optics.size, k[0, 0], k[1, 1], k[0, 2], k[1, 2], *optics.distortion, 0.0, 0.0)
    names = ("width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "shift_u", "shift_v")
    for name, value in zip(names, values, strict=True):
        data.cycles_custom[name] = float(value)
    return data


def aim(camera: Any, shift: tuple[float, float]) -> None:
    """Look through the point of every pixel that lies `shift` (u, v) px from its centre."""
    camera.cycles_custom["shift_u"], camera.cycles_custom["shift_v"] = map(float, shift)
    camera.update_tag()
