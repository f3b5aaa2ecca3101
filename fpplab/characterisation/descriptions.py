"""Other descriptions of a board that are easily confused, to name the mistake when it is not detected."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.targets import Target
from fpplab.targets.views import stretch_to_8_bits


def explain_board_mismatch(image: NDArray[Any], target: Target) -> str | None:
    """Find the mistake in a board's description by detecting it under another."""
    # image (height, width)
    for description, other in similar_descriptions(target):
        if other.detect(image) is not None:
            return f"but it is there {description}"
    inverted = target.model_copy(update={"foreground": target.background, "background": target.foreground})
    if inverted.detect(image) is not None:
        return (
            "but it is there with foreground and background exchanged: 'foreground' should be "
            f"{inverted.foreground:g} and 'background' {inverted.background:g}"
        )
    if misprint := target.layout.misprint(stretch_to_8_bits(np.asarray(image, np.float64))):
        return f"but it is there {misprint}"
    if target.layout.shows_mirroring and target.detect(np.ascontiguousarray(image[:, ::-1])) is not None:
        return "but its mirror image is; the print, or the camera's picture, is mirrored"
    return None


def similar_descriptions(target: Target) -> Iterator[tuple[str, Target]]:
    """List descriptions that are easily confused with this one."""
    (columns, rows), (x, y) = target.counts, target.spacing_mm

    def other(**changes: Any) -> Target:
        # A board large enough for any of them; its size is not used here.
        return target.model_copy(update={"size_mm": (1e4, 1e4), **changes})

    for description, changes in target.layout.confusable():
        yield description, other(**changes)
    if columns != rows:
        yield (
            f"with rows and columns exchanged: 'counts' should be [{rows}, {columns}]",
            other(counts=(rows, columns)),
        )
    if x != y:
        yield (
            f"with the pitches exchanged: 'spacing_mm' should be [{y:g}, {x:g}]",
            other(spacing_mm=(y, x)),
        )
        yield (
            f"with rows and columns exchanged: 'counts' should be [{rows}, {columns}] "
            f"and 'spacing_mm' [{y:g}, {x:g}]",
            other(counts=(rows, columns), spacing_mm=(y, x)),
        )
