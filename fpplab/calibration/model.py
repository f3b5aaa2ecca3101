"""The calibration, result of a characterisation: both devices' models and the pose between them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, AwareDatetime, Field, model_validator

from fpplab.calibration.board import FittedBoard, FittedBoardFile, LocatedMarks, LocatedMarksFile
from fpplab.calibration.drawing import calibration_table, draw_from_above
from fpplab.calibration.plausibility import explain_impossible
from fpplab.core import config
from fpplab.core.config import Document, Positive
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.file_kinds import naming_other_kinds
from fpplab.core.files import write_text
from fpplab.core.geometry import DISTORTION, POLYNOMIAL, Pinhole, RigidTransform
from fpplab.core.origin import DeviceIdentity, Origin

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INTRINSICS = ("fx", "fy", "cx", "cy", *DISTORTION)
"""The intrinsic parameters of a device, in the order of every vector that holds them."""

POSE = ("rx", "ry", "rz", "x", "y", "z")
"""The parameters of a rigid transform: rotation vector and translation."""

PARAMETERS = (
    *(f"{device}.{term}" for device in ("camera", "projector") for term in INTRINSICS),
    *(f"T_projector_camera.{term}" for term in POSE),
)
"""Every parameter of a calibration by name."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of a calibration's parameters."""

    names: tuple[str, ...]  # n of `PARAMETERS`; those that are absent were held constant and count as exact
    covariance: Floats  # (n, n) px

    def __post_init__(self) -> None:
        if complaint := _no_covariance(self.names, self.covariance):
            raise CalibrationError(complaint)

    @property
    def sigma(self) -> dict[str, float]:
        """Standard uncertainty of each parameter by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def widened(self, added: Floats) -> Uncertainty:
        """Add the covariance (P, P), by `PARAMETERS`, of a change of the rig; it may free held parameters."""
        whole, places = added.copy(), [PARAMETERS.index(name) for name in self.names]
        whole[np.ix_(places, places)] += self.covariance
        kept = np.flatnonzero(np.diag(whole) > 0)
        return Uncertainty(tuple(PARAMETERS[k] for k in kept), whole[np.ix_(kept, kept)])


_MAX_SIGMA = dict.fromkeys(("fx", "fy", "cx", "cy", *POSE), 1e6) | dict.fromkeys(DISTORTION, 1e9)
"""Standard uncertainties beyond which a number is damage and not knowledge, in px, mm, and rad or degrees."""


def _no_covariance(names: tuple[str, ...], covariance: Floats) -> str | None:
    """Explain why this cannot be the covariance of these parameters; None if it can."""
    for name in names:
        if name not in PARAMETERS:
            return f"'names' has {name!r}, which is no parameter of a calibration, such as 'camera.fx'"
    if len(set(names)) < len(names):
        return "'names' has a parameter twice"
    n = len(names)
    if covariance.shape != (n, n):
        return f"'covariance' must be square, {n} x {n} as there are names, not {covariance.shape}"
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not np.all(np.isfinite(covariance)) or np.any(scale == 0):
        return "'covariance' must be finite, and above zero on its diagonal"
    for name, sigma in zip(names, scale.tolist(), strict=True):
        if sigma > (max_sigma := _MAX_SIGMA[name.rpartition(".")[2]]):
            return (
                f"'covariance' of '{name}' means a standard uncertainty of {sigma:.3g}, more than "
                f"{max_sigma:g}"
            )
    correlation = covariance / np.outer(scale, scale)
    if not np.allclose(correlation, correlation.T, rtol=0, atol=1e-9):
        return "'covariance' must be symmetric"
    if n and np.linalg.eigvalsh(correlation)[0] < -1e-9 * n:
        return "'covariance' must be positive semidefinite: some correlations contradict one another"
    return None


class CalibrationOrigin(Origin):
    """When, where, and from which devices' images a calibration was made."""

    poses_taken: AwareDatetime | None = None
    """When the last image of the board was taken, where it is recorded."""
    camera: DeviceIdentity | None = None
    """The camera, where it is recorded."""
    projector: DeviceIdentity | None = None
    """The projector, where it is recorded."""
    stage_mm: float | None = None
    """Where the plan of the poses put the stage, in mm; None where it did not."""
    file: str | None = None
    """Name of the file that it was first written to, which copies of it state too."""
    confirmed: AwareDatetime | None = None
    """When the last images were taken of a board that confirmed it, since it was made."""
    settings: dict[str, float | str] | None = None
    """What was set by hand when the board last showed that it holds, as the rig file stated it."""
    temperature_c: float | None = None
    """The rig's temperature then in °C, as the rig file stated it."""

    @property
    def verified(self) -> AwareDatetime | None:
        """When a board last showed that it holds; None where that is not recorded."""
        return self.confirmed or self.poses_taken


