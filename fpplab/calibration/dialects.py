"""What other programs call the parts of a calibration: OpenCV, SLStudio, MATLAB, Kalibr, ROS, mrcal.

Each file becomes entries under the names of OpenCV's stereo sample (`M1 D1 M2 D2 R T`), or without a number
(`M D`) where it describes a single device, and the unit of its lengths, where its format defines one.

All but MATLAB's own objects count pixels from (0, 0) at the centre of the first pixel.

Source: OpenCV, `samples/cpp/stereo_calib.cpp`, `samples/cpp/tutorial_code/calib3d/camera_calibration`;
Kalibr, wiki, "yaml formats"; ROS, `sensor_msgs/CameraInfo` and `geometry_msgs/TransformStamped`; MathWorks,
"stereoParameters" and `toStruct`; J.-Y. Bouguet, "Camera Calibration Toolbox for Matlab"; mrcal, "Camera
model representation".
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fpplab.core import config
from fpplab.core.archives import load_arrays
from fpplab.core.errors import ConfigError
from fpplab.core.file_kinds import CALIBRATION, describe_file, naming_other_kinds
from fpplab.core.files import no_such_file, open_regular
from fpplab.core.foreign import OPENCV_STARTS, read_apart
from fpplab.core.geometry import RigidTransform
from fpplab.core.strict_json import parse_object

NAMES: dict[str, tuple[str, ...]] = {
    "M1": (
        *("M1", "K1", "cam_K", "Kc", "cameraMatrix1", "camera_matrix_1", "camera_matrix1", "cam_int", "mtx1"),
        *("mtxL", "intrinsicMatrix1", "KK_left"),
    ),
    "D1": (
        *("D1", "cam_kc", "kc", "distCoeffs1", "distortion_coefficients_1", "dist_coeffs_1", "dist_coeffs1"),
        *("cam_dist", "dist1", "distL", "distortionCoefficients1", "kc_left"),
    ),
    "M2": (
        *("M2", "K2", "proj_K", "Kp", "cameraMatrix2", "camera_matrix_2", "camera_matrix2", "proj_int"),
        *("mtx2", "mtxR", "intrinsicMatrix2", "KK_right"),
    ),
    "D2": (
        *("D2", "proj_kc", "kp", "distCoeffs2", "distortion_coefficients_2", "dist_coeffs_2", "dist_coeffs2"),
        *("proj_dist", "dist2", "distR", "distortionCoefficients2", "kc_right"),
    ),
    "R": ("R", "Rp", "rotation", "rotation_matrix", "rotationOfCamera2", "stereoR"),
    "rotation_vector": ("rvec", "om", "rotation_vector"),
    "T": ("T", "Tp", "translation", "translation_vector", "tvec", "translationOfCamera2", "stereoT"),
    "size1": ("image_size1", "camera_size", "cam_size"),
    "size2": ("image_size2", "projector_size", "proj_size"),
    "shape1": ("img_shape", "imageSize"),
    "shape2": ("projectorSize",),
    "width1": ("frameWidth", "nx"),
    "height1": ("frameHeight", "ny"),
    "width2": ("screenResX",),
    "height2": ("screenResY",),
    "lattice2": ("lattice2",),
    "rms_camera": ("rms_camera", "cam_error"),
    "rms_projector": ("rms_projector", "proj_error"),
    "rms_joint": ("rms_joint", "stereo_error"),
}
"""Entries by the names of OpenCV's stereo sample, and their names in other programs. Sizes are width and
height, shapes are rows and columns."""

ALONE: dict[str, tuple[str, ...]] = {
    "M": ("camera_matrix", "cameraMatrix", "Camera_Matrix", "mtx", "K", "intrinsic_matrix"),
    "D": (
        *("distortion_coefficients", "distCoeffs", "Distortion_Coefficients", "dist_coeffs", "dist_coeff"),
        *("dist", "D", "distortion"),
    ),
    "width": ("image_width", "image_Width", "width"),
    "height": ("image_height", "image_Height", "height"),
    "size": ("image_size",),
}
"""Names in the file of a single device: the first such file is the camera's, the second the projector's."""

MM_PER_M = 1e3
WORLD_UNITS = {
    "mm": 1.0,
    "millimeters": 1.0,
    "cm": 10.0,
    "centimeters": 10.0,
    "m": MM_PER_M,
    "meters": MM_PER_M,
}
"""MATLAB's names of units, in mm."""
MRCAL_LENSES = {f"LENSMODEL_{name}": count for name, count in (
    ("PINHOLE", 0), ("OPENCV4", 4), ("OPENCV5", 5), ("OPENCV8", 8), ("OPENCV12", 12)
)}  # fmt: skip
"""mrcal's models that OpenCV has too, and their numbers of coefficients."""


