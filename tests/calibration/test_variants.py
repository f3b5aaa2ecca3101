"""Calibrations in the files of other programs, read back as those programs read them."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from fpplab.calibration.interchange import import_calibration
from fpplab.calibration.model import Calibration
from fpplab.calibration.variants import LAYOUTS, export_calibration
from fpplab.core.conventions import Lattice
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import RigidTransform
from tests.calibration.examples import POLYNOMIAL, RATIONAL, calibration

pytestmark = pytest.mark.usefixtures("foreign_files_read_here")

POINTS = np.array([[10.0, -5.0, 450.0], [-40.0, 30.0, 500.0], [80.0, 55.0, 390.0]])


def seen(made: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of camera and projector that see the points."""
    return made.camera.project(POINTS), made.projector.project(made.T_projector_camera.apply(POINTS))


def same(made: Calibration, told: Calibration, atol: float = 0.0) -> None:
    for mine, other in ((made.camera, told.camera), (made.projector, told.projector)):
        assert (mine.size, mine.lattice) == (other.size, other.lattice)
        np.testing.assert_array_equal(mine.matrix, other.matrix)
        np.testing.assert_array_equal(mine.coefficients, other.coefficients)
    pose, expected = made.T_projector_camera, told.T_projector_camera
    np.testing.assert_allclose(pose.matrix, expected.matrix, rtol=0, atol=max(atol, 1e-14))
    assert made.rms_px == told.rms_px


@pytest.mark.parametrize("suffix", [".xml", ".yml", ".json"])
@pytest.mark.parametrize("lens", [POLYNOMIAL, RATIONAL], ids=["polynomial", "rational"])
def test_opencv(suffix: str, lens: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / f"stereo{suffix}"
    export_calibration(calibration(lens), str(path))
    same(import_calibration([path]), calibration(lens))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("M1").mat(), calibration().camera.matrix)


def test_slstudio(tmp_path: Path) -> None:
    path = tmp_path / "slstudio.xml"
    export_calibration(calibration(), path, "slstudio")
    same(import_calibration([path], lattice=Lattice.DIAMOND), calibration())
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    names = ("Kc", "kc", "Kp", "kp", "Rp", "Tp")
    shapes = [storage.getNode(name).mat().shape for name in names]
    assert shapes == [(3, 3), (5, 1), (3, 3), (5, 1), (3, 3), (3, 1)]
    assert (storage.getNode("frameWidth").real(), storage.getNode("screenResY").real()) == (1368, 1140)
    assert storage.getNode("stereo_error").real() == 0.07


def test_matlab(tmp_path: Path) -> None:
    """What `stereoParametersFromOpenCV` is given projects points as OpenCV does."""
    path = tmp_path / "calibration.mat"
    export_calibration(calibration(), path)
    found = loadmat(path)
    assert found["imageSize"].tolist() == [[912, 1368]]
    assert found["distortionCoefficients1"].shape == (1, 5)
    assert found["translationOfCamera2"].shape == (1, 3)
    camera, projector = seen(calibration())
    rotation, _ = cv2.Rodrigues(found["rotationOfCamera2"])
    for number, pose, expected in (
        (1, (np.zeros(3), np.zeros(3)), camera),
        (2, (rotation, found["translationOfCamera2"]), projector),
    ):
        matrix, lens = found[f"intrinsicMatrix{number}"], found[f"distortionCoefficients{number}"]
        pixels, _ = cv2.projectPoints(POINTS, *pose, matrix, lens)
        np.testing.assert_allclose(pixels[:, 0], expected, rtol=0, atol=1e-8)


