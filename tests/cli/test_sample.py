"""`fpplab sample`: what it writes is read by every command and by a program that knows nothing of fpplab."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fpplab import Calibration, Session, compare, decode, load_cloud, load_mesh
from tests.support.commands import Command


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory, fpplab: Command) -> Path:
    folder = tmp_path_factory.mktemp("sample") / "lesson"
    done = fpplab("sample", folder, "--json")
    assert done.code == 0, done.err
    assert done.json["verdicts"] == {"pyramid": "good", "pyramid_gray": "unverified"}
    return folder


def test_a_complete_sample_is_not_replaced(fpplab: Command, tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("mine")
    done = fpplab("sample", tmp_path)
    assert done.code == 2
    assert "README.md: exists already" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["README.md"]


@pytest.mark.whole
def test_its_truth_is_that_of_its_images(sample: Path) -> None:
    truth = np.load(sample / "truth" / "pyramid.npz")
    for name, limit_px in (("pyramid", 0.05), ("pyramid_gray", 0.5)):
        decoded = decode(Session.open(sample / name).recording())
        both = decoded.valid & truth["mask"]
        assert both.sum() > 0.95 * truth["mask"].sum()
        assert np.median(np.abs(decoded.u - truth["u"])[both]) < limit_px, name


@pytest.mark.whole
def test_its_points_lie_on_its_surface(sample: Path) -> None:
    surface, devices = (
        load_mesh(sample / "truth" / "pyramid.stl"),
        Calibration.load(sample / "calibration.yaml"),
    )
    for name, limit_um in (("pyramid", 10), ("pyramid_gray", 100)):
        distance = compare(load_cloud(sample / name / "cloud.ply"), surface, devices, align=True)
        assert distance.surface_smcd_um is not None
        assert distance.surface_smcd_um < limit_um, name
    true = Calibration.load(sample / "truth" / "calibration.yaml")
    assert np.allclose(devices.camera.matrix, true.camera.matrix, rtol=2e-3)


@pytest.mark.whole
def test_a_plain_program_decodes_its_gray_code(sample: Path) -> None:
    """Ten pairs of images, the most significant bit first: no line of fpplab is used."""
    files = sorted((sample / "pyramid_gray" / "frames").glob("*.tif"))
    images = np.stack([np.asarray(Image.open(file), float) for file in files])
    bits = images[0:20:2] > images[1:20:2]
    binary = np.cumsum(bits, axis=0) % 2
    column = np.tensordot(2 ** np.arange(9, -1, -1), binary, 1)
    truth = np.load(sample / "truth" / "pyramid.npz")
    mask = truth["mask"]
    assert np.mean(np.abs(column - truth["u"])[mask] <= 1) > 0.95


@pytest.mark.whole
def test_an_interrupted_sample_is_completed(sample: Path, fpplab: Command) -> None:
    kept = sample / "pyramid" / "cloud.ply"
    time_ns = kept.stat().st_mtime_ns
    for missing in ("README.md", "truth/pyramid.npz", "pyramid_gray/report.html"):
        (sample / missing).unlink()
    done = fpplab("sample", sample)
    assert done.code == 0, done.err
    assert kept.stat().st_mtime_ns == time_ns
    assert (sample / "truth" / "pyramid.npz").is_file()
    assert (sample / "pyramid_gray" / "report.html").is_file()
