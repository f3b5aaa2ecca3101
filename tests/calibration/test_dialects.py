"""Calibrations of other programs, as their own writers write them, are read or named with what to do."""

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.io import savemat
from typer.testing import CliRunner

from fpplab.calibration.interchange import import_calibration
from fpplab.calibration.model import Calibration
from fpplab.calibration.variants import export_calibration
from fpplab.cli.every import app
from fpplab.core.conventions import Lattice
from fpplab.core.errors import ConfigError
from tests.calibration.examples import calibration
from tests.calibration.test_interchange import write

pytestmark = pytest.mark.usefixtures("foreign_files_read_here")

KNOWN = calibration()
POSE = KNOWN.T_projector_camera
K1, K2 = KNOWN.camera.matrix, KNOWN.projector.matrix
D1, D2 = KNOWN.camera.coefficients, KNOWN.projector.coefficients
R, T = POSE.rotation, POSE.translation
SIZES = {"camera_size": (1368, 912), "projector_size": (912, 1140)}


def check(given: Calibration) -> None:
    """All numbers are those of the known calibration."""
    for device, known in ((given.camera, KNOWN.camera), (given.projector, KNOWN.projector)):
        assert (device.size, device.lattice) == (known.size, known.lattice)
        np.testing.assert_allclose(device.matrix, known.matrix, rtol=0, atol=1e-9)
        np.testing.assert_allclose(device.distortion, known.distortion, rtol=0, atol=1e-15)
    np.testing.assert_allclose(given.T_projector_camera.matrix, POSE.matrix, rtol=0, atol=1e-10)


def read(*paths: Path, **given: Any) -> Calibration:
    return import_calibration(list(paths), lattice=Lattice.DIAMOND, **given)


def pinhole(matrix: np.ndarray) -> list[float]:
    return [float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2))]


# Kalibr: github.com/ethz-asl/kalibr/wiki/yaml-formats


def camchain(**changes: Any) -> dict[str, Any]:
    lens = D1.copy()
    lens[4] = 0.0  # radtan has four coefficients
    devices = {
        f"cam{number}": {
            "camera_model": "pinhole",
            "cam_overlaps": [1 - number],
            "distortion_coeffs": coefficients[:4].tolist(),
            "distortion_model": "radtan",
            "intrinsics": pinhole(matrix),
            "resolution": list(size),
            "rostopic": f"/cam{number}/image_raw",
        }
        for number, matrix, coefficients, size in ((0, K1, lens, (1368, 912)), (1, K2, D2, (912, 1140)))
    }
    pose = POSE.matrix.copy()
    pose[:3, 3] /= 1000.0
    devices["cam1"] |= {"T_cn_cnm1": pose.tolist(), **changes}
    return devices


