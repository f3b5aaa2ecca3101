"""Record of the epochs of a matching: a file of one JSON line each, from which an interrupted one continues.

A line holds the step, whether it was accepted, the loss with its parts, and all parameters.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from fpplab.calibration.model import CalibrationFile, PoseFile
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.errors import DataError
from fpplab.core.journals import append_line, cut_torn_line, make_journal, whole_lines
from fpplab.patterns.curve import Curve
from sim.matching.light.light_fit import FALLOFF
from sim.parameters import NO_FALLOFF, NO_LINE, TwinParameters

LINE = ("vibration_line_x_mm", "vibration_line_y_mm", "vibration_line_z_mm")
"""Names of the displacements by vibration along a line."""
EPOCHS = "match.jsonl"
"""Name of the file."""


class ParametersFile(Document):
    """`TwinParameters` as plain data; None means that the device is sharp at every depth."""

    calibration: CalibrationFile
    """Both devices and the pose between them."""
    poses: tuple[PoseFile, ...]
    """T_camera_item of the board in every pose, in degrees and mm."""
    white: float
    """Level above black of the projector's white, relative to the twin's own file."""
    response: Curve
    """Of the projector, with a + b = 1."""
    ambient: float
    """Even ambient light, relative to the projector's white."""
    paper: float
    """Reflectance of the board's ground."""
    ink: float
    """Reflectance of the board's print."""
    projector_blur: float
    """Standard deviation of the projector lens's point spread at its sharpest, in mirrors."""
    projector_focus_mm: float | None = None
    """Distance in focus of the projector in mm."""
    projector_aperture_mm: float
    """Diameter of the projector's aperture in mm."""
    camera_focus_mm: float | None = None
    """Distance in focus of the camera in mm."""
    f_number: float
    """Of the camera's lens."""
    vignetting: float
    """Exponent n of the camera's loss of light cosⁿ towards the edge."""
    black_level: float
    """Share of full scale."""
    read_noise_e: float
    """Electrons of the unbinned pixel."""
    full_well_e: float
    """Electrons of the unbinned pixel."""
    vibration_mm: float
    """Standard deviation of the item's position from frame to frame in mm."""
    vibration_line_mm: tuple[float, float, float] = NO_LINE
    """RMS displacement along the camera's axes in mm by vibration along a line."""
    vibration_periodic: float = 0.0
    """Share of its variance that has one frequency."""
    vibration_cycles_per_frame: float = 0.0
    """That frequency."""
    projector_falloff: tuple[float, float, float, float, float] = NO_FALLOFF
    """Coefficients of x, y, x², xy and y² of the projector's light, as in a world file."""
    projector_flicker: float = 0.0
    """Standard deviation of the projector's light from frame to frame, relative."""
    lamp_irradiance: float = 0.0
    """Light of the room's lamp, relative to the projector's white."""
    lamp_angle_deg: float = 45.0
    """Angle between the ways to the lamp and to the camera in degrees."""
    lamp_azimuth_deg: float = -90.0
    """Direction of the lamp in the image in degrees."""
    lamp_distance_mm: float = 2000.0
    """Distance of the lamp in mm."""
    ambient_ripple: float = 0.0
    """Amplitude of the rolling bands of the ambient light, as a share of it."""
    band_period_px: float = 0.0
    """From band to band, in rows of the frame; 0 where there are none."""
    band_advance: float | None = None
    """Periods by which they move from frame to frame."""
    placed: Annotated[dict[str, PoseFile], Field(default_factory=dict)]
    """T_camera_item of other items that were measured on the bench, by name."""
    sigma: Annotated[dict[str, float], Field(default_factory=dict)]
    """Standard uncertainties that a fit stated, by name of the parameter, in its unit."""

    @classmethod
    def of(cls, parameters: TwinParameters) -> ParametersFile:
        """Convert parameters to plain data."""
        return cls(
            calibration=CalibrationFile.of(parameters.calibration),
            poses=tuple(PoseFile.of(pose) for pose in parameters.poses),
            response=parameters.response,
            placed={name: PoseFile.of(pose) for name, pose in parameters.placed.items()},
            sigma=dict(parameters.sigma),
            **{name: getattr(parameters, name) for name in PLAIN},
        )

    def parameters(self) -> TwinParameters:
        """Convert back to parameters."""
        return TwinParameters(
            calibration=self.calibration.calibration(),
            poses=tuple(pose.transform() for pose in self.poses),
            response=self.response,
            placed={name: pose.transform() for name, pose in self.placed.items()},
            sigma=self.sigma,
            **{name: getattr(self, name) for name in PLAIN},
        )


_WHOLE = ("calibration", "poses", "response", "placed", "sigma")
PLAIN = tuple(name for name in ParametersFile.model_fields if name not in _WHOLE)
"""Names of the parameters that are numbers, or tuples of numbers."""


def named_numbers(parameters: TwinParameters) -> dict[str, float | None]:
    """Give every parameter that is a number by its name."""
    several = {"projector_falloff": FALLOFF, "vibration_line_mm": LINE}
    numbers = {name: getattr(parameters, name) for name in PLAIN if name not in several}
    for name, parts in several.items():
        numbers |= zip(parts, getattr(parameters, name), strict=True)
    return numbers


class MatchingEpoch(Document):
    """One epoch of a matching: a line of the record."""

    epoch: Annotated[int, Field(ge=0)]
    """Number of the epoch; 0 is the start."""
    step: str
    """Name of the step that was tried."""
    accepted: bool
    """Whether the step was accepted by the loss."""
    loss: dict[str, float]
    """As `Loss.summary` gives it."""
    difference: float
    """RMS of reference less twin over the board, in raw levels."""
    poses_um: float | None = None
    """RMS distance in µm by which the step moved the poses of the board; absent in older records."""
    seconds: float
    """Duration of the matching so far in s, all runs together."""
    parameters: ParametersFile
    """That were tried."""
    next_frame: int | None = None
    """Number of the twin's frame that follows; None in records of version 0.1.0."""


@dataclass(frozen=True)
class MatchingRecord:
    """The epochs that are recorded in a folder."""

    folder: Path  # holds the file `match.jsonl`

    def read(self) -> list[MatchingEpoch]:
        """Read the epochs; an incomplete last line is an epoch that was not recorded."""
        path = self.folder / EPOCHS
        if not path.is_file():
            return []
        epochs = []
        for number, line in enumerate(whole_lines(path), 1):
            try:
                epochs.append(MatchingEpoch.model_validate_json(line))
            except ValidationError as error:
                raise DataError(f"{path} line {number}: is no epoch ({config.describe(error)})") from error
        return epochs

    def add(self, epoch: MatchingEpoch) -> None:
        """Append an epoch; it is on disk when the call returns.

        The folder is created, and an incomplete last line is removed.
        """
        path = self.folder / EPOCHS
        make_journal(path)
        cut_torn_line(path)
        append_line(path, json.dumps(config.plain(epoch)))
