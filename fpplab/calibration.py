"""The result of a characterisation: both devices' models and the pose between them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from fpplab import config
from fpplab.config import Document
from fpplab.conventions import Floats, Lattice
from fpplab.errors import CalibrationError
from fpplab.files import write_text
from fpplab.geometry import Pinhole, RigidTransform


@dataclass(frozen=True, eq=False)
class Calibration:
    """Camera, projector, and `T_projector_camera`. The world frame is the camera's.

    rms_px: reprojection errors by name (`camera`, `projector`, `joint`), for the record.
    """

    camera: Pinhole
    projector: Pinhole
    T_projector_camera: RigidTransform
    rms_px: dict[str, float]

    @property
    def baseline_mm(self) -> float:
        """Distance between the two centres of projection."""
        return float(np.linalg.norm(self.T_projector_camera.translation))

    @property
    def projector_centre(self) -> Floats:
        """Centre of the projector's lens in the camera's frame, (3,) in mm."""
        return self.T_projector_camera.inverse().translation

    def check_camera(self, size: tuple[int, int], source: Path | str) -> None:
        """Refuse data of another sensor size: `CalibrationError`."""
        _check("camera frames", size, self.camera.size, source)

    def check_projector(self, size: tuple[int, int], lattice: Lattice, source: Path | str) -> None:
        """Refuse fringes of another projector size or lattice: `CalibrationError`."""
        _check("projector patterns", size, self.projector.size, source)
        if lattice is not self.projector.lattice:
            raise CalibrationError(
                f"{source}: projector patterns are for a {lattice} lattice but the calibration is for a "
                f"{self.projector.lattice} one; characterise this rig, or name the calibration that fits"
            )

    def save(self, path: Path) -> None:
        """Write as YAML, whole or not at all."""
        write_text(path, config.dump(_to_file(self)))

    @classmethod
    def load(cls, path: Path) -> Calibration:
        """Read a calibration file. Raises `ConfigError`."""
        return _from_file(config.load(path, CalibrationFile))


def _check(what: str, found: tuple[int, int], expected: tuple[int, int], source: Path | str) -> None:
    if tuple(found) != tuple(expected):
        raise CalibrationError(
            f"{source}: {what} are {found[0]} x {found[1]} but the calibration is for "
            f"{expected[0]} x {expected[1]}; characterise this rig, or name the calibration that fits"
        )


Pixels = Annotated[int, Field(ge=2, le=100_000)]
Focal = Annotated[float, Field(gt=0, le=1e6)]
Centre = Annotated[float, Field(ge=-1e5, le=1e5)]
Coefficient = Annotated[float, Field(ge=-100, le=100)]
Millimetres = Annotated[float, Field(ge=-1e5, le=1e5)]


class PinholeFile(Document):
    """One device in a calibration file."""

    size: tuple[Pixels, Pixels]
    focal_px: tuple[Focal, Focal]
    centre_px: tuple[Centre, Centre]
    distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient]
    lattice: Lattice = Lattice.SQUARE


class PoseFile(Document):
    """A rigid transform in a file: rotation vector in degrees, translation in mm."""

    rotation_deg: tuple[float, float, float]
    translation_mm: tuple[Millimetres, Millimetres, Millimetres]

    def transform(self) -> RigidTransform:
        return RigidTransform.from_vectors(np.radians(self.rotation_deg), np.array(self.translation_mm))

    @classmethod
    def of(cls, transform: RigidTransform) -> PoseFile:
        rotation, translation = np.degrees(transform.rotation_vector).tolist(), transform.translation.tolist()
        return cls(rotation_deg=tuple(rotation), translation_mm=tuple(translation))


class CalibrationFile(Document):
    """Schema of a calibration file."""

    camera: PinholeFile
    projector: PinholeFile
    T_projector_camera: PoseFile
    rms_px: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _has_a_baseline(self) -> CalibrationFile:
        if not any(self.T_projector_camera.translation_mm):
            raise ValueError(
                "'T_projector_camera.translation_mm' is zero: camera and projector must stand apart"
            )
        return self


def _pinhole_file(device: Pinhole) -> PinholeFile:
    k = device.matrix
    return PinholeFile(
        size=device.size,
        focal_px=(float(k[0, 0]), float(k[1, 1])),
        centre_px=(float(k[0, 2]), float(k[1, 2])),
        distortion=tuple(device.distortion.tolist()),
        lattice=device.lattice,
    )


def _to_file(calibration: Calibration) -> CalibrationFile:
    return CalibrationFile(
        camera=_pinhole_file(calibration.camera),
        projector=_pinhole_file(calibration.projector),
        T_projector_camera=PoseFile.of(calibration.T_projector_camera),
        rms_px=calibration.rms_px,
    )


def _from_file(file: CalibrationFile) -> Calibration:
    camera, projector = (
        Pinhole.from_focal(d.size, d.focal_px, d.centre_px, d.distortion, d.lattice)
        for d in (file.camera, file.projector)
    )
    return Calibration(camera, projector, file.T_projector_camera.transform(), dict(file.rms_px))
