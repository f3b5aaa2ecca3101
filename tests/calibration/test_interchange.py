"""Calibrations to OpenCV's files and back, and from other programs' files."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import Result
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from fpplab.calibration.dialects import is_own
from fpplab.calibration.interchange import Format, import_calibration, to_opencv
from fpplab.calibration.model import Calibration
from fpplab.calibration.plausibility import ASPECTS
from fpplab.cli.every import app
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform

pytestmark = pytest.mark.usefixtures("foreign_files_read_here")

K1 = np.array([[3645.1, 0, 683.5], [0, 3640.7, 455.25], [0, 0, 1]])
K2 = np.array([[1094.4, 0, 455.5], [0, 2188.8, 1110.0], [0, 0, 1]])
D1 = np.array([[-0.12, 0.2, 1e-3, -8e-4, 0.05]])
D2 = np.array([[0.01, -0.02, 0, 0, 0]])
R = cv2.Rodrigues(np.array([0.01, -0.3, 0.02]))[0]
T = np.array([[-120.0], [3.0], [12.5]])
STEREO = {"M1": K1, "D1": D1, "M2": K2, "D2": D2, "R": R, "T": T}
TOLD = {"camera_size": (1368, 912), "projector_size": (912, 1140), "lattice": Lattice.DIAMOND}

FORMATS = pytest.mark.parametrize("kind", ["yaml", "xml"])


def write(path: Path, entries: dict[str, object]) -> Path:
    """A file as OpenCV itself writes it."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in entries.items():
        storage.write(name, value)
    storage.release()
    return path