@dataclass(frozen=True, eq=False)
class Calibration:
    """Camera, projector, and the pose between them. The world frame is the camera's.

    Attributes
    ----------
    camera : Pinhole
        Model of the camera.
    projector : Pinhole
        Model of the projector.
    T_projector_camera : RigidTransform
        Takes coordinates in mm in the camera's frame to the projector's.
    rms_px : dict of str to float
        Reprojection errors in px by name (`camera`, `projector`, `joint`), for information only.
    uncertainty : Uncertainty, optional
        Of the parameters; None where it is unknown.
    board : FittedBoard, optional
        The board that it was found with, and the errors; None where they are unknown.
    origin : CalibrationOrigin, optional
        When and from which devices' images it was made; None where that is unknown.
    doubt : str, optional
        Why it was doubtful when it was made; None where nothing spoke against it.
    marks : LocatedMarks, optional
        Reference marks that show in later scans whether the rig has changed; None where there are none.
    white : tuple of float, optional
        Shares of red, green and blue that a Bayer camera sees of the board, which counts as white.
    """

    camera: Pinhole
    projector: Pinhole
    T_projector_camera: RigidTransform
    rms_px: dict[str, float]
    uncertainty: Uncertainty | None = None
    board: FittedBoard | None = None
    origin: CalibrationOrigin | None = None
    doubt: str | None = None
    marks: LocatedMarks | None = None
    white: tuple[float, float, float] | None = None

    def __repr__(self) -> str:
        sizes = ", ".join(
            f"{name} {device.size[0]} x {device.size[1]} (f {device.matrix[0, 0]:.1f} px)"
            for name, device in self._devices.items()
        )
        rms = "".join(f", {name} RMS {value:.3g} px" for name, value in self.rms_px.items())
        lattice, baseline = self.projector.lattice, f"{self.baseline_mm:.2f}"
        return f"<Calibration: {sizes}, {lattice} lattice, baseline {baseline} mm{rms}>"

    def _repr_html_(self) -> str:
        has_uncertainty = self.uncertainty is not None
        return calibration_table(self._devices, self.baseline_mm, self.rms_px, has_uncertainty)

    def plot(self, distance_mm: float | None = None, axes: Axes | None = None) -> Axes:
        """Draw camera and projector from above, with what each of them sees.

        Parameters
        ----------
        distance_mm : float, optional
            How far the fields of view are drawn; by default three baselines.
        axes : matplotlib.axes.Axes, optional
            Where to draw; new ones by default.

        Returns
        -------
        matplotlib.axes.Axes
            In mm in the camera's frame: x to the right, z upwards.
        """
        reach_mm = distance_mm or 3.0 * self.baseline_mm
        return draw_from_above(self._devices, self.T_projector_camera, reach_mm, axes)

    @property
    def _devices(self) -> dict[str, Pinhole]:
        return {"camera": self.camera, "projector": self.projector}

    @property
    def baseline_mm(self) -> float:
        """Distance between the two centres of projection in mm."""
        return float(np.linalg.norm(self.T_projector_camera.translation))

    @property
    def projector_centre(self) -> Floats:
        """Centre of the projector's lens in the camera's frame, (3,) in mm."""
        return self.T_projector_camera.inverse().translation

    def check_camera(self, size: tuple[int, int], source: Path | str) -> None:
        """Check that data are of the camera's sensor size.

        Parameters
        ----------
        size : tuple of int
            Width and height of the frames in px.
        source : Path or str
            Where the frames come from, for the error message.

        Raises
        ------
        CalibrationError
            The sizes differ.
        """
        _check("camera frames", size, self.camera.size, source)

    def check_projector(self, size: tuple[int, int], lattice: Lattice, source: Path | str) -> None:
        """Refuse patterns for another projector: size (width, height) in px, and lattice."""
        _check("projector patterns", size, self.projector.size, source)
        if lattice is not self.projector.lattice:
            raise CalibrationError(
                f"{source}: projector patterns are for a {lattice} lattice but the calibration is for a "
                f"{self.projector.lattice} one; characterise this rig, name the calibration that fits, or "
                f"import images from elsewhere with '--lattice {self.projector.lattice}'"
            )

    def check_possible(self, source: Path | str) -> None:
        """Refuse a distortion, focal lengths or a pose that no two devices have: `ConfigError`."""
        if complaint := explain_impossible(self.camera, self.projector, self.T_projector_camera):
            raise ConfigError(f"{source}: no calibration of a real rig: {complaint}")

    def save(self, path: Path | str) -> None:
        """Write a calibration file (YAML), atomically: the file is complete or unchanged.

        Parameters
        ----------
        path : Path
            Where to write.

        Raises
        ------
        DataError
            The file cannot be written.
        """
        write_text(Path(path), self.to_yaml(Path(path).name))

    def to_yaml(self, name: str) -> str:
        """Give the text of a calibration file; its name is recorded as the first, where there is none yet."""
        origin = self.origin
        if origin is not None and origin.file is None:
            origin = origin.model_copy(update={"file": name})
        content = config.plain(CalibrationFile.of(replace(self, origin=origin)))
        return config.to_yaml({**content, "checksum": _checksum(content)})

    @classmethod
    def load(cls, path: Path | str) -> Calibration:
        """Read a calibration file.

        Parameters
        ----------
        path : Path
            A file that `save` wrote.

        Returns
        -------
        Calibration
            What the file holds.

        Raises
        ------
        ConfigError
            The file is missing, or a field of it is not valid.
        """
        path = Path(path)
        with naming_other_kinds(path, "calibration"):
            content = config.parse_yaml(config.read_text(path), path)
            file = config.validate(content, CalibrationFile, path)
        if file.checksum is not None and file.checksum != _checksum(content):
            raise ConfigError(
                f"{path}: its numbers were changed since fpplab wrote it: they do not match its checksum; "
                "put back the file as it was, or, if the change was meant, delete the line 'checksum'"
            )
        calibration = file.calibration()
        calibration.check_possible(path)
        return calibration


