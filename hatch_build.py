"""Gives `drivers` and `sim` names of fpplab's own in wheels; docs/decisions says why.

`drivers/basler/camera.py` of the checkout is `fpplab_drivers/basler/camera.py` in a wheel. Only import
statements and entry points are changed, in the wheel that has been built.
"""

import ast
import base64
import csv
import hashlib
import io
import re
import zipfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

RENAMED = ("drivers", "sim")
"""Packages of the checkout that are called `fpplab_…` in wheels."""
PREFIX = "fpplab_"
_NAMES = "|".join(RENAMED)
_IMPORT = re.compile(rf"^(\s*from )({_NAMES})(?=[.\s])", re.MULTILINE)
_ENTRY = re.compile(rf"^([\w-]+ = )({_NAMES})(?=[.:])", re.MULTILINE)


class WheelNames(BuildHookInterface[Any]):
    """Rewrites a wheel once it is built; editable installs lead to the checkout and are left as they are."""

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Rename the packages in the wheel."""
        if version == "standard":
            rename_packages(Path(artifact_path))


def rename_packages(wheel: Path) -> None:
    """Rename the packages of `RENAMED` in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        files = [(entry, archive.read(entry)) for entry in archive.infolist()]
    record: list[tuple[str, str, str]] = []
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, content in files:
            entry.filename = renamed_path(entry.filename)
            if entry.filename.endswith(".dist-info/RECORD"):
                record.append((entry.filename, "", ""))
                written = _as_csv(record)
            else:
                written = renamed_content(entry.filename, content)
                digest = base64.urlsafe_b64encode(hashlib.sha256(written).digest()).rstrip(b"=").decode()
                record.append((entry.filename, f"sha256={digest}", str(len(written))))
            archive.writestr(entry, written, zipfile.ZIP_DEFLATED)


def renamed_path(path: str) -> str:
    """Tell where a file of the checkout is in the wheel."""
    return PREFIX + path if path.partition("/")[0] in RENAMED else path


def renamed_content(path: str, content: bytes) -> bytes:
    """Change import statements and entry points."""
    if path.endswith(".dist-info/entry_points.txt"):
        return _ENTRY.sub(rf"\1{PREFIX}\2", content.decode("utf-8")).encode("utf-8")
    if not path.endswith(".py"):
        return content
    text = _IMPORT.sub(rf"\1{PREFIX}\2", content.decode("utf-8"))
    for node in ast.walk(ast.parse(text)):
        named = [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
        named += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for name in named:
            if name.partition(".")[0] in RENAMED:
                raise ValueError(f"{path}: imports {name}; write 'from {name} import ...'")
    return text.encode("utf-8")


def _as_csv(record: list[tuple[str, str, str]]) -> bytes:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(record)
    return stream.getvalue().encode("utf-8")