@dataclass(frozen=True)
class ForeignFile:
    """What a file of another program says of a calibration."""

    path: Path
    program: str
    entries: dict[str, tuple[str, Any]]  # name in the file and value, by the names of this module
    mm_per_unit: float | None = None  # of lengths, where the format defines it

    @property
    def is_of_single_device(self) -> bool:
        """Whether it describes the lens of one device without saying which."""
        return not self.entries.keys().isdisjoint(ALONE)


def is_own(path: Path) -> bool:
    """Detect whether a file is a calibration of fpplab, complete or not."""
    return describe_file(path) == CALIBRATION


def read_foreign(path: Path) -> ForeignFile:
    with naming_other_kinds(path, "foreign calibration"):
        return _read_foreign(path)


def _read_foreign(path: Path) -> ForeignFile:
    if _is_mat(path):
        return _of_matlab(path, _apart("mat", path, "MATLAB"))
    if path.suffix.lower() == ".npz":
        return _of_names(path, "NumPy", _npz(path))
    text = config.read_text(path).lstrip()
    if path.suffix.lower() == ".cameramodel" or "'lensmodel'" in text:
        return _of_mrcal(path, _apart("mrcal", path, "mrcal"))
    if text.startswith("{"):
        return _of_names(path, "OpenCV", _plain_matrices(_json(path, text)))
    if _is_opencv(text):
        return _of_names(path, "OpenCV", _apart("opencv", path, "OpenCV"))
    content = config.parse_yaml(text, path)
    if not isinstance(content, dict):
        raise ConfigError(
            f"{path}: has no entries by name, as calibrations of all programs that are read have"
        )
    for detects, convert in PLAIN_FORMATS:
        if detects(content):
            return convert(path, content)
    return _of_names(path, "OpenCV", _plain_matrices(content))


def _is_mat(path: Path) -> bool:
    try:
        with open_regular(path) as stream:
            return path.suffix.lower() == ".mat" or stream.read(6) == b"MATLAB"
    except OSError:
        return False  # whoever reads it says why it cannot be read


def _is_opencv(text: str) -> bool:
    return text.lstrip().startswith(OPENCV_STARTS) or "!!opencv" in text  # a tag, where the header is missing


def _apart(kind: str, path: Path, program: str) -> dict[str, Any]:
    try:
        return {name: value if value.ndim else value.item() for name, value in read_apart(kind, path).items()}
    except ValueError as error:
        if "codec can't decode" in str(error):
            raise ConfigError(f"{path}: is not in UTF-8, as files of {program} are; save it so") from error
        if "Unknown mat file type" in str(error):
            raise ConfigError(f"{path}: is damaged, or of MATLAB's version 7.3; save it with -v7") from error
        raise ConfigError(
            f"{path}: is not readable as a file of {program} ({error}); write it again"
        ) from error


def _npz(path: Path) -> dict[str, Any]:
    """Read the arrays of an NPZ file that have the name of an entry, as OpenCV's tutorials save them."""
    names = {name for table in (NAMES, ALONE) for names in table.values() for name in names}
    try:
        arrays = load_arrays(path, names)
    except FileNotFoundError:
        raise ConfigError(no_such_file(path)) from None
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: is not readable as NPZ ({error}); write it again") from error
    return {
        name: np.asarray(value, np.float64) if value.ndim else float(value) for name, value in arrays.items()
    }


def _json(path: Path, text: str) -> dict[str, Any]:
    try:
        return parse_object(text)
    except ValueError as error:
        raise ConfigError(f"{path}: is not readable as JSON of OpenCV ({error}); write it again") from error


def _plain_matrices(content: dict[Any, Any]) -> dict[str, Any]:
    return {str(name): _plain_matrix(value) for name, value in content.items()}


