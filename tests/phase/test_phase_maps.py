"""Maps that another program decoded, written by NumPy, tifffile and SciPy, become the true points."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io
import tifffile
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import load_cloud
from fpplab.core.conventions import Lattice
from fpplab.core.errors import DataError
from fpplab.core.geometry import Pinhole
from fpplab.phase import Decoded
from fpplab.phase.phase_maps import PhaseMapSource, import_phase_maps
from tests.support.commands import Command
from tests.support.rigs import PAIR

CAMERA = Pinhole.from_focal((120, 90), (220, 219.5), (61, 44), (-0.09, 0.12, 5e-4, -3e-4, 0))
PROJECTOR = Pinhole.from_focal((912, 1140), (900, 1800), (450, 300), (-0.05, 0.02, 0, 0, 0), Lattice.DIAMOND)
CALIBRATION = Calibration(CAMERA, PROJECTOR, PAIR, {})
DISTANCE_MM = 250.0
PERIOD_PX = 18.0
SIGMA_PX = 0.05


@pytest.fixture(scope="module")
def maps() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coordinates of a plane in front of the camera, with noise."""
    width, height = CAMERA.size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2).astype(float)
    criteria = (cv2.TERM_CRITERIA_COUNT, 50, 0.0)
    slopes = cv2.undistortPointsIter(
        pixels[:, None], CAMERA.matrix, CAMERA.distortion, np.eye(3), np.eye(3), criteria
    )[:, 0]
    plane = DISTANCE_MM * np.column_stack([slopes, np.ones(len(slopes))])
    noise = np.random.default_rng(1).normal(0, SIGMA_PX, (len(plane), 2))
    u, v = (PROJECTOR.project(plane, PAIR) + noise).T.reshape(2, height, width)
    return u, v


def source(x: Path | None, y: Path | None = None, **more: Any) -> PhaseMapSource:
    return PhaseMapSource(PROJECTOR.size, x, y, **more)


WRITERS: dict[str, Callable[[Path, NDArray[Any]], object]] = {
    "a.npy": np.save,
    "a.npz": lambda path, values: np.savez_compressed(path, phase=values, threshold=np.array(3.0)),
    "a.mat": lambda path, values: scipy.io.savemat(path, {"phase": values, "name": "scan"}),
    "a.tif": tifffile.imwrite,
    "f32.tif": lambda path, values: tifffile.imwrite(path, values.astype(np.float32)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_map_comes_in_from_each_kind_of_file(name: str, maps: Any, tmp_path: Path) -> None:
    u = maps[0].copy()
    u[3, 5:8] = np.nan
    WRITERS[name](tmp_path / name, u)
    found = import_phase_maps(source(tmp_path / name)).decoded
    np.testing.assert_array_equal(found.u, u.astype(np.float32))
    assert np.array_equal(found.valid, np.isfinite(u))
    assert not np.isfinite(found.v).any()
    assert np.nanmedian(found.sigma) == pytest.approx(SIGMA_PX, rel=0.05)


def test_phases_become_coordinates_and_zeros_are_counted(maps: Any, tmp_path: Path) -> None:
    u = maps[0]
    phase = (u + 0.5) * 2 * np.pi / PERIOD_PX
    phase[:4] = 0.0
    np.save(tmp_path / "phi.npy", phase)
    found = import_phase_maps(source(tmp_path / "phi.npy", period_px=PERIOD_PX, sigma_px=0.04))
    np.testing.assert_allclose(found.decoded.u[4:], u[4:], rtol=1e-6)
    assert not found.decoded.valid[:4].any()
    assert found.notes == (f"{tmp_path}/phi.npy: 480 pixels are exactly 0, and count as not measured",)
    assert np.nanmax(found.decoded.sigma) == np.float32(0.04)


@pytest.mark.parametrize(
    ("change", "more", "sentence"),
    [
        (lambda u: np.mod(u, PERIOD_PX) / PERIOD_PX * 2 * np.pi, {"period_px": PERIOD_PX}, "a wrapped phase"),
        (lambda u: (u + 0.5) * 2 * np.pi / 4, {}, "give --period where the values are phases in rad"),
        (
            lambda u: (u + 0.5) * 2 * np.pi / 4,
            {"period_px": PERIOD_PX},
            "correct --period or --projector-size",
        ),
        (lambda u: u[None].repeat(2, 0), {}, "must hold one map, .* and holds none"),
        (lambda u: np.full_like(u, np.nan), {}, "has no number that is finite and not 0"),
        (lambda u: np.full_like(u, 7.0), {}, "the noise of the map along x cannot be measured"),
    ],
)
def test_what_cannot_be_right_is_refused(
    change: Callable[[Any], Any], more: dict[str, Any], sentence: str, maps: Any, tmp_path: Path
) -> None:
    np.save(tmp_path / "m.npy", change(maps[0]))
    with pytest.raises(DataError, match=sentence):
        import_phase_maps(source(tmp_path / "m.npy", **more))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"%PDF-1.7", "is no NPY, NPZ, TIFF or MATLAB file"),
        (
            b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f8', 'fortran_order': False, 'shape': (9999, 9999), }",
            "cannot",
        ),
        (b"PK\x03\x04broken", "cannot be read as a map"),
        (b"II*\x00\x08\x00\x00\x00", "cannot be read as a map"),
    ],
)
def test_a_damaged_file_is_refused(content: bytes, sentence: str, tmp_path: Path) -> None:
    (tmp_path / "m.bin").write_bytes(content)
    with pytest.raises(DataError, match=sentence):
        import_phase_maps(source(tmp_path / "m.bin"))


