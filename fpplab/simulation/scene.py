"""One scene that a simulation can arrange: an item, its paint, its light and its noise."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from fpplab.calibration.model import PoseFile
from fpplab.core.config import Document


class DatasetScene(Document):
    """One scene, as drawn: an artefact with its lengths in mm, or the board of a target file; its pose
    T_camera_item; the rest as in `Scenes`. seed: of its noise.
    """

    seed: int
    artefact: str | None = None
    sizes: Annotated[dict[str, float | tuple[float, ...]], Field(default_factory=dict)]
    target: str | None = None
    pose: PoseFile
    reflectance: float
    ink: float
    roughness: float
    gloss: float
    gloss_roughness: float
    ambient: float
    charge: float
    read_noise_e: float
    exposure_s: float
    projector_blur: float
    projector_focus_mm: float
    stage_mm: float