def test_bouguet(tmp_path: Path) -> None:
    """The toolbox's `project_points2`, written out: X_right = R(om) X_left + T, pixels from 0."""
    path = tmp_path / "Calib_Results_stereo.mat"
    export_calibration(calibration(), path, "bouguet")
    found = loadmat(path)
    turned = Rotation.from_rotvec(found["om"].ravel()).as_matrix()
    np.testing.assert_allclose(turned, found["R"], rtol=0, atol=1e-14)
    sides = {"left": POINTS, "right": POINTS @ turned.T + found["T"].T}
    for (side, points), expected in zip(sides.items(), seen(calibration()), strict=True):
        x, y = (points[:, :2] / points[:, 2:]).T
        k1, k2, p1, p2, k3 = found[f"kc_{side}"].ravel()
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        bent = np.c_[
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
        pixels = bent * found[f"fc_{side}"].ravel() + found[f"cc_{side}"].ravel()
        np.testing.assert_allclose(pixels, expected, rtol=0, atol=1e-8)
    assert (found["fc_left"].shape, found["alpha_c_left"].item()) == ((2, 1), 0.0)
    assert (found["nx"].item(), found["ny"].item()) == (1368, 912)


@pytest.mark.parametrize(
    ("lens", "model"),
    [(POLYNOMIAL, "plumb_bob"), (RATIONAL, "rational_polynomial")],
    ids=["five", "eight"],
)
def test_ros(lens: np.ndarray, model: str, tmp_path: Path) -> None:
    export_calibration(calibration(lens), tmp_path / "ros", "ros")
    told = {path.stem: yaml.safe_load(path.read_text("utf-8")) for path in (tmp_path / "ros").iterdir()}
    camera = told["camera"]
    assert (camera["image_width"], camera["image_height"], camera["camera_name"]) == (1368, 912, "camera")
    assert camera["distortion_model"] == model
    assert camera["distortion_coefficients"] == {"rows": 1, "cols": len(lens), "data": lens.tolist()}
    for name, one in (("camera", calibration().camera), ("projector", calibration().projector)):
        shapes = {"camera_matrix": (3, 3), "rectification_matrix": (3, 3), "projection_matrix": (3, 4)}
        read = {
            key: np.array(told[name][key]["data"]).reshape(told[name][key]["rows"], told[name][key]["cols"])
            for key in shapes
        }
        assert {key: matrix.shape for key, matrix in read.items()} == shapes
        np.testing.assert_array_equal(read["camera_matrix"], one.matrix)
        np.testing.assert_array_equal(read["projection_matrix"], np.c_[one.matrix, np.zeros(3)])
    transform = told["transform"]["transform"]
    T_camera_projector = RigidTransform(
        Rotation.from_quat([transform["rotation"][axis] for axis in "xyzw"]).as_matrix(),
        1e3 * np.array([transform["translation"][axis] for axis in "xyz"]),
    )
    assert told["transform"]["child_frame_id"] == "projector_optical_frame"
    expected = calibration().T_projector_camera.inverse().matrix
    np.testing.assert_allclose(T_camera_projector.matrix, expected, rtol=0, atol=1e-12)


def test_a_table(tmp_path: Path) -> None:
    path = tmp_path / "calibration.csv"
    export_calibration(calibration(), path)
    with path.open(encoding="utf-8", newline="") as stream:
        rows = {row["parameter"]: row for row in csv.DictReader(stream)}
    assert len(rows) == 30
    assert rows["camera.fx"] == {"parameter": "camera.fx", "value": "3645.1", "unit": "px", "sigma": "0.5"}
    assert (rows["camera.k6"]["value"], rows["camera.k6"]["unit"]) == ("0.0", "")
    turned = rows["T_projector_camera.ry"]
    assert float(turned["value"]) == pytest.approx(np.degrees(-0.3), rel=1e-12)
    assert float(turned["sigma"]) == pytest.approx(np.degrees(1e-4), rel=1e-12)
    assert (turned["unit"], rows["T_projector_camera.x"]["value"]) == ("deg", "-120.0")


@pytest.mark.parametrize("layout", ["slstudio", "matlab", "bouguet"])
def test_a_lens_that_a_layout_cannot_hold(layout: str, tmp_path: Path) -> None:
    path = tmp_path / f"calibration{LAYOUTS[layout][0][0]}"
    with pytest.raises(ConfigError, match=f"layout: '{layout}' has no place for rational distortion"):
        export_calibration(calibration(RATIONAL), path, layout)
    assert not path.exists()
