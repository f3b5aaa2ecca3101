"""Exchanging calibrations with other programs: written for OpenCV, read from all that `dialects` knows.

Files are written with the names of OpenCV's own stereo sample: `M1 D1` (camera), `M2 D2` (projector), and
`R T` with `X_2 = R X_1 + T`, which is `T_projector_camera` here; in addition the sizes and the lattice.

Pixels: (0, 0) is the centre of the first pixel. Distortion: (k1, k2, p1, p2, k3), and with k4, k5, k6 the
rational model. Lengths: in the unit that the format defines, otherwise in mm.

Lattice: files of other programs do not say how the projector's mirrors are arranged, so it must be given. The
numbers are not changed. On a `diamond` lattice fpplab counts u in columns, with odd rows shifted by half a
column (`fpplab.core.conventions`); a program that ignores the half column measures, on average, a quarter of
a column too little, and so does its principal point. Characterise again where a quarter of a column matters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from fpplab.calibration.dialects import ALONE, NAMES, ForeignFile, read_foreign
from fpplab.calibration.model import Calibration, CalibrationFile
from fpplab.calibration.plausibility import LIMITS as PLAUSIBLE
from fpplab.core import config
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import DISTORTION, Pinhole, RigidTransform
from fpplab.core.progress import Say, ignore

Format = Literal["yaml", "xml", "json"]

RMS = ("camera", "projector", "joint")

COEFFICIENTS = (4, 5, 8, 12, 14)
"""Numbers of coefficients of OpenCV's models; those beyond the eighth are not modelled here."""


@dataclass(frozen=True)
class _Entry:
    """An entry of a file, and its file and name for error messages."""

    where: str
    value: Any


_Entries = dict[str, _Entry]


def to_opencv(calibration: Calibration, kind: Format) -> str:
    """Convert a calibration to FileStorage text that `from_opencv` reads back without any loss of digits."""
    formats = cv2.FILE_STORAGE_FORMAT_YAML, cv2.FILE_STORAGE_FORMAT_XML, cv2.FILE_STORAGE_FORMAT_JSON
    flags = dict(zip(("yaml", "xml", "json"), formats, strict=True))[kind]
    storage = cv2.FileStorage("", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | flags)
    for number, device in enumerate((calibration.camera, calibration.projector), start=1):
        storage.write(f"M{number}", device.matrix)
        storage.write(f"D{number}", device.coefficients.reshape(1, -1))
        storage.write(f"image_size{number}", np.array([device.size], np.int32))
    storage.write("lattice2", str(calibration.projector.lattice))
    storage.write("R", calibration.T_projector_camera.rotation)
    storage.write("T", calibration.T_projector_camera.translation.reshape(3, 1))
    for name in RMS:
        if name in calibration.rms_px:
            storage.write(f"rms_{name}", calibration.rms_px[name])
    return str(storage.releaseAndGetString())


def import_calibration(
    paths: Sequence[Path],
    camera_size: tuple[int, int] | None = None,
    projector_size: tuple[int, int] | None = None,
    lattice: Lattice | None = None,
    mm_per_unit: float | None = None,
    tell: Say = ignore,
) -> Calibration:
    """Read a calibration from other programs' files, which together hold both devices and their pose."""
    files = [read_foreign(path) for path in paths]
    stated_unit = mm_per_unit or _mm_per_unit(files, tell)
    entries = _gathered(files)
    source = " + ".join(str(path) for path in paths)
    camera = Pinhole(
        _size(entries, "1", camera_size, "--camera-size", source),
        _matrix(_needed(entries, "M1", source)),
        _distortion(_needed(entries, "D1", source)),
    )
    projector = Pinhole(
        _size(entries, "2", projector_size, "--projector-size", source),
        _matrix(_needed(entries, "M2", source)),
        _distortion(_needed(entries, "D2", source)),
        _lattice(entries, lattice, source),
    )
    pose = _pose(entries, stated_unit or 1.0, source)
    rms = {name: _number(entries[f"rms_{name}"]) for name in RMS if f"rms_{name}" in entries}
    calibration = Calibration(camera, projector, pose, rms)
    if calibration.baseline_mm > PLAUSIBLE.max_baseline_mm:  # of another unit, which ranges do not name
        calibration.check_possible(source)
    _check_ranges(calibration, source)
    calibration.check_possible(source)
    if stated_unit is None:
        tell(
            f"{source}: states no unit of length; in mm, camera and projector stand "
            f"{calibration.baseline_mm:.4g} mm apart; --unit states another unit"
        )
    return calibration


