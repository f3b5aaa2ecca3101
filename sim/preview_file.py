"""What the Blender extension needs to know of a rig, and its file: an NPZ archive without pickled objects.

The extension has this file too, so it needs nothing but NumPy.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, is_dataclass
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .scene import (
    Aperture,
    BaseLayer,
    Grain,
    GreyScale,
    Lamp,
    Paint,
    PatternRender,
    PinholeOptics,
    PointLamp,
    Relief,
    RenderScene,
    RenderSettings,
    SubpixelView,
    Surface,
)

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, eq=False)
class Preview:
    """A rig with one item before it and one pattern on show."""

    rig: str  # the rig's name
    shown: str  # item and pattern, in words
    render: PatternRender  # what the camera sees
    grey_scale: GreyScale  # of the camera's frames at the exposure asked for


_TREE = "tree"
_CLASSES = {
    kind.__name__: kind
    for kind in (
        *(Preview, PatternRender, GreyScale, RenderScene, PinholeOptics, Aperture, Lamp, Surface, Paint),
        *(BaseLayer, Relief, Grain, SubpixelView, RenderSettings, PointLamp),
    )
}


def write_preview(preview: Preview, stream: IO[bytes]) -> None:
    arrays: dict[str, NDArray[Any]] = {}
    tree = json.dumps(_to_plain_value(preview, arrays))
    np.savez(stream, **{_TREE: np.array(tree)}, **arrays)


def read_preview(path: Path | str) -> Preview:
    with np.load(path, allow_pickle=False) as archive:
        if _TREE not in archive:
            raise ValueError(f"{path} describes no rig")
        preview = _restore_value(json.loads(str(archive[_TREE])), archive)
    if not isinstance(preview, Preview):
        raise ValueError(f"{path} describes no rig")
    return preview


def _to_plain_value(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    if isinstance(value, np.ndarray):
        name = f"array_{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    if is_dataclass(value):
        parts = {field.name: _to_plain_value(getattr(value, field.name), arrays) for field in fields(value)}
        return {"class": type(value).__name__, "parts": parts}
    if isinstance(value, tuple):
        return [_to_plain_value(part, arrays) for part in value]
    return value.item() if isinstance(value, np.generic) else value


def _restore_value(value: Any, arrays: Any) -> Any:
    if isinstance(value, list):
        return tuple(_restore_value(part, arrays) for part in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[value["array"]]
    parts = {name: _restore_value(part, arrays) for name, part in value["parts"].items()}
    return _CLASSES[value["class"]](**parts)