def _plain_matrix(value: Any) -> Any:
    if isinstance(value, dict) and {"rows", "cols", "data"} <= value.keys():
        try:
            return np.array(value["data"], np.float64).reshape(int(value["rows"]), int(value["cols"]))
        except (TypeError, ValueError, OverflowError):
            return value
    if isinstance(value, list):
        try:
            return np.array(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            return value
    return float(value) if isinstance(value, int) else value


def _of_names(
    path: Path, program: str, content: dict[str, Any], mm_per_unit: float | None = None
) -> ForeignFile:
    """Collect the entries that are known by their names."""
    meanings = {name: what for table in (NAMES, ALONE) for what, names in table.items() for name in names}
    entries: dict[str, tuple[str, Any]] = {}
    is_alone = any(meanings.get(name) in ("M", "D") for name in content)
    for name, value in content.items():
        what = meanings.get(name)
        if what is None or (is_alone and name in ("rvec", "tvec")):  # there, the pose of a board
            continue
        if what in entries:
            raise ConfigError(f"{path}: '{name}' says again what '{entries[what][0]}' says; keep one")
        entries[what] = name, value
    if not entries:
        names = ", ".join(str(name) for name in list(content)[:8]) or "nothing"
        raise ConfigError(
            f"{path}: has no entry of a calibration that is known; it has {names}; write it as OpenCV's "
            "FileStorage with M1 D1 M2 D2 R T"
        )
    return ForeignFile(path, program, entries, mm_per_unit)


# Kalibr


def _is_kalibr(content: dict[Any, Any]) -> bool:
    return isinstance(content.get("cam0"), dict)


def _of_kalibr(path: Path, content: dict[str, Any]) -> ForeignFile:
    devices = sorted(name for name in content if str(name).startswith("cam") and str(name)[3:].isdigit())
    if devices != ["cam0", "cam1"]:
        raise ConfigError(
            f"{path}: this camchain of Kalibr has {', '.join(devices)}; expected cam0, the camera, and cam1, "
            "the projector"
        )
    entries: dict[str, tuple[str, Any]] = {}
    for number, name in enumerate(devices, 1):
        device = content[name]
        model, lens = device.get("camera_model"), device.get("distortion_model")
        if model != "pinhole" or lens not in ("radtan", "none"):
            raise ConfigError(
                f"{path}: '{name}' has Kalibr's model {model}-{lens}, which is not read; calibrate with "
                "pinhole-radtan"
            )
        entries[f"M{number}"] = f"{name}.intrinsics", _matrix_of(device.get("intrinsics"))
        entries[f"D{number}"] = f"{name}.distortion_coeffs", _plain_matrix(device.get("distortion_coeffs"))
        entries[f"size{number}"] = f"{name}.resolution", _plain_matrix(device.get("resolution"))
    pose = _plain_matrix(content["cam1"].get("T_cn_cnm1"))
    if not isinstance(pose, np.ndarray) or pose.shape != (4, 4):
        raise ConfigError(f"{path}: 'cam1' of this camchain of Kalibr has no 'T_cn_cnm1' of 4 x 4 numbers")
    entries["R"], entries["T"] = ("cam1.T_cn_cnm1", pose[:3, :3]), ("cam1.T_cn_cnm1", pose[:3, 3])
    return ForeignFile(path, "Kalibr", entries, MM_PER_M)


def _matrix_of(intrinsics: Any) -> Any:
    """The matrix of fx, fy, cx, cy; what is not these is given back."""
    numbers = _plain_matrix(intrinsics)
    if not isinstance(numbers, np.ndarray) or numbers.shape != (4,):
        return intrinsics
    fx, fy, cx, cy = numbers
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


# ROS


def _is_camera_info(content: dict[Any, Any]) -> bool:
    return "distortion_model" in content or "projection_matrix" in content


def _of_camera_info(path: Path, content: dict[str, Any]) -> ForeignFile:
    lens = content.get("distortion_model", "plumb_bob")
    if lens not in ("plumb_bob", "rational_polynomial"):
        raise ConfigError(
            f"{path}: has ROS' distortion model {lens}, which is not read; calibrate with plumb_bob or "
            "rational_polynomial"
        )
    known = {name: value for name, value in content.items() if name not in ("R", "P", "distortion_model")}
    return _of_names(path, "ROS", _plain_matrices(known), MM_PER_M)


def _is_ros_transform(content: dict[Any, Any]) -> bool:
    return isinstance(content.get("transform"), dict) and "child_frame_id" in content


def _of_ros_transform(path: Path, content: dict[str, Any]) -> ForeignFile:
    """Read a stamped transform, which takes coordinates in the child's frame to the parent's."""
    header, child = content.get("header"), str(content["child_frame_id"])
    parent = str(header.get("frame_id")) if isinstance(header, dict) else ""
    if ("proj" in parent.lower()) == ("proj" in child.lower()):
        raise ConfigError(
            f"{path}: this transform of ROS is from '{child}' to '{parent}'; expected 'projector' in the "
            "name of one of these frames"
        )
    try:
        transform = content["transform"]
        translation = np.array([transform["translation"][axis] for axis in "xyz"], np.float64)
        rotation = Rotation.from_quat([float(transform["rotation"][axis]) for axis in "xyzw"])
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{path}: this transform of ROS has no translation x y z and rotation x y z w of numbers"
        ) from error
    pose = RigidTransform(np.asarray(rotation.as_matrix()), translation)
    T_projector_camera = pose if "proj" in parent.lower() else pose.inverse()
    entries = {
        "R": ("transform.rotation", T_projector_camera.rotation),
        "T": ("transform.translation", T_projector_camera.translation),
    }
    return ForeignFile(path, "ROS", entries, MM_PER_M)


