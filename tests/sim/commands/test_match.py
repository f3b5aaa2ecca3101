"""`fpplab match` as a user runs it: a small hidden bench, and a nominal twin of it."""

import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from fpplab.core import config
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_poses
from tests.cli.test_other_systems import both, same
from tests.support.commands import NO_DISPLAY, Command
from tests.support.recordings import Recording

PLAN = Plan(
    fringes=tuple(
        Sinusoid(axis=axis, stripes=stripes, steps=4) for axis in ("x", "y") for stripes in (1, 8, 48)
    )
)
POSES = 4

pytestmark = pytest.mark.whole


def small(name: str, folder: Path) -> Path:
    """A rig that comes with fpplab, at an eighth of the sensor's pixels along each side."""
    found = config.find_config(name)
    data = config.parse_yaml(config.read_text(found), found)
    data["bench"]["binning"] = 8
    path = folder / found.name
    path.write_text(config.to_yaml(data))
    return path


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hidden")
    with Rig.load(small("rig_hidden", folder)) as rig:
        take_poses(rig, PLAN, "board", POSES, folder / "board", replace_existing=False)
    return folder / "board"


def test_a_twin_is_matched_and_runs(fpplab: Command, board: Path, tmp_path: Path) -> None:
    twin, out = small("rig_twin", tmp_path), tmp_path / "matched"
    done = fpplab(
        "match", "--twin", twin, "--reference", board, "--out", out, "--epochs", 2, "--view", "--json",
        env=NO_DISPLAY,
    )  # fmt: skip
    assert done.code == 0, done.err
    assert "Watch it at http://127.0.0.1:" in done.err
    assert "epoch 2, light: loss" in done.err
    answer = done.json
    assert {"ssim", "epsilon_d_px", "loss", "epochs", "gamma"} <= answer.keys()
    assert answer["epochs"] == 2
    first, last = answer["rows"]
    assert last["loss_board"] < first["loss_board"]
    poses = answer["poses"]
    assert [one["pose"] for one in poses] == [path.name for path in sorted(board.iterdir())]
    for when, row in (("before", first), ("after", last)):
        assert np.mean([one[f"ssim_board_{when}"] for one in poses]) == pytest.approx(row["ssim_board"])
        assert all(abs(one[f"epsilon_d_px_{when}"]) < 0.1 for one in poses)
    epochs = [json.loads(line) for line in (out / "match.jsonl").read_text().splitlines()]
    assert [e["step"] for e in epochs] == ["start", "points", "light"]
    assert "paper" in (out / "report.html").read_text()
    shown = Recording(out / "view.rrd")
    assert shown.frames("match/loss", "epoch") == [0, 1, 2]
    assert shown.frames("images/difference", "epoch") == [0, 1, 2]
    with Rig.load(out / "rig.yaml") as rig:
        assert rig.camera.caps.size == (684, 456)
        assert rig.fixture is not None
        assert rig.fixture.caps.items["board"] == POSES
    command = ("match", "--twin", twin, "--reference", board, "--out", out, "--epochs", 2, "--json")
    again = fpplab(*command)
    assert again.code == 2
    assert "exists already" in again.json["error"]
    _finishes_what_was_killed_before_its_report(fpplab, command, out)


def _finishes_what_was_killed_before_its_report(
    fpplab: Command, command: tuple[object, ...], out: Path
) -> None:
    kept = {name: (out / name).read_bytes() for name in ("rig.yaml", "world.yaml", "calibration.yaml")}
    (out / "report.html").unlink()
    done = fpplab(*command)
    assert done.code == 0, done.err
    assert (out / "report.html").is_file()
    assert {name: (out / name).read_bytes() for name in kept} == kept


@pytest.mark.nightly
def test_it_is_the_same_without_what_only_linux_has(board: Path, tmp_path: Path) -> None:
    twin, folders = small("rig_twin", tmp_path), (tmp_path / "linux", tmp_path / "windows")
    for folder in folders:
        folder.mkdir()
    both(folders, "match", "--twin", twin, "--reference", board, "--out", "matched", "--epochs", 1)
    assert same(*folders) >= 5


def test_what_was_accepted_is_told_by_the_twin(fpplab: Command, board: Path, tmp_path: Path) -> None:
    """The projector stands 30 mm elsewhere than the twin's file says."""
    twin, out = small("rig_twin", tmp_path), tmp_path / "matched"
    rig = config.parse_yaml(twin.read_text(), twin)
    world = config.parse_yaml(config.read_text(found := config.find_config("world_twin")), found)
    world["projector"]["T_camera_projector"]["translation_mm"] = [180, 0, 0]
    (tmp_path / "other.yaml").write_text(config.to_yaml(world))
    rig["bench"]["world"] = "other.yaml"
    twin.write_text(config.to_yaml(rig))
    call = ("match", "--twin", twin, "--reference", board, "--out", out, "--epochs", 1, "--json")
    refused = fpplab(*call)
    assert refused.code == 5
    assert "--accept stale_calibration" in refused.json["error"]
    unknown = fpplab(*call, "--accept", "luck")
    assert unknown.code == 2
    assert "--accept: 'luck'" in unknown.json["error"]
    done = fpplab(*call, "--accept", "stale_calibration")
    assert done.code == 0, done.err
    assert done.json["notes"][0].startswith("stale_calibration accepted: the baseline is")
    used = fpplab(
        "gamma", "--rig", out / "rig.yaml", "--item", "grey_card", "--levels", 5, "--repeats", 1,
        "--out", tmp_path / "response.yaml", "--json",
    )  # fmt: skip
    assert used.code == 0, used.err
    assert "rig.yaml: stale_calibration accepted: the baseline is" in used.err


def test_unknown_items_are_told_before_the_work(fpplab: Command, board: Path, tmp_path: Path) -> None:
    twin = small("rig_twin", tmp_path)
    call = ("match", "--twin", twin, "--reference", board, "--out", tmp_path / "no", "--json")
    pose = next(board.iterdir())
    wrong = (("cup", "no item 'cup'"), ("board", "only artefacts and parts"))
    for option, (item, words) in product(("--scan", "--surface"), wrong):
        done = fpplab(*call, option, f"{item}={pose}")
        assert done.code == 2
        assert words in done.json["error"]
        assert not (tmp_path / "no").exists()


def test_a_twin_of_another_camera_is_refused(fpplab: Command, board: Path, tmp_path: Path) -> None:
    done = fpplab("match", "--twin", "rig_twin", "--reference", board, "--out", tmp_path / "no", "--json")
    assert done.code == 2
    assert "684 x 456 pixels, the twin's 1368 x 912" in done.json["error"]
    assert not (tmp_path / "no").exists()