def test_a_camchain_of_kalibr_is_in_m(tmp_path: Path) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(yaml.safe_dump(camchain()))
    given = read(path)
    np.testing.assert_allclose(given.T_projector_camera.matrix, POSE.matrix, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(given.camera.matrix, K1)
    assert given.camera.coefficients.tolist() == [*D1[:4], 0.0]
    assert given.projector.size == (912, 1140)
    with pytest.raises(ConfigError, match=r"stand 0\.1207 mm apart"):
        read(path, mm_per_unit=1.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"distortion_model": "equidistant"},
            "'cam1' has Kalibr's model pinhole-equidistant, which is not read",
        ),
        ({"camera_model": "omni"}, "Kalibr's model omni-radtan"),
        ({"T_cn_cnm1": None}, "no 'T_cn_cnm1' of 4 x 4"),
        ({"intrinsics": [1, 2, 3]}, r"'cam1\.intrinsics' is not a matrix"),
    ],
)
def test_what_kalibr_has_and_fpplab_has_not_is_named(
    changes: dict[str, Any], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(yaml.safe_dump(camchain(**changes)))
    with pytest.raises(ConfigError, match=words):
        read(path)
    path.write_text(yaml.safe_dump({**camchain(), "cam2": {}}))
    with pytest.raises(ConfigError, match="has cam0, cam1, cam2; expected cam0, the camera, and cam1"):
        read(path)


# ROS: camera_calibration_parsers, sensor_msgs/CameraInfo


def test_ros_has_a_file_of_each_device_and_a_transform_in_m(tmp_path: Path) -> None:
    export_calibration(KNOWN, tmp_path / "ros", "ros")
    files = [tmp_path / "ros" / f"{name}.yaml" for name in ("camera", "projector", "transform")]
    check(read(*files))
    with pytest.raises(ConfigError, match=r"has no entry 'R' .* give the file that has R and T"):
        read(*files[:2])
    turned = yaml.safe_load(files[2].read_text())
    turned["header"]["frame_id"], turned["child_frame_id"] = "cam0", "cam1"
    files[2].write_text(yaml.safe_dump(turned))
    with pytest.raises(ConfigError, match="transform of ROS is from 'cam1' to 'cam0'; expected 'projector'"):
        read(*files)
    info = yaml.safe_load(files[0].read_text())
    files[0].write_text(yaml.safe_dump({**info, "distortion_model": "equidistant"}))
    with pytest.raises(ConfigError, match="has ROS' distortion model equidistant, which is not read"):
        read(*files)


# MATLAB


@pytest.mark.parametrize("layout", ["matlab", "bouguet"])
def test_matlabs_files_are_read_back(layout: str, tmp_path: Path) -> None:
    path = tmp_path / "CALIB.MAT"
    export_calibration(KNOWN, path, layout)
    check(read(path, projector_size=(912, 1140)))


@pytest.mark.parametrize(("top", "is_new"), [(None, False), ("s", True)])
def test_matlabs_own_structure_counts_from_1_and_is_transposed(
    top: str | None, is_new: bool, tmp_path: Path
) -> None:
    def device(matrix: np.ndarray, lens: np.ndarray, size: tuple[int, int]) -> dict[str, Any]:
        moved = matrix + [[0, 0, 1], [0, 0, 1], [0, 0, 0]]
        return {
            "RadialDistortion": lens[[0, 1, 4]],
            "TangentialDistortion": lens[2:4],
            "ImageSize": size[::-1],
            **({"K": moved} if is_new else {"IntrinsicMatrix": moved.T}),
        }

    parameters = {
        "CameraParameters1": device(K1, D1, (1368, 912)),
        "CameraParameters2": device(K2, D2, (912, 1140)),
        "RotationOfCamera2": R.T,
        "TranslationOfCamera2": T / 10.0,
        "WorldUnits": "centimeters",
    }
    savemat(tmp_path / "stereo.mat", {top: parameters} if top else parameters)
    check(read(tmp_path / "stereo.mat"))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("testhdf5_7.4_GLNX86", "MATLAB .*version 7.3; in MATLAB, save"),
        ("parabola", "MATLAB .*holds objects, which only MATLAB can read; .*toStruct"),
        ("testdouble_7.4_GLNX86", "has no entry of a calibration that is known; it has testdouble"),
        ("malformed1", "is not readable as a file of MATLAB"),
    ],
)
def test_what_only_matlab_reads_is_named(name: str, words: str, tmp_path: Path) -> None:
    """The files are those that MATLAB itself wrote for SciPy's tests."""
    spec = find_spec("scipy.io.matlab")
    assert spec is not None
    assert spec.origin is not None
    given = Path(spec.origin).parent / "tests" / "data" / f"{name}.mat"
    if not given.is_file():
        pytest.skip("this SciPy comes without the files of its tests")
    (tmp_path / "c.mat").write_bytes(given.read_bytes())
    with pytest.raises(ConfigError, match=rf"c\.mat: .*{words}"):
        read(tmp_path / "c.mat", **SIZES)


# mrcal: mrcal.secretsauce.net/cameramodels.html


def mrcal(lens: str, matrix: np.ndarray, coefficients: np.ndarray, pose: str, size: tuple[int, int]) -> str:
    numbers = [*pinhole(matrix), *coefficients.tolist()]
    return f"""# generated on 2026-01-01
{{
    'lensmodel':  '{lens}',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': {numbers},
    {pose},
    'imagersize': {list(size)},
    'icam_intrinsics': 0,
}}
"""


def test_models_of_mrcal_have_each_its_pose_in_m(tmp_path: Path) -> None:
    camera, projector = tmp_path / "camera-0.cameramodel", tmp_path / "camera-1.cameramodel"
    numbers = ", ".join(str(float(value)) for value in (*POSE.rotation_vector, *(T / 1000)))
    camera.write_text(mrcal("LENSMODEL_OPENCV5", K1, D1, "'extrinsics': [ 0, 0, 0, 0, 0, 0,]", (1368, 912)))
    projector.write_text(
        mrcal("LENSMODEL_OPENCV8", K2, np.append(D2, [0, 0, 0]), f"'rt_cam_ref': [ {numbers} ]", (912, 1140))
    )
    check(read(camera, projector))
    camera.write_text(mrcal("LENSMODEL_CAHVOR", K1, D1, "'extrinsics': [ 0, 0, 0, 0, 0, 0,]", (1368, 912)))
    with pytest.raises(ConfigError, match=r"has mrcal's model LENSMODEL_CAHVOR, .*mrcal-convert-lensmodel"):
        read(camera, projector)
    camera.write_text("{'lensmodel': " + "[" * 100_000)
    with pytest.raises(ConfigError, match="is not readable as a file of mrcal"):
        read(camera, projector)


# OpenCV, in text that other programs write


def matrix(name: str, values: np.ndarray, tag: str = "") -> str:
    values = np.atleast_2d(values)
    data = ", ".join(repr(float(value)) for value in values.ravel())
    rows, cols = values.shape
    return f"{name}:{tag}\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"


STEREO = {"M1": K1, "D1": D1, "M2": K2, "D2": D2, "R": R, "T": T[:, None]}
PROCAM = dict(
    zip(
        ("cam_int", "cam_dist", "proj_int", "proj_dist", "rotation", "translation"),
        STEREO.values(),
        strict=True,
    )
)