def test_maps_of_others_become_points(fpplab: Command, maps: Any, tmp_path: Path) -> None:
    for name, values in zip(("u", "v"), maps, strict=True):
        np.save(tmp_path / f"{name}.npy", values)
    CALIBRATION.save(tmp_path / "calibration.yaml")
    size = ["--projector-size", *PROJECTOR.size]
    call = ["import", "--phase", tmp_path / "u.npy", "--phase-y", tmp_path / "v.npy", "--json"]
    imported = fpplab(*call, *size, "--out", tmp_path / "maps.npz")
    assert imported.code == 0, imported.err
    assert Decoded.load(tmp_path / "maps.npz").valid.all()
    out = tmp_path / "cloud.ply"
    done = fpplab(
        "reconstruct",
        tmp_path / "maps.npz",
        "--calibration",
        tmp_path / "calibration.yaml",
        "--out",
        out,
        "--json",
    )
    assert done.code == 0, done.err
    assert done.json["verdict"] == "doubtful"
    assert "no frames" in done.json["reason"]
    assert done.json["epipolar_px"] < 2 * SIGMA_PX
    cloud = load_cloud(out)
    assert len(cloud) == CAMERA.size[0] * CAMERA.size[1]
    assert cloud.sigma_noise_mm is not None
    off_mm = cloud.points[:, 2] - DISTANCE_MM
    assert np.sqrt(np.mean(np.square(off_mm / cloud.sigma_noise_mm))) == pytest.approx(1.0, abs=0.1)
    assert (
        fpplab(*call, "--out", tmp_path / "other.npz")
        .json["error"]
        .startswith("--projector-size: is missing")
    )
    assert fpplab(*call, *size, "--plan", "plan_paper", "--out", out).code == 2


@pytest.mark.parametrize("flip", [np.fliplr, np.flipud], ids=["mirrored", "upside down"])
def test_maps_of_another_orientation_give_no_cloud(
    flip: Callable[[Any], Any], fpplab: Command, maps: Any, tmp_path: Path
) -> None:
    for name, values in zip(("u", "v"), maps, strict=True):
        np.save(tmp_path / f"{name}.npy", flip(values))
    CALIBRATION.save(tmp_path / "calibration.yaml")
    call = [
        "--phase",
        tmp_path / "u.npy",
        "--phase-y",
        tmp_path / "v.npy",
        "--projector-size",
        *PROJECTOR.size,
    ]
    assert fpplab("import", *call, "--out", tmp_path / "maps.npz").code == 0
    out = tmp_path / "cloud.ply"
    done = fpplab(
        "reconstruct", tmp_path / "maps.npz", "--calibration", tmp_path / "calibration.yaml", "--out", out
    )
    assert done.code == 4
    assert not out.exists()
