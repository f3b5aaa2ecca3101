"""Calibrations in the files of other programs: SLStudio, MATLAB, Bouguet's toolbox, ROS, and tables.

All count pixels as fpplab does, with (0, 0) at the centre of the first pixel: MATLAB's own functions count
from 1, and `stereoParametersFromOpenCV`, for which the file is made, adds the difference.

Source: J. Wilm, SLStudio, `CalibrationData.cpp`; MathWorks, "stereoParametersFromOpenCV"; J.-Y. Bouguet,
"Camera Calibration Toolbox for Matlab", "Calibrating a stereo system"; ROS, `camera_calibration_parsers` and
`sensor_msgs/CameraInfo`.
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from fpplab.calibration.interchange import Format, to_opencv
from fpplab.calibration.model import INTRINSICS, POSE, Calibration
from fpplab.core.errors import ConfigError
from fpplab.core.files import make_directory, write_atomic, write_text
from fpplab.core.geometry import POLYNOMIAL, Pinhole, RigidTransform
from fpplab.core.tables import Row, write_csv

UNITS = {"fx": "px", "fy": "px", "cx": "px", "cy": "px", "rx": "deg", "ry": "deg", "rz": "deg"}
UNITS |= dict.fromkeys(("x", "y", "z"), "mm")
"""Of the parameters in tables; coefficients of lenses have none."""
ROS_FRAMES = "camera_optical_frame", "projector_optical_frame"


def export_calibration(calibration: Calibration, path: Path | str, layout: str | None = None) -> None:
    """Write a calibration for another program: the file is complete or unchanged."""
    path = Path(path)
    chosen = layout or layout_of(path)
    if chosen not in LAYOUTS:
        raise ConfigError(f"layout: '{chosen}' must be one of {', '.join(LAYOUTS)}")
    suffixes, write = LAYOUTS[chosen]
    if path.suffix.lower() not in suffixes:
        ends = f"end in {' or '.join(suffixes)}" if suffixes[0] else "have no suffix, for it will be a folder"
        raise ConfigError(f"{path}: for {chosen}, its name must {ends}")
    write(calibration, path)


def layout_of(path: Path) -> str:
    for name, (suffixes, _) in LAYOUTS.items():
        if path.suffix.lower() in suffixes:
            return name
    all_suffixes = [suffix for suffixes, _ in LAYOUTS.values() for suffix in suffixes if suffix]
    raise ConfigError(f"{path}: its name must end in one of {', '.join(dict.fromkeys(all_suffixes))}")


def parameter_rows(calibration: Calibration) -> list[Row]:
    pose = calibration.T_projector_camera
    values = {
        f"{name}.{term}": value
        for name, device in (("camera", calibration.camera), ("projector", calibration.projector))
        for term, value in zip(INTRINSICS, device.intrinsics.tolist(), strict=True)
    }
    turned = (*np.degrees(pose.rotation_vector), *pose.translation)
    values |= {f"T_projector_camera.{term}": value for term, value in zip(POSE, turned, strict=True)}
    sigmas = calibration.uncertainty.sigma if calibration.uncertainty else {}
    rows: list[Row] = []
    for name, value in values.items():
        unit, sigma = UNITS.get(name.rpartition(".")[2], ""), sigmas.get(name)
        if sigma is not None and unit == "deg":
            sigma = float(np.degrees(sigma))
        rows.append({"parameter": name, "value": float(value), "unit": unit, "sigma": sigma})
    return rows


def _five(device: Pinhole, layout: str) -> NDArray[np.float64]:
    """The coefficients of the polynomial model, for layouts that have no others."""
    if np.any(device.coefficients[POLYNOMIAL:]):
        raise ConfigError(
            f"layout: '{layout}' has no place for rational distortion (k4, k5, k6); use opencv or ros, or "
            "characterise without it"
        )
    return np.asarray(device.coefficients[:POLYNOMIAL], np.float64)


def _write_opencv(calibration: Calibration, path: Path) -> None:
    kinds: dict[str, Format] = {".xml": "xml", ".yml": "yaml", ".json": "json"}
    write_text(path, to_opencv(calibration, kinds[path.suffix.lower()]))


def _write_slstudio(calibration: Calibration, path: Path) -> None:
    storage = cv2.FileStorage(
        "", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_XML
    )
    pose, rms = calibration.T_projector_camera, calibration.rms_px
    for letter, device in (("c", calibration.camera), ("p", calibration.projector)):
        storage.write(f"K{letter}", device.matrix)
        storage.write(f"k{letter}", _five(device, "slstudio").reshape(-1, 1))
    storage.write("Rp", pose.rotation)
    storage.write("Tp", pose.translation.reshape(3, 1))
    for entry, name in (("cam_error", "camera"), ("proj_error", "projector"), ("stereo_error", "joint")):
        storage.write(entry, rms.get(name, 0.0))
    sizes = (*calibration.camera.size, *calibration.projector.size)
    for entry, value in zip(("frameWidth", "frameHeight", "screenResX", "screenResY"), sizes, strict=True):
        storage.write(entry, int(value))
    write_text(path, str(storage.releaseAndGetString()))


def _write_matlab(calibration: Calibration, path: Path) -> None:
    """The arguments of `stereoParametersFromOpenCV` by their names, and the projector's size."""
    entries: dict[str, Any] = {}
    for number, device in enumerate((calibration.camera, calibration.projector), 1):
        entries[f"intrinsicMatrix{number}"] = device.matrix
        entries[f"distortionCoefficients{number}"] = _five(device, "matlab")
    entries["rotationOfCamera2"] = calibration.T_projector_camera.rotation
    entries["translationOfCamera2"] = calibration.T_projector_camera.translation
    entries["imageSize"] = np.array(calibration.camera.size[::-1], np.float64)  # rows, then columns
    entries["projectorSize"] = np.array(calibration.projector.size[::-1], np.float64)
    _save_mat(entries, path, column=False)