@pytest.mark.parametrize(
    "head", ["%YAML:1.0\n---\n", "%YAML 1.0\n---\n", "---\n", "", "\ufeff%YAML:1.0\n---\n", "\ufeff"]
)
@pytest.mark.parametrize("tag", [" !!opencv-matrix", ""])
def test_yaml_with_and_without_its_header_and_tags(head: str, tag: str, tmp_path: Path) -> None:
    path = tmp_path / "stereo.yaml"
    path.write_text(
        head + "".join(matrix(name, values, tag) for name, values in STEREO.items()), encoding="utf-8"
    )
    check(read(path, **SIZES))


@pytest.mark.parametrize(
    "names",
    [
        ("mtx1", "dist1", "mtx2", "dist2", "R", "T"),
        ("mtxL", "distL", "mtxR", "distR", "R", "T"),
        ("K1", "D1", "K2", "D2", "R", "T"),
        (
            "camera_matrix1",
            "dist_coeffs1",
            "camera_matrix2",
            "dist_coeffs2",
            "rotation_matrix",
            "translation_vector",
        ),
    ],
)
def test_lists_of_lists_as_python_writes_them(names: tuple[str, ...], tmp_path: Path) -> None:
    content = {name: values.tolist() for name, values in zip(names, STEREO.values(), strict=True)}
    (tmp_path / "stereo.json").write_text(json.dumps(content))
    check(read(tmp_path / "stereo.json", **SIZES))
    (tmp_path / "stereo.yaml").write_text(yaml.safe_dump(content))
    check(read(tmp_path / "stereo.yaml", **SIZES))


@pytest.mark.parametrize("suffix", [".json", ".xml"])
def test_procam_calibration_gives_rows_before_columns(suffix: str, tmp_path: Path) -> None:
    path = write(
        tmp_path / f"calibration_result{suffix}", {"img_shape": np.array([912, 1368]), "rms": 0.5, **PROCAM}
    )
    check(read(path, projector_size=(912, 1140)))


def test_a_rotation_vector_is_a_rotation_but_a_boards_pose_is_not_the_rigs(tmp_path: Path) -> None:
    content = {name: values for name, values in STEREO.items() if name not in "RT"}
    vectors = {"rvec": POSE.rotation_vector, "tvec": T}
    check(read(write(tmp_path / "stereo.yml", {**content, **vectors}), **SIZES))
    camera = write(tmp_path / "camera.yml", {"mtx": K1, "dist": D1, **vectors})
    projector = write(tmp_path / "projector.yml", {"mtx": K2, "dist": D2})
    with pytest.raises(ConfigError, match="has no entry 'R'"):
        read(camera, projector, **SIZES)
    check(read(camera, projector, write(tmp_path / "pose.yml", vectors), **SIZES))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "name: bench\ncamera: {backend: video}\n",
            "is a rig file; expected a calibration: fpplab's own",
        ),
        ("<html><body>", "is a page in HTML; expected a calibration"),
        ("[1, 2]", "has no entries by name"),
        ("{ not json", "is not readable as JSON of OpenCV"),
        ("{'lensmodel': 3", "is not readable as a file of mrcal"),
    ],
)
def test_a_refusal_says_only_what_was_found(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "some.yaml"
    path.write_text(text)
    refused = CliRunner().invoke(app, ["convert", str(path), "--out", str(tmp_path / "out.yaml")]).exception
    assert isinstance(refused, ConfigError)
    assert words in str(refused)
    assert "calibration of fpplab" not in str(refused)


@pytest.mark.parametrize(
    ("coding", "words"), [("utf-16", "is not in UTF-8"), ("utf-16-le", "without its mark")]
)
def test_a_calibration_in_another_coding_is_refused(coding: str, words: str, tmp_path: Path) -> None:
    path = write(tmp_path / "stereo.yml", STEREO)
    path.write_text(path.read_text(), encoding=coding)
    refused = CliRunner().invoke(app, ["convert", str(path), "--out", str(tmp_path / "out.yaml")]).exception
    assert isinstance(refused, ConfigError)
    assert words in str(refused)


@pytest.mark.parametrize(("unit", "mm"), [("um", 1e-3), ("m", 1000.0), ("cm", 10.0), ("inch", 25.4)])
def test_lengths_in_another_unit_are_converted_on_request(unit: str, mm: float, tmp_path: Path) -> None:
    path, out = write(tmp_path / "stereo.yml", {**STEREO, "T": T[:, None] / mm}), tmp_path / "out.yaml"
    words = ["convert", str(path), "--out", str(out), "--lattice", "diamond"]
    words += ["--camera-size", "1368", "912", "--projector-size", "912", "1140"]
    taken = CliRunner().invoke(app, words)
    if unit in ("um", "m"):
        assert isinstance(taken.exception, ConfigError)
        assert unit in str(taken.exception).rpartition("--unit ")[2].strip(")").split(" or ")
    else:  # possible in mm too, so that the user is told
        baseline = np.linalg.norm(T) / mm
        said = f"states no unit of length; in mm, camera and projector stand {baseline:.4g} mm apart"
        assert said in " ".join(taken.output.split())
    assert CliRunner().invoke(app, [*words, "--unit", unit, "--force"]).exit_code == 0
    check(Calibration.load(out))
