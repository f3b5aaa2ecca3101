"""A picture of the pose that is asked for: the board's outline to match, over what the camera saw last."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation.guide import WantedPose
from fpplab.characterisation.parameters import ImageSize
from fpplab.core.files import write_parts

PICTURE = "next_pose.png"
"""Name of the picture, beside the poses."""

WIDTH = 960
"""Width of the picture in px."""

SHIFT = 4
"""Binary places of the coordinates that are drawn."""

OUTLINE, TOP, INK = (60, 200, 255), (70, 110, 255), (255, 255, 255)
"""Colours of the outline, of the board's upper edge, and of words: blue, green, red."""


def write_sketch(path: Path, wanted: WantedPose, size: ImageSize, seen: NDArray[Any] | None = None) -> None:
    """Draw a pose."""
    # size (width, height) px; seen (height, width)
    scale = WIDTH / size[0]
    picture = np.full((round(scale * size[1]), WIDTH, 3), 40, np.uint8)
    if seen is not None:
        grey = cv2.resize(np.asarray(seen, np.float32), (WIDTH, len(picture)), interpolation=cv2.INTER_AREA)
        grey = np.clip(0.6 * 255 * grey / max(float(np.percentile(grey, 99.5)), 1e-9), 0, 255)
        picture[:] = grey.astype(np.uint8)[..., None]
    if wanted.outline_px is not None:
        _draw_outline(picture, scale * (wanted.outline_px + 0.5))
    _draw_words(picture, wanted.description)
    done, encoded = cv2.imencode(".png", picture)
    assert done
    write_parts(path, encoded.tobytes())


def _draw_outline(picture: NDArray[Any], outline: NDArray[Any]) -> None:
    fine = np.rint(2**SHIFT * outline).astype(np.int32)
    cv2.polylines(picture, [fine], True, OUTLINE, 2, cv2.LINE_AA, SHIFT)
    quarter = len(fine) // 4
    cv2.polylines(picture, [fine[: quarter + 1]], False, TOP, 4, cv2.LINE_AA, SHIFT)
    middle = outline[quarter // 2]
    cv2.putText(picture, "upper edge", (int(middle[0]) - 45, int(middle[1]) - 10), cv2.FONT_HERSHEY_SIMPLEX,
                0.5, TOP, 1, cv2.LINE_AA)  # fmt: skip


def _draw_words(picture: NDArray[Any], words: str) -> None:
    """Write the clauses at the lower edge, one in each line."""
    clauses = words.split(", ")
    for k, clause in enumerate(clauses):
        place = (12, len(picture) - 12 - 22 * (len(clauses) - 1 - k))
        cv2.putText(picture, clause, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 4, cv2.LINE_AA)
        cv2.putText(picture, clause, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, INK, 1, cv2.LINE_AA)
