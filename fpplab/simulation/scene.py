"""One scene that a simulation can arrange: an item with its pose, paint, light and noise."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from fpplab.calibration.model import PoseFile
from fpplab.core.config import Document


class DatasetScene(Document):
    """One scene as drawn: an artefact, or the board of a target file, with its paint, light and noise."""

    seed: int
    """Of the scene's noise."""
    artefact: str | None = None
    """Kind of the artefact; None for a board."""
    sizes: Annotated[dict[str, float | tuple[float, ...]], Field(default_factory=dict)]
    """Lengths of the artefact in mm, by name."""
    target: str | None = None
    """Target file of the board; None for an artefact."""
    pose: PoseFile
    """T_camera_item."""
    reflectance: float
    """Diffuse reflectance of the artefact, or of the board's ground."""
    ink: float
    """Diffuse reflectance of the board's print."""
    roughness: float
    """Roughness of the paint's matt body."""
    gloss: float
    """Share of the light that the gloss of the paint reflects."""
    gloss_roughness: float
    """Square root of the width of the gloss (GGX), from nearly a mirror to matt."""
    ambient: float
    """Even ambient light, relative to the projector's white."""
    charge: float
    """Electrons for the same grey level, relative to the rig's sensor."""
    read_noise_e: float
    """Read noise in electrons."""
    exposure_s: float
    """Exposure of the camera in s."""
    projector_blur: float
    """Standard deviation of the projector lens's point spread at its sharpest, in mirrors."""
    projector_focus_mm: float
    """Distance in focus of the projector in mm."""
    stage_mm: float
    """Position of the stage in mm."""
