"""The epochs of a matching on disk: one line of JSON each, from which an interrupted one goes on.

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
from fpplab.core.files import append_line, cut_torn_line, whole_lines
from fpplab.patterns.response import Curve
from fpplab.simulation.matchable import Parameters

EPOCHS = "match.jsonl"


class ParametersFile(Document):
    """`Parameters` as plain data; poses in degrees and mm."""

    calibration: CalibrationFile
    poses: tuple[PoseFile, ...]
    white: float
    response: Curve
    ambient: float
    paper: float
    ink: float
    projector_blur: float
    projector_focus_mm: float | None = None
    projector_aperture_mm: float
    camera_focus_mm: float | None = None
    f_number: float
    vignetting: float
    black_level: float
    read_noise_e: float
    full_well_e: float
    vibration_mm: float

    @classmethod
    def of(cls, parameters: Parameters) -> ParametersFile:
        return cls(
            calibration=CalibrationFile.of(parameters.calibration),
            poses=tuple(PoseFile.of(pose) for pose in parameters.poses),
            response=parameters.response,
            **{name: getattr(parameters, name) for name in PLAIN},
        )

    def parameters(self) -> Parameters:
        return Parameters(
            calibration=self.calibration.calibration(),
            poses=tuple(pose.transform() for pose in self.poses),
            response=self.response,
            **{name: getattr(self, name) for name in PLAIN},
        )


PLAIN = tuple(n for n in ParametersFile.model_fields if n not in ("calibration", "poses", "response"))
"""The parameters that are numbers."""


class MatchingEpoch(Document):
    """One line.

    step: what was tried. accepted: whether the loss let it stand. loss: as `Loss.summary`. difference: RMS of
    bench less twin over the board, in raw levels. seconds: since the matching began, all its runs together.
    """

    epoch: Annotated[int, Field(ge=0)]
    step: str
    accepted: bool
    loss: dict[str, float]
    difference: float
    seconds: float
    parameters: ParametersFile


@dataclass(frozen=True)
class MatchingRecord:
    """The epochs in a folder."""

    folder: Path

    def read(self) -> list[MatchingEpoch]:
        """What is there; a torn last line is an epoch that was not recorded. Raises `DataError`."""
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
        """Put one on disk before returning."""
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / EPOCHS
        path.touch()
        cut_torn_line(path)
        append_line(path, json.dumps(config.plain(epoch)))
