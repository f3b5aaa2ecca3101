"""Install the extension in Blender, operate it as an operator would, and disable it; see test_extension.py.

Arguments: the archive, the Python that has fpplab, the folder for results, a rig file, and names of `PARTS`
to do. Writes `told.json` with what was seen, and what differs from before once the extension is disabled.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np

ADDON = "bl_ext.user_default.fpplab"


def left() -> dict[str, list[str]]:
    """Everything that an extension could leave behind; its modules stay loaded, as those of any."""
    kinds = [p.identifier for p in bpy.data.bl_rna.properties if p.type == "COLLECTION"]
    found = {kind: sorted(one.name for one in getattr(bpy.data, kind)) for kind in kinds}
    found["types"] = sorted(name for name in dir(bpy.types) if "fpplab" in name.lower())
    found["window manager"] = [key for key in bpy.context.window_manager.keys() if "fpplab" in key]  # noqa: SIM118
    found["operators"] = dir(bpy.ops.fpplab)
    found["handlers"] = [name for name in dir(bpy.app.handlers) if getattr(bpy.app.handlers, name)]
    found["temporary files"] = sorted(p.name for p in Path(tempfile.gettempdir()).rglob("*"))
    found["scene"] = [bpy.context.window.scene.name]
    return found


def refused(operator: Any) -> str:
    """The sentence that an operator refuses with."""
    try:
        operator()
    except RuntimeError as error:
        return str(error).strip()
    raise AssertionError("not refused")


def name_interpreter(path: str) -> None:
    bpy.context.preferences.addons[ADDON].preferences.interpreter = path


def choose(**values: Any) -> None:
    for name, value in values.items():
        setattr(bpy.context.window_manager.fpplab, name, value)


def pixels_of(image: Any) -> np.ndarray[Any, Any]:
    columns, rows = image.size
    values = np.empty(rows * columns * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(rows, columns, 4)[::-1]


def demonstration(out: Path) -> dict[str, Any]:
    """Show the demonstration, and take its picture twice, at another baseline and step the second time."""
    told: dict[str, Any] = {"without interpreter": refused(bpy.ops.fpplab.show_rig)}
    name_interpreter("/no/such/python")
    told["wrong interpreter"] = refused(bpy.ops.fpplab.show_rig)
    name_interpreter(sys.argv[2])
    choose(rig="rig_demo_quick", item="cube")
    told["wrong item"] = refused(bpy.ops.fpplab.show_rig)
    told["picture before"] = bpy.ops.fpplab.take_picture.poll()
    choose(item="", stripes=20.0, steps=4, step=1, picture=str(out / "first.png"))
    bpy.ops.fpplab.show_rig()
    bpy.ops.fpplab.take_picture()
    choose(baseline=165.0, step=2, picture=str(out / "second.png"))
    bpy.ops.fpplab.show_rig()
    told["objects"] = sorted(one.name for one in bpy.context.window.scene.objects)
    bpy.ops.fpplab.take_picture()
    return told


def viewed(path: Path) -> dict[str, Any]:
    """Render as the rendered view does, to look at."""
    scene = bpy.context.window.scene
    scene.render.resolution_percentage, scene.cycles.samples = 50, 4
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return {"rendered": path.is_file()}


def measurement(out: Path) -> dict[str, Any]:
    """Record a scan on the small rig and import its cloud with errors."""
    choose(rig=sys.argv[4], item="pillars", stripes=32.0, steps=4, step=0, baseline=0.0, picture="")
    name_interpreter(sys.argv[2])
    told: dict[str, Any] = {"no session": refused(bpy.ops.fpplab.record_scan)}
    choose(session=str(out / "session"))
    bpy.ops.fpplab.show_rig()
    bpy.ops.fpplab.record_scan()
    choose(truth=str(out / "pillars.stl"))
    bpy.ops.fpplab.import_errors()
    cloud = next(one for one in bpy.context.window.scene.objects if one.get("fpplab") == "cloud")
    points = np.array([vertex.co for vertex in cloud.data.vertices])
    colours = np.array([entry.color for entry in cloud.data.attributes["Col"].data])
    np.savez(out / "cloud.npz", points=points, colours=colours, matrix=np.array(cloud.matrix_world))
    bpy.ops.fpplab.take_picture()
    np.save(out / "third.npy", pixels_of(bpy.data.images["fpplab picture"])[..., 0])
    return told | viewed(out / "cloud.png")


def matching(out: Path) -> dict[str, Any]:
    """Fit a twin to recordings that the command line has made, and show it."""
    name_interpreter(sys.argv[2])
    choose(
        rig=str(out / "nominal.yaml"),
        reference=str(out / "board"),
        matched=str(out / "matched"),
        epochs=2,
        item="board",
    )
    bpy.ops.fpplab.fit_twin()
    found = bpy.context.window_manager.fpplab.rig
    choose(pose=0)
    bpy.ops.fpplab.show_rig()
    return {"matched": found}


PARTS = {part.__name__: part for part in (demonstration, measurement, matching)}


def main() -> None:
    out = Path(sys.argv[3])
    bpy.ops.wm.read_factory_settings()
    before = left()
    bpy.ops.extensions.package_install_files(
        filepath=sys.argv[1], repo="user_default", enable_on_install=True
    )
    told: dict[str, Any] = {"enabled": ADDON in bpy.context.preferences.addons}
    for name in sys.argv[5:]:
        told |= PARTS[name](out)
    told["added"] = {kind: list(set(now) - set(before[kind])) for kind, now in left().items()}
    bpy.ops.preferences.addon_disable(module=ADDON)
    after = left()
    told["differs"] = {kind: [before[kind], after[kind]] for kind in before if before[kind] != after[kind]}
    (out / "told.json").write_text(json.dumps(told))


if __name__ == "__main__":
    main()
