"""`fpplab optimise` as a user runs it: wrong input is one sentence; a plan found runs unchanged."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from fpplab.cli.commands.optimise import _sets_in_short
from fpplab.core import config
from fpplab.optimisation.study import Study
from fpplab.patterns.plan import Plan
from tests.support.commands import NO_DISPLAY, ROOT, Command, Demo
from tests.support.recordings import Recording

FRINGES = [{"axis": "x", "stripes": s, "steps": 3} for s in (1, 6, 24)]
SMALL: dict[str, Any] = {
    "name": "Small",
    "artefacts": ["pyramid"],
    "start": {"fringes": FRINGES},
    "space": {"stripes": [None, None, [16, 64]]},
    "objectives": ["surface_smcd_um"],
    "seeds": [1, 2],
    "method": {"kind": "coordinate", "first": 0.5, "finest": 0.25},
    "budget": 6,
}


def written(path: Path, **changes: Any) -> Path:
    path.write_text(config.to_yaml({**SMALL, **changes}))
    return path


BAD: dict[str, tuple[str, dict[str, Any], list[str], int, str]] = {
    "empty space": ("stripes", {"space": {}}, [], 2, "'space' leaves nothing to search"),
    "upside down": ("stripes", {"space": {"stripes": [None, None, [64, 16]]}}, [], 2, "must not exceed"),
    "another rig": ("stripes", {"rig": "Bench 7"}, [], 2, "'rig' is 'Bench 7', but the rig given is"),
    "another search": ("phases", {}, [], 2, "searches stripes[2], which `optimise phases` does not"),
    "beyond the projector": (
        "stripes", {"space": {"stripes": [None, None, [16, 500]]}}, [], 2, "at most 228 along x",
    ),
    "beyond the stage": (
        "baseline",
        {"start": {"fringes": FRINGES, "stage_mm": 0.0}, "space": {"stage_mm": [-500, 60]}},
        [], 2, "the stage travels from -60 to 60 mm",
    ),
    "no such artefact": ("stripes", {"artefacts": ["teapot"]}, [], 2, "'artefacts' names 'teapot'"),
    "unknown method": ("stripes", {"method": {"kind": "luck"}}, [], 2, "'method'"),
    "no scheduler": (
        "stripes", {}, ["--scheduler", "tcp://127.0.0.1:9"], 3, "nothing answers at 'tcp://127.0.0.1:9'",
    ),
    "scheduler of others": (
        "stripes", {}, ["--scheduler", "tcp://192.168.1.20:8786"], 2, "beyond this computer",
    ),
    "scheduler and workers": (
        "stripes", {}, ["--scheduler", "tcp://127.0.0.1:9", "--workers", "2"], 2, "give one",
    ),
    "no such rig to confirm on": ("stripes", {}, ["--confirm", "rig_none"], 2, "rig_none"),
}  # fmt: skip


@pytest.mark.whole
@pytest.mark.parametrize(("what", "changes", "more", "code", "words"), BAD.values(), ids=BAD.keys())
def test_wrong_input_is_one_sentence(
    fpplab: Command,
    tmp_path: Path,
    what: str,
    changes: dict[str, Any],
    more: list[str],
    code: int,
    words: str,
) -> None:
    study = written(tmp_path / "study.yaml", **changes)
    done = fpplab(
        "optimise", what, "--rig", "rig_demo_quick", "--study", study, "--out", tmp_path / "plan.yaml",
        "--json", *more,
    )  # fmt: skip
    assert done.code == code
    assert words in done.json["error"]
    assert not (tmp_path / "plan.yaml").exists()


@pytest.fixture(scope="module")
def searched(demo: Demo, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], bytes]:
    """A search that was killed in the middle and went on."""
    folder = tmp_path_factory.mktemp("optimise")
    study = written(folder / "study.yaml")
    words = [
        "optimise", "stripes", "--rig", "rig_demo_quick", "--study", study, "--out", folder / "plan.yaml",
        "--calibration", demo.folder / "calibration.yaml", "--confirm", "rig_demo_quick", "--json",
    ]  # fmt: skip
    command = [sys.executable, "-m", "fpplab", *map(str, words)]
    journal = folder / "plan.jsonl"
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as first:
        while not (journal.exists() and journal.read_bytes().count(b"\n") >= 4):
            assert first.poll() is None
            time.sleep(0.05)
        os.kill(first.pid, signal.SIGKILL)
    left = journal.read_bytes()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return folder, json.loads(done.stdout), left


@pytest.mark.whole
def test_a_search_killed_goes_on(searched: tuple[Path, dict[str, Any], bytes]) -> None:
    folder, answer, left = searched
    whole = left[: left.rfind(b"\n") + 1]
    assert (folder / "plan.jsonl").read_bytes().startswith(whole)
    assert answer["candidates"] >= 3
    assert answer["optimum"]["surface_smcd_um"] < answer["initial"]["surface_smcd_um"]
    assert answer["epochs"] == len(answer["convergence"])


@pytest.mark.whole
def test_the_gain_is_confirmed_within_its_uncertainty(searched: tuple[Path, dict[str, Any], bytes]) -> None:
    _, answer, _ = searched
    (confirmed,) = answer["confirmed"]
    assert confirmed["images"] == answer["images"] == 9
    # Both compare samples of the same cloud; the search's is the smaller.
    assert abs(confirmed["gain"] - answer["gain"]["down_percent"] / 100) < 6 * confirmed["uncertainty"] + 0.01


@pytest.mark.nightly
@pytest.mark.parametrize("rig", ["rig_demo_quick", "rig_emulated_quick"])
def test_the_plan_found_runs_unchanged(
    rig: str, fpplab: Command, demo: Demo, searched: tuple[Path, dict[str, Any], bytes], tmp_path: Path
) -> None:
    folder, answer, _ = searched
    plan = Plan.load(folder / "plan.yaml")
    assert [f.stripes for f in plan.fringes] == [f["stripes"] for f in answer["optimum"]["fringes"]]
    done = fpplab(
        "scan", "--rig", rig, "--plan", folder / "plan.yaml", "--item", "pyramid", "--json",
        "--calibration", demo.folder / "calibration.yaml", "--out", tmp_path / "scan",
    )  # fmt: skip
    assert done.json["images"] == answer["images"]


@pytest.mark.nightly
def test_a_bench_is_searched_by_measuring_on_it(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    """The real drivers, by one process: that is what instruments serve."""
    words = [
        "optimise", "stripes", "--rig", "rig_emulated_quick", "--study",
        written(tmp_path / "study.yaml", seeds=[1], budget=3), "--out", tmp_path / "plan.yaml",
        "--calibration", demo.folder / "calibration.yaml", "--json",
    ]  # fmt: skip
    refused = fpplab(*words, "--workers", 2)
    assert refused.code == 2
    assert "rig 'Emulated bench, quick' is no simulation" in refused.json["error"]
    done = fpplab(*words, "--view", env=NO_DISPLAY)
    assert done.code == 0, done.err
    shown = Recording(tmp_path / "plan.rrd")
    assert len(shown.frames("diagrams/front", "epoch")) == done.json["epochs"]
    assert done.json["optimum"]["surface_smcd_um"] < done.json["initial"]["surface_smcd_um"]


@pytest.mark.whole
def test_the_page_shows_what_was_found(searched: tuple[Path, dict[str, Any], bytes]) -> None:
    folder, answer, _ = searched
    page = (folder / "plan.html").read_text()
    for words in (
        "Convergence",
        "Parameters",
        "Confirmation",
        "Artefact pyramid",
        "stripes[2]",
        "Provenance",
    ):
        assert words in page
    assert answer["provenance"]["rig"]["camera"] in page


@pytest.mark.whole
def test_a_plan_found_is_not_overwritten(
    fpplab: Command, searched: tuple[Path, dict[str, Any], bytes]
) -> None:
    folder, _, _ = searched
    done = fpplab(
        "optimise", "stripes", "--rig", "rig_demo_quick", "--out", folder / "plan.yaml", "--json",
    )  # fmt: skip
    assert done.code == 2
    assert "exists already" in done.json["error"]


def test_every_search_has_its_study() -> None:
    for name in ("phases", "stripes", "baseline", "pareto"):
        assert Study.load(f"study_{name}.yaml").rig == "any"


def test_sets_of_any_kind_are_listed() -> None:
    sets = [
        {"kind": "sinusoid", "axis": "x", "stripes": 48.0, "steps": 4},
        {"kind": "gray", "axis": "x", "bits": 6, "cell_px": 19.0},
        {"kind": "shifted", "axis": "x", "stripes": 36.5, "shifts_deg": [0, 120]},
        {"kind": "even", "levels": [1, 0]},
    ]
    assert _sets_in_short(sets) == ("48 gray 36.5 even", "4 6 2 2")
