"""The camera: distortion and aperture for every ray, through any point of the pixels and of the lens."""

import hashlib
import tempfile
from pathlib import Path
from typing import Any

import _cycles
import bpy
from mathutils import Matrix

from ..scene import Aperture, PinholeOptics, RenderRefused, SubpixelView

SOURCE = Path(__file__).with_name("camera.osl")  # the camera shader


def compile_shader() -> str:
    """Compile the camera shader; Blender's own operator for it needs a module that the wheel lacks."""
    with tempfile.TemporaryDirectory() as folder:
        compiled = Path(folder) / "camera.oso"
        if not _cycles.osl_compile(str(SOURCE), str(compiled)):
            raise RuntimeError(f"{SOURCE.name} does not compile")
        return compiled.read_text(encoding="utf-8")


def add_camera(scene: Any, optics: PinholeOptics, aperture: Aperture, bytecode: str | None) -> Any:
    """Add a camera at the origin that looks along +z with y down, as OpenCV's does."""
    data = bpy.data.cameras.new("camera")
    data.clip_start, data.clip_end = 1.0, 1e5
    item = bpy.data.objects.new("camera", data)
    item.matrix_world = Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))
    scene.collection.objects.link(item)
    scene.camera = item
    scene.render.resolution_x, scene.render.resolution_y = optics.size
    if bytecode is None:
        _set_pinhole_camera(data, optics, aperture)
    else:
        _set_ray_camera(data, optics, aperture, bytecode)
    return data


def aim(camera: Any, optics: PinholeOptics, view: SubpixelView) -> None:
    """Make the camera look through one point of every pixel and of the lens."""
    if camera.type == "CUSTOM":
        values = dict(zip(("shift_u", "shift_v", "lens_x", "lens_y"), (*view.shift, *view.lens), strict=True))
        for name, value in values.items():
            camera.cycles_custom[name] = float(value)
    else:
        (width, height), k, largest = optics.size, optics.matrix, max(optics.size)
        # Blender counts from the image's middle, in units of its longer side, y upwards.
        camera.shift_x = ((width - 1) / 2 - k[0, 2] + view.shift[0]) / largest
        camera.shift_y = (k[1, 2] - (height - 1) / 2 - view.shift[1]) / largest
    camera.update_tag()


def _set_ray_camera(data: Any, optics: PinholeOptics, aperture: Aperture, bytecode: str) -> None:
    data.type, data.custom_mode = "CUSTOM", "INTERNAL"
    data.custom_bytecode = bytecode
    data.custom_bytecode_hash = hashlib.md5(bytecode.encode()).hexdigest()
    k = optics.matrix
    lens = (aperture.diameter_mm / 2, aperture.focus_mm)
    values = (*optics.size, k[0, 0], k[1, 1], k[0, 2], k[1, 2], *optics.distortion, *lens, *[0.0] * 4)
    for name, value in zip(_PARAMETERS, values, strict=True):
        data.cycles_custom[name] = float(value)


_PARAMETERS = (
    *("width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    *("radius", "focus", "shift_u", "shift_v", "lens_x", "lens_y"),
)


def _set_pinhole_camera(data: Any, optics: PinholeOptics, aperture: Aperture) -> None:
    if optics.distortion.any() or aperture.diameter_mm:
        raise RenderRefused(
            "distortion and depth of field need a camera that runs on CPU and OPTIX alone; "
            "choose one of them as 'render.device', or set distortion to zeros and leave out focus_mm"
        )
    data.type, data.sensor_fit = "PERSP", "AUTO"
    data.sensor_width = data.sensor_height = 32.0
    data.lens = 32.0 * float(optics.matrix[0, 0]) / max(optics.size)
