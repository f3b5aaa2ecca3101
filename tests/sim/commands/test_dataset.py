"""`fpplab dataset` as a user runs it: what it leaves, and what it refuses."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fpplab.core import config
from sim.dataset import Dataset
from tests.sim.conftest import RIG, plain, write_world
from tests.support.commands import NO_DISPLAY, Command
from tests.support.recordings import Recording

PLAN = {"fringes": [{"axis": "x", "stripes": stripes, "steps": 3} for stripes in (0.9, 8)]}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A rig of few pixels, ranges without what needs Blender, and a plan."""
    write_world(tmp_path, plain())
    (tmp_path / "rig.yaml").write_text(RIG.replace("world: world.yaml", "world: world.yaml, analytic: true"))
    ranges = config.parse_yaml(config.read_text(config.find_config("dataset_demo.yaml")), "")
    ranges |= {"artefacts": [], "stage_mm": [0, 0], "licence": "CC0-1.0"}
    (tmp_path / "ranges.yaml").write_text(config.to_yaml(ranges))
    (tmp_path / "plan.yaml").write_text(config.to_yaml(PLAN))
    return tmp_path


WORDS = ("--rig", "rig.yaml", "--plan", "plan.yaml", "--scenes", "ranges.yaml", "--out", "set", "--json")


@pytest.mark.whole
def test_samples_and_their_card(fpplab: Command, folder: Path) -> None:
    made = fpplab("dataset", *WORDS, "--count", 3, "--shard-size", 2, "--view", cwd=folder, env=NO_DISPLAY)
    assert made.code == 0, made.err
    assert made.json["samples"] == 3
    assert made.json["shards"] == 2
    found = Dataset(folder / "set")
    assert len(found) == 3
    assert found.card["licence"] == "CC0-1.0"
    assert np.load(folder / "set/shard_00000/frames.npy", mmap_mode="r").shape == (2, 6, 128, 192)
    assert Recording(folder / "set/view.rrd").frames("sample/depth", "sample") == [0, 1, 2]
    page = (folder / "set/README.md").read_text()
    for words in ("CC0-1.0", "train 3", "`depth` | truth |", "`wrapped_phase` | measured |", "## Limits"):
        assert words in page
    before = {p: p.stat().st_mtime_ns for p in (folder / "set").rglob("*")}
    again = fpplab("dataset", *WORDS, "--count", 3, "--shard-size", 2, cwd=folder)
    assert (again.code, again.json["samples"]) == (0, 3)
    assert {p: p.stat().st_mtime_ns for p in (folder / "set").rglob("*")} == before
    other = fpplab("dataset", *WORDS, "--count", 3, "--shard-size", 2, "--seed", 1, cwd=folder)
    assert other.code == 2
    assert "another 'seed' (0, now 1)" in other.json["error"]


@pytest.mark.nightly
def test_a_killed_command_is_completed_to_the_same_bytes(fpplab: Command, folder: Path) -> None:
    command = [sys.executable, "-m", "fpplab", "dataset", *WORDS, "--count", "40", "--shard-size", "4"]
    running = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (folder / "set/shard_00000").exists():
        assert running.poll() is None
        time.sleep(0.01)
    running.kill()
    running.wait()
    there = len(Dataset(folder / "set"))
    assert 4 <= there < 40
    assert there % 4 == 0, "a half-written shard is never seen"
    for out in ("set", "direct"):
        done = fpplab("dataset", *WORDS, "--count", 40, "--shard-size", 4, "--out", out, cwd=folder)
        assert done.json["samples"] == 40
    killed, direct = (
        {str(p.relative_to(folder / out)): p.read_bytes() for p in (folder / out).rglob("*") if p.is_file()}
        for out in ("set", "direct")
    )
    assert killed == direct


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--count", "0"), 2, "--count"),
        (("--count", "1", "--rig", "rig_emulated_quick"), 2, "its bench is no simulation"),
        (("--count", "1", "--scenes", "nowhere.yaml"), 2, "nowhere.yaml: there is no such file"),
        (("--count", "1", "--out", "."), 2, "exists and is not a data set"),
    ],
)
def test_wrong_words_are_told(
    fpplab: Command, folder: Path, words: tuple[str, ...], code: int, said: str
) -> None:
    done = fpplab("dataset", *WORDS, *words, cwd=folder)
    assert done.code == code
    assert done.json["exit_code"] == code
    assert said in done.err
    assert not (folder / "set").exists()
