"""The archive of the Blender extension: files of this package, laid out as they are here.

Its modules import each other by relative names, which hold in the archive too.
"""

import zipfile
from pathlib import Path
from typing import BinaryIO

PACKAGE = Path(__file__).parent
EXTENSION = PACKAGE / "blender" / "extension"

NAME = "sim"  # what the package is called in the archive, whatever it is called where it was installed

MANIFEST = "blender_manifest.toml"

SHARED = (
    "__init__.py",
    "scene.py",
    "preview_file.py",
    *(f"blender/{name}.py" for name in ("__init__", "building", "camera", "images", "materials", "nodes")),
    *("blender/camera.osl", "blender/projector.py", "blender/preview.py"),
)
"""What the extension has in common with the twin."""

ENTRY = """from .sim.blender.extension import register, unregister

__all__ = ["register", "unregister"]
"""
"""The archive's own module, which Blender loads."""

_EPOCH = (2020, 1, 1, 0, 0, 0)


def archive_files() -> dict[str, bytes]:
    own = sorted(EXTENSION.glob("*.py"))
    files = [*(PACKAGE / name for name in SHARED), *own]
    placed = {f"{NAME}/{path.relative_to(PACKAGE).as_posix()}": path.read_bytes() for path in files}
    return {MANIFEST: (EXTENSION / MANIFEST).read_bytes(), "__init__.py": ENTRY.encode(), **placed}


def write_extension(stream: BinaryIO) -> None:
    """Write the archive that Blender installs; the same files give the same bytes."""
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in archive_files().items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), content, zipfile.ZIP_DEFLATED)