def _mm_per_unit(files: Sequence[ForeignFile], tell: Say) -> float | None:
    """The unit of the file that has the translation; None where its format defines none."""
    for file in files:
        if ("T" in file.entries or "pose" in file.entries) and file.mm_per_unit is not None:
            if file.mm_per_unit != 1.0:
                tell(
                    f"{file.path}: lengths are taken as those of {file.program}'s format and multiplied by "
                    f"{file.mm_per_unit:g} to be in mm; --unit states another unit"
                )
            return file.mm_per_unit
    return None


def _gathered(files: Sequence[ForeignFile]) -> _Entries:
    """Collect the entries of all files; those of single devices get their numbers."""
    entries: _Entries = {}
    alone = 0
    for file in files:
        alone += file.is_of_single_device
        for name, (written, value) in file.entries.items():
            what = f"{name}{alone}" if name in ALONE or name == "pose" else name
            if what in entries:
                raise ConfigError(
                    f"{file.path}: '{written}' says again what {entries[what].where} says; keep one"
                )
            entries[what] = _Entry(f"{file.path}: '{written}'", value)
    if alone > 2:
        raise ConfigError(
            f"{files[-1].path}: is the third file of one device; give the camera's and the projector's"
        )
    return entries


def _needed(entries: _Entries, what: str, source: str) -> _Entry:
    if what not in entries:
        names = ", ".join([*NAMES[what], *ALONE.get(what.removesuffix("1"), ())])
        also = (
            "; give the file that has R and T from the camera to the projector, too" if what in "RT" else ""
        )
        raise ConfigError(f"{source}: has no entry '{what}' (or, as other programs call it, {names}){also}")
    return entries[what]


def _numbers(entry: _Entry, expected: str) -> Floats:
    value = entry.value
    if not isinstance(value, np.ndarray) or value.size == 0 or not np.all(np.isfinite(value)):
        raise ConfigError(f"{entry.where} is not a matrix of finite numbers; expected {expected}")
    return np.asarray(value, np.float64)


def _matrix(entry: _Entry) -> Floats:
    expected = "a 3 x 3 matrix [fx 0 cx; 0 fy cy; 0 0 1] in px"
    matrix = _numbers(entry, expected)
    matrix = matrix.reshape(3, 3) if matrix.size == 9 else matrix
    if matrix.shape != (3, 3):
        raise ConfigError(f"{entry.where} has the shape {_shape(matrix)}; expected {expected}")
    if matrix[0, 1] != 0:
        raise ConfigError(
            f"{entry.where} has the skew {matrix[0, 1]:g}, which the model has not; expected {expected}"
        )
    if matrix[1, 0] != 0 or not np.array_equal(matrix[2], [0, 0, 1]):
        raise ConfigError(f"{entry.where} is no camera's matrix; expected {expected}")
    return matrix


def _distortion(entry: _Entry) -> Floats:
    modelled = len(DISTORTION)
    expected = f"4, 5 or 8 coefficients ({', '.join(DISTORTION)})"
    values = _numbers(entry, expected)
    if values.ndim > 2 or values.size != max(values.shape) or values.size not in COEFFICIENTS:
        raise ConfigError(f"{entry.where} has the shape {_shape(values)}; expected {expected}")
    flat = values.ravel()
    if np.any(flat[modelled:]):
        raise ConfigError(
            f"{entry.where} has {flat.size} coefficients and those beyond the eighth are not zero; expected "
            f"{expected}: calibrate there without the thin prism and tilted models"
        )
    return flat[:modelled]


def _rotation(entry: _Entry) -> Floats:
    expected = "a 3 x 3 rotation from the camera's frame to the projector's"
    rotation = _numbers(entry, expected)
    if rotation.shape != (3, 3):
        raise ConfigError(f"{entry.where} has the shape {_shape(rotation)}; expected {expected}")
    deviation = np.abs(rotation @ rotation.T - np.eye(3)).max()
    # Tolerance of R Rᵀ = 1, chosen: files are written with five digits and more.
    if deviation > 1e-4 or np.linalg.det(rotation) < 0:
        raise ConfigError(
            f"{entry.where} is no rotation: R Rᵀ differs from 1 by {deviation:.2g} (at most 1e-4), and its "
            f"determinant is {np.linalg.det(rotation):.3g}; expected {expected}"
        )
    return np.asarray(Rotation.from_matrix(rotation).as_matrix(), np.float64)