def same(a: Calibration, b: Calibration) -> None:
    for mine, other in ((a.camera, b.camera), (a.projector, b.projector)):
        assert mine.size == other.size
        assert mine.lattice is other.lattice
        np.testing.assert_array_equal(mine.matrix, other.matrix)
        np.testing.assert_array_equal(mine.distortion, other.distortion)
    np.testing.assert_allclose(a.T_projector_camera.matrix, b.T_projector_camera.matrix, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(a.T_projector_camera.translation, b.T_projector_camera.translation)
    assert a.rms_px == b.rms_px


def lens(
    size: tuple[int, int],
    lattice: Lattice,
    focal: float,
    aspect: float,
    centre: tuple[float, float],
    distortion: tuple[float, ...],
) -> Pinhole:
    """A device that could be: its focal length in longer sides, its principal point in sizes."""
    focal_px = focal * max(size), focal * max(size) * aspect * ASPECTS[lattice][0]
    centre_px = centre[0] * size[0], centre[1] * size[1]
    return Pinhole.from_focal(size, focal_px, centre_px, distortion, lattice)


def lenses(lattices: st.SearchStrategy[Lattice]) -> st.SearchStrategy[Pinhole]:
    return st.builds(
        lens,
        st.tuples(st.integers(1000, 2000), st.integers(1000, 2000)),
        lattices,
        st.floats(1.0, 2.0),
        st.floats(0.9, 1.1),
        st.tuples(st.floats(0.4, 0.6), st.floats(0.4, 0.6)),
        st.one_of(st.tuples(*[st.floats(-1e-3, 1e-3)] * n) for n in (5, 8)),
    )


poses = st.builds(
    lambda rotation, translation: RigidTransform.from_vectors(np.array(rotation), np.array(translation)),
    st.tuples(*[st.floats(-0.05, 0.05)] * 3),
    st.tuples(st.floats(1.5, 1e4), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
)
calibrations = st.builds(
    Calibration,
    lenses(st.just(Lattice.SQUARE)),
    lenses(st.sampled_from(Lattice)),
    poses,
    st.dictionaries(st.sampled_from(["camera", "projector", "joint"]), st.floats(0, 10)),
)


@FORMATS
@settings(max_examples=8)  # each is read in a process of its own
@given(calibration=calibrations)
def test_there_and_back_is_identity(
    tmp_path_factory: pytest.TempPathFactory, kind: Format, calibration: Calibration
) -> None:
    path = tmp_path_factory.getbasetemp() / f"stereo.{kind}"
    path.write_text(to_opencv(calibration, kind))
    assert not is_own(path)
    same(import_calibration([path]), calibration)


@FORMATS
@pytest.mark.parametrize("d2", [D2, np.append(D2, [0.09, 0.03, 0.02])[None]], ids=["five", "eight"])
def test_opencv_reads_what_is_written(kind: Format, d2: Floats, tmp_path: Path) -> None:
    expected = {**STEREO, "D2": d2}
    calibration = import_calibration([write(tmp_path / "in.yml", expected)], **TOLD)
    path = tmp_path / f"out.{kind}"
    path.write_text(to_opencv(calibration, kind))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    for name, value in expected.items():
        found = storage.getNode(name).mat()
        assert found.shape == value.shape
        np.testing.assert_allclose(found, value, rtol=0, atol=1e-15)
    # The same point in space falls on the same pixel there: that is what the numbers are for.
    point = np.array([[10.0, -7.0, 350.0]])
    mats = {name: storage.getNode(name).mat() for name in STEREO}
    there, _ = cv2.projectPoints(point, cv2.Rodrigues(mats["R"])[0], mats["T"], mats["M2"], mats["D2"])
    here = calibration.projector.project(point, calibration.T_projector_camera)
    np.testing.assert_allclose(there.reshape(1, 2), here, atol=1e-9)


PROGRAMS = {
    "procamcalib": (
        dict(zip(("cam_K", "cam_kc", "proj_K", "proj_kc", "R", "T"), STEREO.values(), strict=True)),
        TOLD,
    ),
    "cameraMatrix1": (
        dict(
            zip(
                ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
                STEREO.values(),
                strict=True,
            )
        ),
        TOLD,
    ),
    "SLStudio": (
        {
            **dict(zip(("Kc", "kc", "Kp", "kp", "Rp", "Tp"), STEREO.values(), strict=True)),
            "frameWidth": 1368,
            "frameHeight": 912,
            "screenResX": 912,
            "screenResY": 1140,
            "cam_error": 0.25,
        },
        {"lattice": Lattice.DIAMOND},
    ),
}


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
@pytest.mark.parametrize("program", list(PROGRAMS))
def test_other_programs_names_are_known(program: str, suffix: str, tmp_path: Path) -> None:
    entries, told = PROGRAMS[program]
    found = import_calibration([write(tmp_path / f"in{suffix}", entries)], **told)
    assert found.camera.size == (1368, 912)
    assert found.projector.size == (912, 1140)
    assert found.projector.lattice is Lattice.DIAMOND
    np.testing.assert_array_equal(found.camera.matrix, K1)
    np.testing.assert_array_equal(found.projector.matrix, K2)
    np.testing.assert_array_equal(found.camera.coefficients, D1.ravel())
    np.testing.assert_array_equal(found.projector.coefficients, D2.ravel())
    np.testing.assert_allclose(found.T_projector_camera.rotation, R, atol=1e-15)
    np.testing.assert_array_equal(found.T_projector_camera.translation, T.ravel())
    assert found.rms_px == ({"camera": 0.25} if program == "SLStudio" else {})


def test_intrinsics_and_extrinsics_may_stand_apart(tmp_path: Path) -> None:
    inner = write(tmp_path / "intrinsics.yml", {k: STEREO[k] for k in ("M1", "D1", "M2", "D2")})
    outer = write(tmp_path / "extrinsics.yml", {"R": R, "T": T, "R1": R, "P1": np.eye(4), "Q": np.eye(4)})
    same(
        import_calibration([inner, outer], **TOLD),
        import_calibration([write(tmp_path / "one.yml", STEREO)], **TOLD),
    )


@pytest.mark.whole
def test_each_device_may_have_a_file(tmp_path: Path) -> None:
    devices = [
        write(
            tmp_path / f"{i}.yml",
            {"image_width": w, "image_height": h, "camera_matrix": k, "distortion_coefficients": d.T},
        )
        for i, (w, h, k, d) in enumerate([(1368, 912, K1, D1), (912, 1140, K2, D2)])
    ]
    outer = write(tmp_path / "extrinsics.yml", {"R": R, "T": T})
    found = import_calibration([*devices, outer], lattice=Lattice.DIAMOND)
    same(found, import_calibration([write(tmp_path / "one.yml", STEREO)], **TOLD))
    with pytest.raises(ConfigError, match=r"third file of one device"):
        import_calibration(
            [*devices, outer, write(tmp_path / "3.yml", {"camera_matrix": K1})], lattice=Lattice.DIAMOND
        )


def test_single_precision_and_fewer_coefficients_are_taken(tmp_path: Path) -> None:
    entries = {**STEREO, "R": R.astype(np.float32), "D1": D1[:, :4], "D2": np.append(D2, np.zeros(3))[None]}
    found = import_calibration([write(tmp_path / "in.yml", entries)], **TOLD)
    np.testing.assert_array_equal(found.camera.coefficients, [-0.12, 0.2, 1e-3, -8e-4, 0])
    np.testing.assert_array_equal(found.projector.coefficients, D2.ravel())
    rotation = found.T_projector_camera.rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)


@pytest.mark.whole_after(6)
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"M1": None}, r"in\.yml: has no entry 'M1' .*cam_K, Kc.*camera_matrix"),
        ({"T": None}, r"has no entry 'T'"),
        ({"D2": None}, r"has no entry 'D2' .*proj_kc"),
        ({"M1": K1[:2]}, r"'M1' has the shape 2 x 3; expected a 3 x 3 matrix"),
        ({"M1": K1.T}, "'M1' is no camera's matrix"),
        ({"M1": K1 + np.eye(3, k=1)}, "'M1' has the skew 1, which"),
        ({"M2": np.diag([-5.0, 5, 1])}, r"projector\.focal_px"),
        ({"M2": np.full((3, 3), np.nan)}, "'M2' is not a matrix of finite numbers"),
        ({"M2": "large"}, "'M2' is not a matrix"),
        ({"M2": 3.5}, "'M2' is not a matrix"),
        ({"D1": np.zeros((1, 3))}, r"'D1' has the shape 1 x 3; expected 4, 5 or 8 coefficients"),
        ({"D1": np.zeros((2, 4))}, r"'D1' has the shape 2 x 4"),
        ({"D1": np.append(D1, [0, 0.1])[None]}, r"'D1' has the shape 1 x 7"),
        (
            {"D1": np.append(D1, [0] * 6 + [0.1])[None]},
            r"'D1' has 12 coefficients and those beyond the eighth",
        ),
        ({"D1": np.full((1, 5), 2e9 + 0.5)}, r"camera\.distortion"),
        ({"R": -R}, "'R' is no rotation"),
        ({"R": 1.01 * R}, "'R' is no rotation"),
        ({"R": np.zeros((3, 1))}, r"'R' has the shape 3 x 1"),
        ({"T": np.zeros((4, 1))}, r"'T' has the shape 4 x 1; expected 3 lengths"),
        ({"T": np.zeros((3, 1))}, "is zero: camera and projector must stand apart"),
        ({"cam_K": K1}, "'cam_K' says again what 'M1' says"),
        (
            {"image_size1": np.array([[1368, 912, 3]])},
            r"'image_size1' has 3 numbers; expected width and height",
        ),
        ({"image_size1": np.array([[1368.5, 912.0]])}, r"expected whole px"),
        ({"image_size1": np.array([[640, 480]])}, r"says 640 x 480 px but --camera-size 1368 912"),
        ({"lattice2": "hexagonal"}, r"'lattice2' is 'hexagonal'; expected square or diamond"),
        ({"lattice2": "square"}, r"'lattice2' says square but --lattice diamond"),
        ({"cam_error": "small"}, r"'cam_error' is not a number"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(changes: dict[str, object], words: str, tmp_path: Path) -> None:
    entries = {k: v for k, v in {**STEREO, **changes}.items() if v is not None}
    with pytest.raises(ConfigError, match=words):
        import_calibration([write(tmp_path / "in.yml", entries)], **TOLD)


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        ("camera_size", "add --camera-size WIDTH HEIGHT"),
        ("projector_size", "add --projector-size WIDTH HEIGHT"),
        ("lattice", "add --lattice square or --lattice diamond"),
    ],
)
def test_what_nobody_says_is_asked_for(missing: str, words: str, tmp_path: Path) -> None:
    told = {k: v for k, v in TOLD.items() if k != missing}
    with pytest.raises(ConfigError, match=words):
        import_calibration([write(tmp_path / "in.yml", STEREO)], **told)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("camera: 3\n", r"in\.yml: has no entry of a calibration that is known; it has camera"),
        ("", r"in\.yml: is empty; expected a calibration"),
        ("%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n", "in.yml"),
        ("%YAML:1.0\n---\nM1: [ 1, 2\n", "in.yml"),
        ("<?xml version='1.0'?>\n<opencv_storage>\n<M1>", "in.yml"),
        ("<?xml version='1.0'?>\n", "in.yml"),
        ("%YAML:1.0\n", "in.yml"),
        ("%YAML:1.0\n---\n- 1\n- 2\n", "in.yml"),
    ],
)
def test_a_damaged_file_is_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "in.yml").write_text(text)
    with pytest.raises(ConfigError, match=words):
        import_calibration([tmp_path / "in.yml"], **TOLD)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yml: there is no such file"):
        import_calibration([tmp_path / "nowhere.yml"])