def _write_bouguet(calibration: Calibration, path: Path) -> None:
    """The names of the toolbox's `Calib_Results_stereo.mat`: left is the camera, right the projector."""
    entries: dict[str, Any] = {}
    for side, device in (("left", calibration.camera), ("right", calibration.projector)):
        matrix = device.matrix
        entries |= {f"fc_{side}": np.diag(matrix)[:2], f"cc_{side}": matrix[:2, 2], f"KK_{side}": matrix}
        entries |= {f"alpha_c_{side}": 0.0, f"kc_{side}": _five(device, "bouguet")}
    pose = calibration.T_projector_camera
    entries |= {"om": pose.rotation_vector, "R": pose.rotation, "T": pose.translation}
    entries["nx"], entries["ny"] = (float(side) for side in calibration.camera.size)
    _save_mat(entries, path, column=True)


def _save_mat(entries: dict[str, Any], path: Path, column: bool) -> None:
    content = io.BytesIO()
    savemat(content, entries, oned_as="column" if column else "row")
    write_atomic(path, lambda stream: stream.write(content.getbuffer()))


def _write_ros(calibration: Calibration, path: Path) -> None:
    """A folder with a `camera_info` of each device, and the projector's pose in m as a transform."""
    files = {
        "camera.yaml": _camera_info("camera", calibration.camera),
        "projector.yaml": _camera_info("projector", calibration.projector),
        "transform.yaml": _ros_transform(calibration.T_projector_camera.inverse()),
    }

    def fill(draft: Path) -> None:
        for name, content in files.items():
            text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
            (draft / name).write_text(text, encoding="utf-8")

    make_directory(path, fill)


def _camera_info(name: str, device: Pinhole) -> dict[str, Any]:
    coefficients = device.coefficients
    is_rational = bool(np.any(coefficients[POLYNOMIAL:]))
    lens = coefficients if is_rational else coefficients[:POLYNOMIAL]
    return {
        "image_width": int(device.size[0]),
        "image_height": int(device.size[1]),
        "camera_name": name,
        "camera_matrix": _ros_matrix(device.matrix),
        "distortion_model": "rational_polynomial" if is_rational else "plumb_bob",
        "distortion_coefficients": _ros_matrix(lens.reshape(1, -1)),
        "rectification_matrix": _ros_matrix(np.eye(3)),
        "projection_matrix": _ros_matrix(np.c_[device.matrix, np.zeros(3)]),
    }


def _ros_matrix(matrix: NDArray[Any]) -> dict[str, Any]:
    rows, cols = matrix.shape
    return {"rows": rows, "cols": cols, "data": [float(value) for value in matrix.ravel()]}


def _ros_transform(T_camera_projector: RigidTransform) -> dict[str, Any]:
    parent, child = ROS_FRAMES
    translation_m = (1e-3 * T_camera_projector.translation).tolist()
    rotation = Rotation.from_matrix(T_camera_projector.rotation).as_quat().tolist()
    return {
        "header": {"frame_id": parent},
        "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", translation_m, strict=True)),
            "rotation": dict(zip("xyzw", rotation, strict=True)),
        },
    }


LAYOUTS: dict[str, tuple[tuple[str, ...], Callable[[Calibration, Path], None]]] = {
    "opencv": ((".xml", ".yml", ".json"), _write_opencv),
    "slstudio": ((".xml",), _write_slstudio),
    "matlab": ((".mat",), _write_matlab),
    "bouguet": ((".mat",), _write_bouguet),
    "ros": (("",), _write_ros),
    "table": ((".csv",), lambda calibration, path: write_csv(path, parameter_rows(calibration))),
}
"""Layouts by name, each with the suffixes of its files; a folder has none."""
