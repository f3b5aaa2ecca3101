"""Reference marks in the camera's live image, beside where they were at the time of the characterisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.targets import Target


@dataclass(frozen=True)
class MarksInView:
    """How many points of the marks the camera sees, and by how much they have moved in its image."""

    points: int
    located: int  # at the time of the characterisation
    moved_px: float | None  # median distance; None where none are seen

    @property
    def line(self) -> str:
        moved = "" if self.moved_px is None else f", moved by {self.moved_px:.2f} px"
        return f"marks {self.points} of {self.located} points{moved}"


def marks_in_view(image: NDArray[Any], calibration: Calibration) -> MarksInView | None:
    if (marks := calibration.marks) is None:
        return None
    seen = config.validate(marks.target, Target, "the calibration's marks").detect(image)
    if seen is None:
        return MarksInView(0, len(marks.ids), None)
    common, then, now = np.intersect1d(marks.ids, seen.ids, return_indices=True)
    moved = np.linalg.norm(seen.pixels[now] - marks.camera_px[then], axis=1)
    return MarksInView(len(common), len(marks.ids), float(np.median(moved)) if len(common) else None)
