"""`fpplab compare` says first what matters: how far, or that an alignment is missing."""

from pathlib import Path

import numpy as np
import pytest

from fpplab import artefacts
from fpplab.artefacts import save_stl
from fpplab.clouds import Cloud, save_cloud
from fpplab.comparison import find_misplacement
from fpplab.core.errors import DataError
from tests.comparison.test_comparison import CALIBRATION, perfect_cloud, placed
from tests.support.commands import Command

NOISE_MM = 0.02


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    return perfect_cloud(placed("steps"), NOISE_MM)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, cloud: Cloud) -> Path:
    """A cloud, the mesh where it was measured, 5 mm aside, and as `fpplab artefact` writes it."""
    path = tmp_path_factory.mktemp("compare")
    save_cloud(cloud, path / "cloud.ply")
    save_stl(placed("steps"), path / "there.stl")
    save_stl(placed("steps").apply_translation([5.0, 0.0, 3.0]), path / "aside.stl")
    save_stl(artefacts.make("steps"), path / "origin.stl")
    return path


@pytest.mark.whole
def test_a_mesh_that_stands_elsewhere_is_said_first(fpplab: Command, folder: Path) -> None:
    done = fpplab("compare", folder / "cloud.ply", folder / "aside.stl")
    assert done.code == 0, done.err
    first, *rest = done.out.splitlines()
    assert first.startswith("the mesh does not stand where the cloud lies: the points are ")
    assert first.endswith("after a rigid alignment; compare with --align")
    assert any(line.startswith("surface_rms_um: ") for line in rest)
    told = fpplab("compare", folder / "cloud.ply", folder / "aside.stl", "--json")
    assert told.json["warnings"] == [first]
    assert told.json["alignment"] is None


@pytest.mark.whole
@pytest.mark.parametrize(
    ("words", "end"), [(("there.stl",), ", not aligned"), (("aside.stl", "--align"), ", aligned")]
)
def test_how_far_it_is_is_said_first(fpplab: Command, folder: Path, words: tuple[str, ...], end: str) -> None:
    done = fpplab("compare", folder / "cloud.ply", folder / words[0], *words[1:])
    assert done.code == 0, done.err
    first = done.out.splitlines()[0]
    assert " µm from the true shape (surface SMCD), " in first
    assert float(first.split()[0]) < 3 * 1e3 * NOISE_MM
    assert " % complete" in first
    assert first.endswith(end)


@pytest.mark.whole
def test_what_cannot_be_compared_for_want_of_an_alignment_names_it(
    fpplab: Command, folder: Path, tmp_path: Path
) -> None:
    CALIBRATION.save(tmp_path / "calibration.yaml")
    words = ("compare", folder / "cloud.ply", folder / "origin.stl", "--calibration")
    done = fpplab(*words, tmp_path / "calibration.yaml", "--json")
    assert done.code == DataError.exit_code
    assert "the mesh does not stand where the cloud lies" in done.json["error"]
    assert "compare with --align" in done.json["error"]
    assert str(folder / "origin.stl") in done.json["error"]


def test_distances_before_and_after_are_those_of_the_motion_and_of_the_noise(cloud: Cloud) -> None:
    assert find_misplacement(cloud, placed("steps")) is None
    nearer = placed("steps").apply_translation([0.0, 0.0, -200.0])
    found = find_misplacement(cloud, nearer)
    assert found is not None
    assert 180.0 < found.before_mm < 220.0
    assert 0.25 * NOISE_MM < found.after_mm < NOISE_MM  # of the nearest 80 % of the points


@pytest.mark.whole
def test_another_shape_is_not_explained_by_an_alignment() -> None:
    ball = np.random.default_rng(0).normal(size=(3000, 3))
    ball = 60.0 * ball / np.linalg.norm(ball, axis=1)[:, None] + [0, 0, 500]
    assert find_misplacement(Cloud(ball.astype(np.float32)), placed("steps")) is None
