"""`fpplab characterise --judge`: a calibration beside poses that it was not fitted to."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.core.geometry import RigidTransform
from tests.support.commands import Command, Demo

OLD = Path(__file__).parents[1] / "data" / "version_0_1_0" / "calibration.yaml"


@pytest.fixture(scope="module")
def later(demo: Demo, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("later")
    for pose in sorted((demo.folder / "board").glob("pose_*"))[:2]:
        shutil.copytree(pose, folder / pose.name)
    return folder


def test_a_calibration_is_judged(fpplab: Command, demo: Demo, later: Path, tmp_path: Path) -> None:
    """By poses of its own here, in which errors are rather less than in others."""
    page = tmp_path / "judged.html"
    given = ["characterise", "--judge", demo.folder / "calibration.yaml", later]
    done = fpplab(*given, "--out", page, "--json")
    assert done.code == 0, done.err
    assert not done.json["contradicted"]
    assert [p["pose"] for p in done.json["poses"]] == ["pose_00", "pose_01"]
    for device in ("camera", "projector"):
        told = done.json[device]
        assert 0.4 * told["predicted_px"] < told["rms_px"] < 1.1 * told["predicted_px"]
    written = page.read_text()
    assert "The calibration holds" in written
    assert written.count("data:image/png;base64,") == 1
    plain = fpplab(*given)
    assert plain.code == 0
    assert "pose_01" in plain.out
    assert "the calibration holds" in plain.out
    copy = tmp_path / "calibration.yaml"
    shutil.copy(demo.folder / "calibration.yaml", copy)
    assert fpplab("characterise", "--judge", copy, later, "--confirm").code == 0
    origin = Calibration.load(copy).origin
    assert origin is not None
    assert origin.confirmed is not None


def test_a_lens_that_was_moved_since_ends_with_a_calibration_error(
    fpplab: Command, demo: Demo, later: Path, tmp_path: Path
) -> None:
    known = Calibration.load(demo.folder / "calibration.yaml")
    matrix = known.projector.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1.01
    replace(known, projector=replace(known.projector, matrix=matrix)).save(tmp_path / "old.yaml")
    done = fpplab("characterise", "--judge", tmp_path / "old.yaml", later, "--json")
    assert done.code == 5
    assert done.json["contradicted"]
    assert "characterise again" in done.json["verdict"]


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--target", "target_paper"], 2, "--target does not go with --judge"),
        (["--rig", "rig_demo"], 2, "--rig does not go with --judge"),
    ],
)
def test_options_that_do_not_go_with_it_are_refused(
    fpplab: Command, demo: Demo, later: Path, options: list[str], code: int, words: str
) -> None:
    done = fpplab("characterise", "--judge", demo.folder / "calibration.yaml", later, *options, "--json")
    assert done.code == code
    assert words in done.json["error"]


def test_what_is_missing_is_named(fpplab: Command, demo: Demo, later: Path) -> None:
    done = fpplab("characterise", "--judge", demo.folder / "calibration.yaml", "--json")
    assert (done.code, "needs sessions" in done.json["error"]) == (2, True)
    done = fpplab("characterise", later, "--confirm", "--json")
    assert (done.code, "--confirm goes with --judge" in done.json["error"]) == (2, True)
    done = fpplab("characterise", later, "--json")
    assert done.code == 2
    assert done.json["error"].startswith("`fpplab characterise` needs --target; ")
    done = fpplab("characterise", later, "--target", "target_paper", "--json")
    assert done.code == 2
    assert done.json["error"].startswith("`fpplab characterise` needs --out; ")


def test_a_calibration_of_an_earlier_version_is_refused_with_the_reason(fpplab: Command, later: Path) -> None:
    done = fpplab("characterise", "--judge", OLD, later, "--json")
    assert done.code == 5
    assert "calibration.yaml: 'board' is missing" in done.json["error"]


@pytest.mark.whole
def test_a_projector_that_was_turned_since_is_corrected_by_two_poses(
    fpplab: Command, demo: Demo, later: Path, tmp_path: Path
) -> None:
    known = Calibration.load(demo.folder / "calibration.yaml")
    turn = RigidTransform.from_vectors(np.radians([0.0, 0.1, 0.0]), np.zeros(3))
    old, new = tmp_path / "old.yaml", tmp_path / "new.yaml"
    replace(known, T_projector_camera=turn @ known.T_projector_camera).save(old)
    done = fpplab("characterise", "--correct", old, later, "--out", new, "--json")
    assert done.code == 0, done.err
    assert done.json["needed"]
    assert done.json["before"]["contradicted"]
    assert not done.json["after"]["contradicted"]
    assert "The calibration holds" in new.with_suffix(".html").read_text()
    assert fpplab("characterise", "--judge", old, demo.folder / "board").code == 5
    assert fpplab("characterise", "--judge", new, demo.folder / "board").code == 0
    for words, said in (
        (["--correct", old, later], "--correct needs --out"),
        (["--correct", old, "--out", new], "--correct needs sessions"),
        (["--correct", old, later, "--out", new], "exists already"),
        (["--correct", old, "--judge", old, later], "exclude each other"),
        (
            ["--correct", old, later, "--out", tmp_path / "x.yaml", "--target", "target_paper"],
            "does not go with",
        ),
    ):
        refused = fpplab("characterise", *words, "--json")
        assert (refused.code, said in refused.json["error"]) == (2, True), refused.json
