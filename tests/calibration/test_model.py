"""The calibration file: back as it was, and refused when it does not fit."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from fpplab.calibration.model import PARAMETERS, Calibration, Uncertainty
from fpplab.core.conventions import Lattice
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform

CALIBRATION = Calibration(
    Pinhole.from_focal((1368, 912), (3645.1234567, 3640.7), (683.5, 455.25), (-0.12, 0.2, 1e-3, -8e-4, 0.05)),
    Pinhole.from_focal((912, 1140), (1094.4, 2188.8), (455.5, 1110.0), lattice=Lattice.DIAMOND),
    RigidTransform.from_vectors(np.array([0.01, -0.3, 0.02]), np.array([-120.0, 3.0, 12.5])),
    {"camera": 0.031, "projector": 0.082, "joint": 0.06},
)


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "results" / "calibration.yaml"
    CALIBRATION.save(path)
    assert "white" not in path.read_text()
    back = Calibration.load(path)
    for device, known in ((back.camera, CALIBRATION.camera), (back.projector, CALIBRATION.projector)):
        assert device.size == known.size
        assert device.lattice is known.lattice
        np.testing.assert_array_equal(device.matrix, known.matrix)
        np.testing.assert_array_equal(device.distortion, known.distortion)
    np.testing.assert_allclose(
        back.T_projector_camera.matrix, CALIBRATION.T_projector_camera.matrix, atol=1e-14
    )
    assert back.rms_px == CALIBRATION.rms_px


def test_the_white_of_a_colour_camera_is_kept(tmp_path: Path) -> None:
    path, white = tmp_path / "c.yaml", (0.8, 1.15, 0.9)
    replace(CALIBRATION, white=white).save(path)
    assert Calibration.load(path).white == white
    path.write_text(path.read_text().replace("0.8", "-0.8"))
    with pytest.raises(ConfigError, match="white"):
        Calibration.load(path)


def test_eight_coefficients_are_kept_and_no_other_number_is(tmp_path: Path) -> None:
    path, lens = tmp_path / "c.yaml", (0.5, 0.1, 4e-4, -3e-4, 0.01, 0.9, 0.3, 0.02)
    wide = Pinhole.from_focal((1200, 900), (700.0, 698.0), (610.0, 440.0), lens)
    replace(CALIBRATION, camera=wide).save(path)
    written = yaml.safe_load(path.read_text())
    assert written["camera"]["distortion"] == [*lens]
    assert written["projector"]["distortion"] == [0.0] * 5
    assert Calibration.load(path).camera.distortion.tolist() == [*lens]
    for count in (0, 4, 6, 7, 9):
        written["camera"]["distortion"] = [0.01] * count
        path.write_text(yaml.safe_dump(written))
        with pytest.raises(
            ConfigError, match=r"'camera.distortion' is \[.*must be 5 .*k3\), or 8 with k4, k5, k6"
        ):
            Calibration.load(path)


def test_the_projector_stands_where_the_transform_puts_it() -> None:
    assert CALIBRATION.baseline_mm == pytest.approx(np.sqrt(120.0**2 + 3.0**2 + 12.5**2))
    centre = CALIBRATION.projector_centre
    np.testing.assert_allclose(CALIBRATION.T_projector_camera.apply(centre), 0.0, atol=1e-12)
    assert np.linalg.norm(centre) == pytest.approx(CALIBRATION.baseline_mm)


def test_another_sensor_is_refused() -> None:
    CALIBRATION.check_camera((1368, 912), "s")
    with pytest.raises(
        CalibrationError, match="s: camera frames are 640 x 480 but the calibration is for 1368 x 912"
    ):
        CALIBRATION.check_camera((640, 480), "s")
    with pytest.raises(CalibrationError, match="where they were turned by 90°, turn them back"):
        CALIBRATION.check_camera((912, 1368), "s")


def test_another_projector_is_refused() -> None:
    CALIBRATION.check_projector((912, 1140), CALIBRATION.projector.lattice, "s")
    with pytest.raises(
        CalibrationError, match=r"s: projector patterns are 1140 x 912 but .* 912 x 1140"
    ) as caught:
        CALIBRATION.check_projector((1140, 912), CALIBRATION.projector.lattice, "s")
    assert caught.value.exit_code == 5


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    CALIBRATION.save(path)
    text = path.read_text()
    for old, new, complaint in (
        ("lattice: diamond", "lattice: hexagonal", "'projector.lattice' is 'hexagonal'"),
        ("rms_px:", "rms_mm:", "unknown key 'rms_mm'"),
        ("- 1368", "- wide", r"'camera.size\[0\]' is 'wide'"),
    ):
        assert text.count(old) == 1
        path.write_text(text.replace(old, new))
        with pytest.raises(ConfigError, match=complaint):
            Calibration.load(path)


@pytest.mark.parametrize(
    ("written", "instead", "complaint"),
    [
        ("- 1094.4", "- -1094.4", r"'projector.focal_px\[0\]' is -1094.4"),
        ("- 912\n", "- 0\n", r"size\[\d\]' is 0"),
    ],
)
def test_figures_that_no_device_has_are_refused(
    tmp_path: Path, written: str, instead: str, complaint: str
) -> None:
    CALIBRATION.save(tmp_path / "c.yaml")
    text = (tmp_path / "c.yaml").read_text()
    assert written in text
    (tmp_path / "c.yaml").write_text(text.replace(written, instead))
    with pytest.raises(ConfigError, match=complaint):
        Calibration.load(tmp_path / "c.yaml")


def test_a_calibration_without_baseline_is_refused(tmp_path: Path) -> None:
    CALIBRATION.save(tmp_path / "c.yaml")
    data = yaml.safe_load((tmp_path / "c.yaml").read_text())
    data["T_projector_camera"]["translation_mm"] = [0.0, 0.0, 0.0]
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match="translation_mm' is zero"):
        Calibration.load(tmp_path / "c.yaml")


def test_another_lattice_is_refused() -> None:
    with pytest.raises(CalibrationError, match="for a square lattice but the calibration is for a diamond"):
        CALIBRATION.check_projector((912, 1140), Lattice.SQUARE, "s")


def uncertainty() -> Uncertainty:
    """Of every parameter, all correlated, in their very different sizes."""
    random = np.random.default_rng(3)
    mix = random.normal(size=(len(PARAMETERS), 40)) * 10.0 ** random.uniform(-5, 1, (len(PARAMETERS), 1))
    return Uncertainty(PARAMETERS, mix @ mix.T)


def test_uncertainty_is_loaded_as_it_was_saved(tmp_path: Path) -> None:
    path, known = tmp_path / "c.yaml", uncertainty()
    replace(CALIBRATION, uncertainty=known).save(path)
    back = Calibration.load(path).uncertainty
    assert back is not None
    assert back.names == PARAMETERS
    np.testing.assert_allclose(back.covariance, known.covariance, rtol=1e-12)
    assert back.sigma["T_projector_camera.x"] == pytest.approx(np.sqrt(known.covariance[-3, -3]))
    written = yaml.safe_load(path.read_text())["uncertainty"]["covariance"]
    scale = np.degrees(1.0)
    for name in ("rx", "ry", "rz", "x", "y", "z"):
        k, unit = PARAMETERS.index(f"T_projector_camera.{name}"), scale if name.startswith("r") else 1.0
        assert written[k][k] == pytest.approx(unit**2 * known.covariance[k, k])
        assert written[k][0] == pytest.approx(unit * known.covariance[k, 0])


def test_a_change_adds_to_the_covariance_and_frees_what_was_held() -> None:
    known = Uncertainty(("projector.cy", "camera.fx"), np.array([[4.0, 1.0], [1.0, 9.0]]))
    added = np.zeros((len(PARAMETERS),) * 2)
    places = [PARAMETERS.index(name) for name in ("camera.fx", "projector.cx")]
    added[np.ix_(places, places)] = [[1.0, 0.5], [0.5, 2.0]]
    wider = known.widened(added)
    assert wider.names == ("camera.fx", "projector.cx", "projector.cy")
    np.testing.assert_array_equal(wider.covariance, [[10.0, 0.5, 1.0], [0.5, 2.0, 0.0], [1.0, 0.0, 4.0]])


def test_a_file_without_uncertainty_is_still_a_calibration(tmp_path: Path) -> None:
    CALIBRATION.save(tmp_path / "c.yaml")
    assert "uncertainty" not in (tmp_path / "c.yaml").read_text()
    assert Calibration.load(tmp_path / "c.yaml").uncertainty is None


@pytest.mark.parametrize(
    ("names", "covariance", "complaint"),
    [
        (["camera.fx", "camera.f"], [[1.0, 0.0], [0.0, 1.0]], r"'camera.f', which is no parameter"),
        (["camera.fx", "camera.fx"], [[1.0, 0.0], [0.0, 1.0]], "a parameter twice"),
        (["camera.fx"], [[1.0, 0.0], [0.0, 1.0]], "square, 1 x 1 as there are names"),
        (["camera.fx", "camera.fy"], [[1.0, 0.0], [0.0]], "every row as long"),
        (["camera.fx", "camera.fy"], [[1.0, 0.5], [0.4, 1.0]], "symmetric"),
        (["camera.fx", "camera.fy"], [[1.0, 1.5], [1.5, 1.0]], "positive semidefinite"),
        (["camera.fx"], [[1e300]], r"'camera.fx' means a standard uncertainty of 1e\+150, more than 1e\+06"),
        (["camera.k3"], [[1e19]], r"'camera.k3' means .* more than 1e\+09"),
        (["camera.fx", "camera.fy"], [[1.0, 0.0], [0.0, -1.0]], "above zero on its diagonal"),
    ],
)
def test_what_is_no_covariance_is_refused(
    tmp_path: Path, names: list[str], covariance: Any, complaint: str
) -> None:
    path = tmp_path / "c.yaml"
    CALIBRATION.save(path)
    data = yaml.safe_load(path.read_text())
    data["uncertainty"] = {"names": names, "covariance": covariance}
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match=f"'uncertainty'.*{complaint}"):
        Calibration.load(path)


def test_no_covariance_is_made_in_code_either() -> None:
    with pytest.raises(CalibrationError, match="symmetric"):
        Uncertainty(("camera.fx", "camera.fy"), np.array([[1.0, 0.5], [0.4, 1.0]]))


@pytest.mark.parametrize(
    ("number", "other"),
    [("3645.1234567", "3645.1234568"), ("- 683.5\n", "- 684\n"), ("0.031", "0.03"), ("diamond", "square")],
)
def test_a_number_that_was_changed_by_hand_is_noticed(number: str, other: str, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    projector = Pinhole.from_focal((912, 1140), (1094.4, 1400.0), (455.5, 1110.0), lattice=Lattice.DIAMOND)
    replace(CALIBRATION, projector=replace(projector, matrix=CALIBRATION.projector.matrix)).save(path)
    text = path.read_text()
    assert number in text
    path.write_text(text.replace(number, other))
    with pytest.raises(ConfigError, match=r"c\.yaml: .*checksum; .*delete the line 'checksum'|on a square"):
        Calibration.load(path)


def test_without_its_checksum_a_changed_file_is_loaded_and_notes_never_matter(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    CALIBRATION.save(path)
    lines = path.read_text().replace("683.5", "684.5").splitlines()
    path.write_text("\n".join(line for line in lines if not line.startswith("checksum")))
    assert Calibration.load(path).camera.matrix[0, 2] == 684.5
    CALIBRATION.save(path)
    path.write_text("# our rig\r\n" + path.read_text().replace("\n", "\r\n"))
    Calibration.load(path)
