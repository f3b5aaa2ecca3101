"""Plans that do not describe their images, by the commands that meet them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from fpplab.core import config
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.sessions.session import Session
from tests.diagnosis.plan.test_other_patterns import gray, sinusoids
from tests.diagnosis.scenes import Bench, plan_of
from tests.support.commands import Command

SIZE = ("--projector-size", "912", "1140")
SQUARE = ("--lattice", "square")


def images(recording: Recording, folder: Path) -> tuple[object, ...]:
    """Write a recording as image files, and give the words that name them."""
    folder.mkdir()
    for index, image in enumerate(recording.frames):
        cv2.imwrite(str(folder / f"f_{index:02d}.png"), image)
    return folder, "--frames", "f_{index:02d}.png"


def written(plan: Plan, path: Path, **fields: object) -> Path:
    """Write a plan with other fields in its last set."""
    last = plan.fringes[-1].model_copy(update=fields)
    path.write_text(config.dump(plan.model_copy(update={"fringes": (*plan.fringes[:-1], last)})))
    return path


@pytest.mark.whole
def test_a_plan_is_guessed_used_and_found_out(fpplab: Command, tmp_path: Path) -> None:
    plan = plan_of("x", (4, 4, 6), (1, 8, 48))
    words = images(Bench(plan=plan, seed=71).recording(), tmp_path / "images")
    guessed = fpplab("plan", "guess", *words, *SIZE, "--out", tmp_path / "right.yaml", "--json")
    assert guessed.code == 0, guessed.err
    assert [s["stripes"] for s in guessed.json["fringes"]] == [1.0, 8.0, 48.0]
    assert "# Assumed: " in (tmp_path / "right.yaml").read_text()
    right = fpplab(
        "import", *words, *SQUARE, "--plan", tmp_path / "right.yaml", "--out", tmp_path / "right", "--json"
    )
    assert right.code == 0, right.err
    assert right.json["warnings"] == []

    wrong = written(plan, tmp_path / "wrong.yaml", stripes=46.0)
    imported = fpplab(
        "import", *words, *SIZE, *SQUARE, "--plan", wrong, "--out", tmp_path / "wrong", "--json"
    )
    assert imported.code == 0, imported.err
    [warning] = imported.json["warnings"]
    assert "'fringes[2]' (x, 46 stripes) shows 48 stripes" in warning
    refused = fpplab("decode", tmp_path / "wrong", "--out", tmp_path / "wrong.npz")
    assert refused.code == 4, refused.err
    assert "write 'stripes: 48' in 'fringes[2]'" in refused.err
    assert not (tmp_path / "wrong.npz").exists()
    taken = fpplab("decode", tmp_path / "wrong", "--as-recorded", "--out", tmp_path / "wrong.npz")
    assert taken.code == 0, taken.err
    assert "verdict: useless: the plan does not fit its images" in taken.err


@pytest.mark.whole
def test_a_stack_with_white_and_black_images_is_guessed_and_imported(fpplab: Command, tmp_path: Path) -> None:
    plan = plan_of("x", (4, 4, 6), (1, 8, 48))
    frames = list(Bench(plan=plan, seed=76, bits=12).recording().frames)
    white, black = np.full_like(frames[0], 4000), np.full_like(frames[0], 40)
    stack = tmp_path / "stack.npz"
    np.savez_compressed(stack, np.array([white, black, *frames]) << 4)
    words = stack, "--skip", "0-1", *SIZE
    without = fpplab("plan", "guess", stack, *SIZE, "--out", tmp_path / "plan.yaml")
    assert without.code == 4, without.err
    assert "image 0 is white; image 1 is black" in without.err
    guessed = fpplab("plan", "guess", *words, "--out", tmp_path / "plan.yaml", "--json")
    assert guessed.code == 0, guessed.err
    assert [s["stripes"] for s in guessed.json["fringes"]] == [1.0, 8.0, 48.0]
    asked = fpplab("import", *words, "--plan", tmp_path / "plan.yaml", "--out", tmp_path / "s")
    assert asked.code == 2
    assert "--lattice is missing: 912 x 1140 are the mirrors of a LightCrafter 4500" in asked.err
    done = fpplab(
        "import", *words, "--lattice", "diamond", "--plan", tmp_path / "plan.yaml", "--out", tmp_path / "s",
        "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert (done.json["bits"], done.json["lattice"], done.json["warnings"]) == (12, "diamond", [])
    np.testing.assert_array_equal(Session.open(str(tmp_path / "s")).stack(), frames)


def test_a_depth_that_no_camera_has_is_refused(fpplab: Command, tmp_path: Path) -> None:
    words = images(Bench(plan=plan_of("x", (4, 4), (1, 8)), seed=75).recording(), tmp_path / "images")
    done = fpplab("plan", "guess", *words, *SIZE, "--bits", 9, "--out", tmp_path / "plan.yaml")
    assert done.code == 2, done.err
    assert "--bits is 9: one of 8, 10, 12, 14, 16" in done.err
    assert not (tmp_path / "plan.yaml").exists()


@pytest.mark.whole
def test_images_out_of_step_are_told_at_import_and_can_be_taken_as_they_are(
    fpplab: Command, tmp_path: Path
) -> None:
    bench = Bench(plan=plan_of("x", (4, 4, 6), (1, 8, 48)), seed=72)
    recording = bench.recording()
    frames = list(recording.frames)
    frames[1], frames[9] = frames[9], frames[1]
    words = images(Recording(frames, recording.plan, recording.projector_size), tmp_path / "images")
    plan = written(recording.plan, tmp_path / "plan.yaml")
    imported = fpplab("import", *words, *SIZE, *SQUARE, "--plan", plan, "--out", tmp_path / "s", "--json")
    assert imported.code == 0, imported.err
    assert "frames 1 and 9 show each other's pattern" in imported.json["warnings"][0]
    assert "check the order of the image files" in imported.json["warnings"][0]
    bench.rig().save(tmp_path / "c.yaml")
    cloud = "--calibration", tmp_path / "c.yaml", "--out", tmp_path / "cloud.ply"
    refused = fpplab("reconstruct", tmp_path / "s", *cloud)
    assert refused.code == 4
    assert "--as-recorded takes the frames as they are" in refused.err
    taken = fpplab("reconstruct", tmp_path / "s", *cloud, "--as-recorded", "--json")
    assert "out of step" not in taken.err
    assert "show each other's pattern" not in taken.err


@pytest.mark.whole
def test_gray_code_behind_phase_images_is_named_at_import_and_left_out(
    fpplab: Command, tmp_path: Path
) -> None:
    plan = plan_of("x", (4, 4, 6), (1, 8, 48))
    frames = [*sinusoids(74, plan), *gray(74)]
    more = plan_of("x", (4, 4, 6, 5), (1, 8, 48, 60))
    words = images(Recording(frames, more, (912, 1140)), tmp_path / "images")
    wrong = written(more, tmp_path / "more.yaml")
    imported = fpplab("import", *words, *SIZE, *SQUARE, "--plan", wrong, "--out", tmp_path / "s", "--json")
    assert imported.code == 0, imported.err
    assert "images 14-18 have black and white stripes, as of Gray code" in imported.json["warnings"][0]
    refused = fpplab("decode", tmp_path / "s", "--out", tmp_path / "s.npz")
    assert refused.code == 4
    assert "'--skip 14-18'" in refused.err
    right = written(plan, tmp_path / "plan.yaml")
    words = *words, *SIZE, *SQUARE, "--skip", "14-18"
    skipped = fpplab("import", *words, "--plan", right, "--out", tmp_path / "r", "--json")
    assert skipped.code == 0, skipped.err
    assert skipped.json["warnings"] == []


@pytest.mark.whole
@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"stripes": 45.0}, "write 'stripes: 48' in 'fringes[2]'"),
        ({"shift_sign": -1}, "write 'shift_sign: 1' in 'fringes[2]'"),
    ],
    ids=["stripes", "sign"],
)
def test_a_reconstruction_by_a_wrong_plan_is_useless(
    fpplab: Command, tmp_path: Path, fields: dict[str, object], told: str
) -> None:
    bench = Bench(plan=plan_of("x", (4, 4, 6), (1, 8, 48)), seed=73)
    recording = bench.recording()
    last = bench.plan.fringes[-1].model_copy(update=fields)
    plan = bench.plan.model_copy(update={"fringes": (*bench.plan.fringes[:-1], last)})
    done = _reconstructed(fpplab, recording, plan, tmp_path)
    assert done["verdict"] == "useless"
    assert done["findings"][0]["cause"] == "wrong_plan"
    assert told in done["findings"][0]["evidence"]


@pytest.mark.whole
def test_a_sign_that_is_wrong_throughout_is_named_by_the_calibration(fpplab: Command, tmp_path: Path) -> None:
    bench = Bench(plan=plan_of("x", (4, 4, 6), (1, 8, 48)), seed=74)
    sets = tuple(s.model_copy(update={"shift_sign": -1}) for s in bench.plan.fringes)
    plan = bench.plan.model_copy(update={"fringes": sets})
    done = _reconstructed(fpplab, bench.recording(), plan, tmp_path)
    first = done["findings"][0]
    assert first["cause"] == "wrong_orientation"
    assert "does not run along the image as the calibration says" in first["evidence"]
    # Images that are turned or mirrored look the same: the program must not choose between them.
    assert "the steps of every set along x run the other way" in first["evidence"]
    assert "the images are mirrored, left to right" in first["evidence"]
    assert "shift_sign" not in first["remedy"]


def _reconstructed(fpplab: Command, recording: Recording, plan: Plan, folder: Path) -> dict[str, object]:
    rig = {"resolved": {"projector": {"size": list(recording.projector_size), "lattice": "square"}}}
    session = Session.create(folder / "session", plan, rig)
    for index, ((_, _, pattern), image) in enumerate(zip(plan.steps(), recording.frames, strict=True)):
        session.write(Frame(image, index, CameraSettings(0.02, 0.0, 8), 0.0, pattern_id=pattern))
    Bench().rig().save(folder / "c.yaml")
    words = "--calibration", folder / "c.yaml", "--out", folder / "cloud.ply", "--json"
    done = fpplab("reconstruct", folder / "session", *words)
    assert done.code == 4, done.err
    assert not (folder / "cloud.ply").exists()
    return dict(done.json)