# The command


def run(*words: object) -> Result:
    return CliRunner().invoke(app, ["convert", *map(str, words)])


@pytest.mark.parametrize("suffix", [".xml", ".yml"])
def test_a_calibration_goes_out_and_comes_back(suffix: str, tmp_path: Path) -> None:
    mine, theirs, back = tmp_path / "mine.yaml", tmp_path / f"stereo{suffix}", tmp_path / "back.yaml"
    calibration = import_calibration([write(tmp_path / "in.yml", STEREO)], **TOLD)
    calibration.save(mine)
    assert run(mine, "--out", theirs).exit_code == 0
    result = run(theirs, "--out", back, "--json")
    assert json.loads(result.stdout) == {
        "file": str(back),
        "baseline_mm": pytest.approx(calibration.baseline_mm),
        "lattice": "diamond",
    }
    same(Calibration.load(back), Calibration.load(mine))


def test_sizes_and_lattice_are_told_on_the_command_line(tmp_path: Path) -> None:
    theirs, mine = write(tmp_path / "stereo.yml", STEREO), tmp_path / "mine.yaml"
    sizes = ("--camera-size", 1368, 912, "--projector-size", 912, 1140)
    assert run(theirs, "--out", mine, *sizes, "--lattice", "diamond").exit_code == 0
    same(Calibration.load(mine), import_calibration([theirs], **TOLD))
    refused = run(mine, "--out", tmp_path / "out.xml", *sizes).exception
    assert isinstance(refused, ConfigError)
    assert "leave sizes and lattice out" in str(refused)


def test_outputs_are_named_for_what_they_hold_and_never_overwritten(tmp_path: Path) -> None:
    theirs, mine = write(tmp_path / "stereo.yml", STEREO), tmp_path / "mine.yaml"
    import_calibration([theirs], **TOLD).save(mine)
    for words, sentence in (
        ((mine, "--out", tmp_path / "out.yaml"), "must end in .xml or .yml"),
        ((theirs, "--out", tmp_path / "out.yml"), "must end in .yaml"),
        ((theirs, "--out", mine), "exists already"),
        ((mine, "--out", theirs), "exists already"),
        ((mine, theirs, "--out", tmp_path / "out.xml"), "give it alone"),
    ):
        refused = run(*words).exception
        assert isinstance(refused, ConfigError)
        assert sentence in str(refused)