FormatDetector = Callable[[dict[Any, Any]], bool]
FormatConverter = Callable[[Path, dict[str, Any]], ForeignFile]

PLAIN_FORMATS: tuple[tuple[FormatDetector, FormatConverter], ...] = (
    (_is_kalibr, _of_kalibr),
    (_is_ros_transform, _of_ros_transform),
    (_is_camera_info, _of_camera_info),
)
"""Formats in plain YAML, each with what it is detected by."""


# mrcal


def _of_mrcal(path: Path, content: dict[str, Any]) -> ForeignFile:
    model, intrinsics = content.get("lensmodel"), content.get("intrinsics")
    if model not in MRCAL_LENSES:
        raise ConfigError(
            f"{path}: has mrcal's model {model}, which is not read; mrcal-convert-lensmodel fits one of "
            f"{', '.join(MRCAL_LENSES)}"
        )
    if not isinstance(intrinsics, np.ndarray) or intrinsics.shape != (4 + MRCAL_LENSES[model],):
        raise ConfigError(f"{path}: 'intrinsics' must be {4 + MRCAL_LENSES[model]} numbers for {model}")
    lens = intrinsics[4:] if MRCAL_LENSES[model] else np.zeros(5)
    entries: dict[str, tuple[str, Any]] = {
        "M": ("intrinsics", _matrix_of(intrinsics[:4].tolist())),
        "D": ("intrinsics", lens),
        "size": ("imagersize", content.get("imagersize")),
    }
    pose = next((name for name in ("rt_cam_ref", "extrinsics") if name in content), None)
    if pose is not None:
        entries["pose"] = pose, content[pose]
    return ForeignFile(path, "mrcal", entries, MM_PER_M)


# MATLAB


def _of_matlab(path: Path, content: dict[str, Any]) -> ForeignFile:
    inside = [name.removesuffix("CameraParameters1.RadialDistortion") for name in content]
    structure = next((name for name in inside if name not in content), None)
    if structure is None:
        flat = {
            name: np.ravel(value) if isinstance(value, np.ndarray) and 1 in value.shape else value
            for name, value in content.items()
        }
        return _of_names(path, "MATLAB", {name: _scalar(value) for name, value in flat.items()})
    return _of_stereo_parameters(path, structure, content)


def _scalar(value: Any) -> Any:
    return value.item() if isinstance(value, np.ndarray) and value.size == 1 else value


def _of_stereo_parameters(path: Path, structure: str, content: dict[str, Any]) -> ForeignFile:
    """Convert `toStruct(stereoParams)`: MATLAB multiplies rows from the left and counts pixels from 1."""

    def numbers(*names: str) -> tuple[str, Any]:
        name = next((structure + name for name in names if structure + name in content), None)
        if name is None:
            raise ConfigError(
                f"{path}: has no '{structure}{names[-1]}', as MATLAB's toStruct(stereoParams) has"
            )
        return name, content[name]

    entries: dict[str, tuple[str, Any]] = {}
    for number in (1, 2):
        device = f"CameraParameters{number}."
        name, matrix = numbers(f"{device}K", f"{device}IntrinsicMatrix")
        matrix = np.array(matrix.T if name.endswith("IntrinsicMatrix") else matrix, np.float64)
        matrix[:2, 2] -= 1.0
        entries[f"M{number}"] = name, matrix
        name, radial = numbers(f"{device}RadialDistortion")
        tangential = np.ravel(numbers(f"{device}TangentialDistortion")[1])
        entries[f"D{number}"] = name, np.concatenate([np.ravel(radial)[:2], tangential, np.ravel(radial)[2:]])
        name, shape = numbers(f"{device}ImageSize")
        if np.size(shape):
            entries[f"shape{number}"] = name, shape
    name, rotation = numbers("RotationOfCamera2")
    entries["R"] = name, np.transpose(rotation)
    entries["T"] = numbers("TranslationOfCamera2")
    unit = content.get(f"{structure}WorldUnits")
    if unit is not None and unit not in WORLD_UNITS:
        raise ConfigError(f"{path}: 'WorldUnits' is {unit!r}; expected one of {', '.join(WORLD_UNITS)}")
    return ForeignFile(path, "MATLAB", entries, None if unit is None else WORLD_UNITS[unit])