def _checksum(content: Mapping[str, Any]) -> str:
    numbers = {name: value for name, value in content.items() if name not in ("origin", "checksum")}
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()


def _check(what: str, size: tuple[int, int], expected: tuple[int, int], source: Path | str) -> None:
    if tuple(size) != tuple(expected):
        is_exchanged = tuple(size) == tuple(expected)[::-1]
        turned = "where they were turned by 90°, turn them back; otherwise " if is_exchanged else ""
        raise CalibrationError(
            f"{source}: {what} are {size[0]} x {size[1]} but the calibration is for "
            f"{expected[0]} x {expected[1]}; {turned}characterise this rig, or name the calibration that fits"
        )


PixelCount = Annotated[int, Field(ge=2, le=100_000)]
Focal = Annotated[float, Field(gt=0, le=1e6)]
Centre = Annotated[float, Field(ge=-1e5, le=1e5)]
Coefficient = Annotated[float, Field(ge=-1e9, le=1e9)]  # k3 of a lens that is 3 degrees wide can be millions
Millimetres = Annotated[float, Field(ge=-1e5, le=1e5)]


def _five_or_eight(distortion: tuple[float, ...]) -> tuple[float, ...]:
    if len(distortion) not in (POLYNOMIAL, len(DISTORTION)):
        raise ValueError(
            f"must be {POLYNOMIAL} coefficients ({', '.join(DISTORTION[:POLYNOMIAL])}), or {len(DISTORTION)} "
            f"with {', '.join(DISTORTION[POLYNOMIAL:])}"
        )
    return distortion


Distortion = Annotated[tuple[Coefficient, ...], AfterValidator(_five_or_eight)]
"""Distortion in a file: as many coefficients as OpenCV has without or with k4, k5, k6."""


class PinholeFile(Document):
    """One device in a calibration file."""

    size: tuple[PixelCount, PixelCount]
    """Width and height in px."""
    focal_px: tuple[Focal, Focal]
    """Focal lengths fx and fy in px."""
    centre_px: tuple[Centre, Centre]
    """Principal point (cx, cy) in px, (0, 0) at the centre of the first pixel."""
    distortion: Distortion
    """OpenCV's (k1, k2, p1, p2, k3), with k4, k5, k6 for the rational model."""
    lattice: Lattice = Lattice.SQUARE
    """Arrangement of the pixels or mirrors."""

    @classmethod
    def of(cls, device: Pinhole) -> PinholeFile:
        k = device.matrix
        return cls(
            size=device.size,
            focal_px=(float(k[0, 0]), float(k[1, 1])),
            centre_px=(float(k[0, 2]), float(k[1, 2])),
            distortion=tuple(device.coefficients.tolist()),
            lattice=device.lattice,
        )

    def model(self) -> Pinhole:
        return Pinhole.from_focal(self.size, self.focal_px, self.centre_px, self.distortion, self.lattice)


