"""The arrays of a sample: names, shapes and meanings, and which are recorded, measured or true."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fpplab.patterns.plan import Plan

Arrays = dict[str, NDArray[np.generic]]  # arrays of one sample by field


@dataclass(frozen=True)
class FieldSpec:
    """Description of one array of every sample."""

    name: str  # name of the field
    source: Literal["camera", "measured", "truth"]  # "camera" is what was recorded
    dtype: str  # numPy type string; empty for the frames, whose type depends on the camera
    shape: str  # dimensions separated by spaces
    unit: str  # unit of the values
    meaning: str  # what the values are

    def extent(self, dimensions: dict[str, int]) -> tuple[int, ...]:
        return tuple(dimensions[side] if side in dimensions else int(side) for side in self.shape.split())


FRAMES = "frames"  # name of the field with the camera's images
FIELDS = (
    FieldSpec(FRAMES, "camera", "", "N h w", "raw levels", "the camera's integers, images in the plan's "
          "order"),
    FieldSpec("exposure_s", "camera", "<f8", "", "s", "exposure of every frame"),
    FieldSpec("wrapped_phase", "measured", "<f4", "S h w", "rad", "phase of each fringe set in [0, 2π), "
          "demodulated from the frames; noise alone where no fringes fall"),
    FieldSpec("decoded_u", "measured", "<f4", "h w", "projector px", "column that decoding finds; NaN "
          "where it finds none, or the plan does not code it"),
    FieldSpec("decoded_v", "measured", "<f4", "h w", "projector px", "row that decoding finds, likewise"),
    FieldSpec("decoded_sigma", "measured", "<f4", "h w", "projector px", "standard uncertainty of the "
          "first of these that is coded, NaN where invalid"),
    FieldSpec("modulation", "measured", "<f4", "h w", "levels of 255", "amplitude of the finest set of the "
          "first coded axis, NaN where invalid"),
    FieldSpec("absolute_phase", "truth", "<f4", "S h w", "rad", "phase of each fringe set at the true "
          "projector coordinate, NaN outside the mask"),
    FieldSpec("projector_u", "truth", "<f4", "h w", "projector px", "true column of what the pixel's centre "
          "sees, NaN outside the mask"),
    FieldSpec("projector_v", "truth", "<f4", "h w", "projector px", "true row, likewise"),
    FieldSpec("depth", "truth", "<f4", "h w", "mm", "z in the camera's frame, NaN where nothing is seen"),
    FieldSpec("normals", "truth", "<f4", "3 h w", "1", "unit normal x, y, z in the camera's frame, towards "
          "the camera, NaN where nothing is seen"),
    FieldSpec("mask", "truth", "|b1", "h w", "1", "the pixel's centre sees the surface, and the projector "
          "lights it"),
    FieldSpec("camera_matrix", "truth", "<f8", "3 3", "px", "the true camera"),
    FieldSpec("camera_distortion", "truth", "<f8", "8", "1", "k1 k2 p1 p2 k3 k4 k5 k6 of OpenCV"),
    FieldSpec("projector_matrix", "truth", "<f8", "3 3", "px", "the true projector"),
    FieldSpec("projector_distortion", "truth", "<f8", "8", "1", "likewise"),
    FieldSpec("T_projector_camera", "truth", "<f8", "4 4", "mm", "takes coordinates in the camera's frame "
          "to the projector's"),
)  # fmt: skip


def dimension_sizes(plan: Plan, size: tuple[int, int]) -> dict[str, int]:
    """Look up the lengths that the letters in `FieldSpec.shape` stand for."""
    # size (int, int)
    return {"N": plan.images, "S": len(plan.fringes), "h": size[1], "w": size[0]}
