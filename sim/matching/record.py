"""Record of the epochs of a matching: one JSON line each, from which an interrupted one continues."""

import json
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self, get_type_hints

from pydantic import Field, ValidationError, create_model

from fpplab.calibration.model import CalibrationFile, PoseFile
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform
from fpplab.core.journals import append_line, cut_torn_line, make_journal, whole_lines
from fpplab.patterns.curve import Curve
from sim.parameters import TABLE, TwinParameters

EPOCHS = "match.jsonl"  # name of the file


class _ParametersForm(Document):
    """`TwinParameters` as plain data: poses in degrees and mm, numbers as they are."""

    @classmethod
    def of(cls, parameters: TwinParameters) -> Self:
        calibration = CalibrationFile.of(parameters.calibration)
        pair = _rounded(parameters.calibration.T_projector_camera)
        return cls.model_validate(
            {
                "calibration": calibration.model_copy(update={"T_projector_camera": pair}),
                "poses": tuple(_rounded(pose) for pose in parameters.poses),
                "response": parameters.response,
                "placed": {name: _rounded(pose) for name, pose in parameters.placed.items()},
                "sigma": dict(parameters.sigma),
                **{name: getattr(parameters, name) for name in TABLE},
            }
        )

    def parameters(self) -> TwinParameters:
        values = dict(self)
        return TwinParameters(
            calibration=values["calibration"].calibration(),
            poses=tuple(pose.transform() for pose in values["poses"]),
            response=values["response"],
            placed={name: pose.transform() for name, pose in values["placed"].items()},
            sigma=values["sigma"],
            **{name: values[name] for name in TABLE},
        )


def _rounded(pose: RigidTransform) -> PoseFile:
    """Round angles to 1e-12°: what is read is then written as it was, and light that is kept stays valid."""
    file = PoseFile.of(pose)
    return file.model_copy(update={"rotation_deg": tuple(round(angle, 12) for angle in file.rotation_deg)})


def _fields_of_form() -> dict[str, Any]:
    """Type and default of every field of `TwinParameters` but surfaces, which are found after the epochs."""
    plain = {
        "calibration": (CalibrationFile, Field(description="Both devices and the pose between them.")),
        "poses": (tuple[PoseFile, ...], Field(description="T_camera_item of the board in every pose.")),
        "response": (Curve, Field(description="Of the projector, with a + b = 1.")),
        "placed": (dict[str, PoseFile], Field(default_factory=dict, description="T_camera_item by item.")),
        "sigma": (
            dict[str, float],
            Field(default_factory=dict, description="Standard uncertainties by name."),
        ),
    }
    hints = get_type_hints(TwinParameters)
    form: dict[str, Any] = {}
    for parameter in fields(TwinParameters):
        if parameter.name in plain:
            form[parameter.name] = plain[parameter.name]
        elif parameter.name in TABLE:
            may_be_left_out = parameter.default is not MISSING or hints[parameter.name] == float | None
            default = None if parameter.default is MISSING else parameter.default
            about = Field(... if not may_be_left_out else default, description=TABLE[parameter.name].doc)
            form[parameter.name] = (hints[parameter.name], about)
    return form


if TYPE_CHECKING:

    class ParametersFile(_ParametersForm):
        """`TwinParameters` as plain data; its fields are those of the table of parameters."""

else:
    ParametersFile = create_model(
        "ParametersFile", __base__=_ParametersForm, __module__=__name__, **_fields_of_form()
    )


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
        """Append an epoch; it is on disk when the call returns."""
        # The folder is created, and an incomplete last line is removed.
        path = self.folder / EPOCHS
        make_journal(path)
        cut_torn_line(path)
        append_line(path, json.dumps(config.plain(epoch)))