class PoseFile(Document):
    """A rigid transform in a file."""

    rotation_deg: tuple[float, float, float]
    """Rotation vector in degrees."""
    translation_mm: tuple[Millimetres, Millimetres, Millimetres]
    """Translation in mm."""

    def transform(self) -> RigidTransform:
        return RigidTransform.from_vectors(np.radians(self.rotation_deg), np.array(self.translation_mm))

    @classmethod
    def of(cls, transform: RigidTransform) -> PoseFile:
        rotation, translation = np.degrees(transform.rotation_vector).tolist(), transform.translation.tolist()
        return cls(rotation_deg=tuple(rotation), translation_mm=tuple(translation))


class UncertaintyFile(Document):
    """Covariance in a calibration file, as `Uncertainty`, but in degrees for rx, ry, rz."""

    names: tuple[str, ...]
    """Parameters such as `camera.fx`; those that are absent count as exact."""
    covariance: tuple[tuple[float, ...], ...]
    """Rows of the covariance in the order of `names`, in px for fx, fy, cx, cy, degrees for rx, ry, rz, mm
    for x, y, z."""

    @model_validator(mode="after")
    def _is_a_covariance(self) -> UncertaintyFile:
        if any(len(row) != len(self.covariance) for row in self.covariance):
            raise ValueError("'covariance' must be square: every row as long as there are rows")
        if complaint := _no_covariance(self.names, np.array(self.covariance, ndmin=2)):
            raise ValueError(complaint)
        return self

    def uncertainty(self) -> Uncertainty:
        """Convert to an uncertainty in rad."""
        return Uncertainty(self.names, np.array(self.covariance) / self._units(self.names))

    @classmethod
    def of(cls, uncertainty: Uncertainty) -> UncertaintyFile:
        rows = (uncertainty.covariance * cls._units(uncertainty.names)).tolist()
        return cls(names=uncertainty.names, covariance=tuple(tuple(row) for row in rows))

    @staticmethod
    def _units(names: tuple[str, ...]) -> Floats:
        """Compute the factors (n, n) that convert a covariance in rad to one in degrees."""
        unit = np.array([np.degrees(1.0) if name.rpartition(".")[2] in POSE[:3] else 1.0 for name in names])
        return np.outer(unit, unit)


class CalibrationFile(Document):
    """Schema of a calibration file."""

    camera: PinholeFile
    """Model of the camera."""
    projector: PinholeFile
    """Model of the projector."""
    T_projector_camera: PoseFile
    """Takes coordinates in the camera's frame to the projector's."""
    rms_px: dict[str, float] = Field(default_factory=dict)
    """Reprojection errors in px by name (`camera`, `projector`, `joint`), for information only."""
    uncertainty: UncertaintyFile | None = None
    """Covariance of the parameters, where it is known."""
    board: FittedBoardFile | None = None
    """The board that the calibration was found with, and the errors, by which other poses are judged."""
    origin: CalibrationOrigin | None = None
    """When and from which devices' images the calibration was made, where that is known."""
    doubt: str | None = None
    """Why the calibration was doubtful when it was made."""
    marks: LocatedMarksFile | None = None
    """Reference marks as they were seen at the time of the characterisation."""
    white: tuple[Positive, Positive, Positive] | None = None
    """Shares of red, green and blue that a Bayer camera sees of the board, by which points are coloured."""
    checksum: str | None = None
    """SHA-256 of all but the origin, as fpplab wrote it; to change a number, delete this line."""

    @model_validator(mode="after")
    def _has_a_baseline(self) -> CalibrationFile:
        if not any(self.T_projector_camera.translation_mm):
            raise ValueError(
                "'T_projector_camera.translation_mm' is zero: camera and projector must stand apart"
            )
        return self

    @classmethod
    def of(cls, calibration: Calibration) -> CalibrationFile:
        uncertainty = calibration.uncertainty
        return cls(
            camera=PinholeFile.of(calibration.camera),
            projector=PinholeFile.of(calibration.projector),
            T_projector_camera=PoseFile.of(calibration.T_projector_camera),
            rms_px=calibration.rms_px,
            uncertainty=UncertaintyFile.of(uncertainty) if uncertainty else None,
            board=FittedBoardFile.of(calibration.board) if calibration.board else None,
            origin=calibration.origin,
            doubt=calibration.doubt,
            marks=LocatedMarksFile.of(calibration.marks) if calibration.marks else None,
            white=calibration.white,
        )

    def calibration(self) -> Calibration:
        uncertainty = self.uncertainty.uncertainty() if self.uncertainty else None
        pose, board = self.T_projector_camera.transform(), self.board.board() if self.board else None
        devices = self.camera.model(), self.projector.model()
        rms_px, marks = dict(self.rms_px), self.marks.marks() if self.marks else None
        doubt, white = self.doubt, self.white
        return Calibration(*devices, pose, rms_px, uncertainty, board, self.origin, doubt, marks, white)