def _pose(entries: _Entries, mm_per_unit: float, source: str) -> RigidTransform:
    """Read the pose between the devices, or compute it from those of both in one frame of reference."""
    if "R" not in entries and "pose1" in entries and "pose2" in entries:
        vectors = [_numbers(entries[f"pose{number}"], "6 numbers").ravel() for number in (1, 2)]
        camera, projector = (RigidTransform.from_vectors(each[:3], each[3:]) for each in vectors)
        pose = projector @ camera.inverse()
    elif "R" not in entries and "rotation_vector" in entries:
        vector = _numbers(entries["rotation_vector"], "a rotation vector of 3 numbers")
        if vector.size != 3:
            raise ConfigError(f"{entries['rotation_vector'].where} has {vector.size} numbers; expected 3")
        pose = RigidTransform.from_vectors(vector.ravel(), _translation(_needed(entries, "T", source)))
    else:
        rotation = _rotation(_needed(entries, "R", source))
        pose = RigidTransform(rotation, _translation(_needed(entries, "T", source)))
    return RigidTransform(pose.rotation, pose.translation * mm_per_unit)


def _translation(entry: _Entry) -> Floats:
    expected = "3 lengths"
    translation = _numbers(entry, expected)
    if translation.size != 3:
        raise ConfigError(f"{entry.where} has the shape {_shape(translation)}; expected {expected}")
    return translation.ravel()


def _shape(array: Floats) -> str:
    return " x ".join(str(side) for side in array.shape)


def _number(entry: _Entry) -> float:
    if not isinstance(entry.value, float):
        raise ConfigError(f"{entry.where} is not a number")
    return entry.value


def _size(
    entries: _Entries, device: str, stated: tuple[int, int] | None, option: str, source: str
) -> tuple[int, int]:
    """Look up the size in px in the files, or take the given one where they have none."""
    size, width, height = (entries.get(f"{what}{device}") for what in ("size", "width", "height"))
    shape = entries.get(f"shape{device}")
    if size is None and shape is not None:  # of rows and columns
        size = _Entry(shape.where, _numbers(shape, "rows and columns in px").ravel()[1::-1])
    if size is not None:
        expected = "width and height in px"
        pair, where = _numbers(size, expected).ravel(), size.where
        if pair.size != 2:
            raise ConfigError(f"{where} has {pair.size} numbers; expected {expected}")
    elif width is not None and height is not None:
        pair, where = np.array([_number(width), _number(height)]), width.where
    elif stated is not None:
        return stated
    else:
        raise ConfigError(f"{source}: does not say the size in px; add {option} WIDTH HEIGHT")
    if not np.array_equal(pair, np.rint(pair)):
        raise ConfigError(f"{where} is {pair[0]:g} x {pair[1]:g}; expected whole px")
    size_px = int(pair[0]), int(pair[1])
    if stated is not None and stated != size_px:
        raise ConfigError(
            f"{where} says {size_px[0]} x {size_px[1]} px but {option} {stated[0]} {stated[1]}; leave one out"
        )
    return size_px


def _lattice(entries: _Entries, stated: Lattice | None, source: str) -> Lattice:
    entry = entries.get("lattice2")
    if entry is None:
        if stated is None:
            raise ConfigError(
                f"{source}: does not say how the projector's mirrors lie; add --lattice "
                f"{' or --lattice '.join(Lattice)}"
            )
        return stated
    if entry.value not in tuple(Lattice):
        raise ConfigError(f"{entry.where} is {entry.value!r}; expected {' or '.join(Lattice)}")
    lattice = Lattice(entry.value)
    if stated is not None and stated is not lattice:
        raise ConfigError(f"{entry.where} says {lattice} but --lattice {stated}; leave the option out")
    return lattice


def _check_ranges(calibration: Calibration, source: str) -> None:
    """Raise `ConfigError` for values that a calibration file of fpplab may not hold."""
    devices = {"camera": calibration.camera, "projector": calibration.projector}
    fields: dict[str, Any] = {
        name: {
            "size": list(device.size),
            "focal_px": device.matrix[[0, 1], [0, 1]].tolist(),
            "centre_px": device.matrix[:2, 2].tolist(),
            "distortion": device.coefficients.tolist(),
        }
        for name, device in devices.items()
    }
    pose = calibration.T_projector_camera
    fields["T_projector_camera"] = {
        "rotation_deg": np.degrees(pose.rotation_vector).tolist(),
        "translation_mm": pose.translation.tolist(),
    }
    config.validate({**fields, "rms_px": calibration.rms_px}, CalibrationFile, source)
