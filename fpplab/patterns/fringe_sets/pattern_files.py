"""Pattern images from files, whatever they show along one axis."""

from __future__ import annotations

import base64
import binascii
import zlib
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.files import no_such_file, read_bounded
from fpplab.patterns.fringe_sets.base import CodeSet

MAX_LENGTH = 8192  # most pixels along an axis (chosen: twice those of the largest projectors)
MAX_FILE_BYTES = 64_000_000  # greatest size of a pattern file (chosen: 16 bits of 32 megapixels)


class PatternFiles(CodeSet):
    """Images of one's own, of 8-bit grey levels that change along the axis alone, such as random stripes.

    `names` are paths from the plan file; loading the plan adds their levels, so that a session's plan
    records what was shown.
    """

    kind: Literal["files"] = "files"
    """`files`."""

    names: Annotated[tuple[str, ...], Field(min_length=1, max_length=1000)]
    """The image files, in the order they are shown."""

    levels: Annotated[tuple[str, ...], Field(min_length=1, max_length=1000)]
    """Grey levels of each image along the axis, compressed: loading a plan writes them, nobody else."""

    @field_validator("levels")
    @classmethod
    def _can_be_read(cls, levels: tuple[str, ...]) -> tuple[str, ...]:
        for text in levels:
            _unpacked(text)
        return levels

    @model_validator(mode="after")
    def _as_many(self) -> PatternFiles:
        if len(self.names) != len(self.levels):
            raise ValueError(f"'levels' are of {len(self.levels)} images and 'names' of {len(self.names)}")
        return self

    @classmethod
    def completed(cls, entry: dict[str, Any], folder: Path) -> dict[str, Any]:
        """Put the levels of the files into an entry of a plan file that has none."""
        names = entry.get("names")
        if "levels" in entry or not isinstance(names, list) or not all(isinstance(n, str) for n in names):
            return entry
        axis = entry.get("axis")
        return {**entry, "levels": [_packed(_profile(folder / name, str(axis))) for name in names]}

    @property
    def images(self) -> int:
        return len(self.levels)

    def light(self, step: int, coordinate: Floats, length: int) -> Floats:
        """Give the level of the pixel at each coordinate."""
        levels = _unpacked(self.levels[step])
        pixel = np.floor(np.asarray(coordinate) + 0.5).astype(np.int64)
        return np.asarray(levels[np.clip(pixel, 0, len(levels) - 1)] / 255.0)

    @property
    def short_name(self) -> str:
        return "files"

    def fault(self, length: int) -> str | None:
        """Refuse images of another projector."""
        for name, text in zip(self.names, self.levels, strict=True):
            if (pixels := len(_unpacked(text))) != length:
                return f"names': {name} has {pixels} pixels along {self.axis}; the projector has {length}"
        return None


def _profile(path: Path, axis: str) -> NDArray[np.uint8]:
    """Read the levels of an image along one axis."""
    try:
        content = np.frombuffer(read_bounded(path, MAX_FILE_BYTES), np.uint8)
    except FileNotFoundError:
        raise ConfigError(no_such_file(path)) from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    if image is None or image.dtype != np.uint8:
        raise ConfigError(f"{path}: is no image of 8-bit grey levels, as a projector shows them")
    if image.ndim == 3:
        if (image != image[..., :1]).any():
            raise ConfigError(f"{path}: is coloured; patterns are grey")
        image = image[..., 0]
    first = image[:1] if axis == "x" else image[:, :1]
    if (image != first).any():
        raise ConfigError(
            f"{path}: changes across its axis {axis} too; a code changes along one axis alone: use images of "
            "stripes, one set for each axis"
        )
    return np.asarray(first.ravel(), np.uint8)


def _packed(levels: NDArray[np.uint8]) -> str:
    return base64.b64encode(zlib.compress(levels.tobytes(), 9)).decode("ascii")


def _unpacked(text: str) -> NDArray[np.uint8]:
    try:
        content = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), MAX_LENGTH)
    except (binascii.Error, zlib.error, ValueError):
        raise ValueError("is not what loading a plan writes") from None
    return np.frombuffer(content, np.uint8)
