"""The benchmark of causes runs by itself, whole or a part of it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.diagnosis import COUNT, JUDGES, JUDGING_SEED, Selection, measure
from benchmarks.diagnosis.advice import Followed, follow
from benchmarks.diagnosis.judging import Judged
from benchmarks.diagnosis.record import Record
from fpplab.core.errors import ConfigError
from tests.support.commands import ROOT

ARGUMENTS = ["--seed", "600", "--count", "1", "--causes", "small_angle,no_permission", "--json"]


def test_more_than_the_faults_asked_for_are_judged_on_seeds_of_their_own() -> None:
    assert len(JUDGES) >= 24
    assert Selection() == Selection(JUDGING_SEED, COUNT, ())
    assert (JUDGING_SEED, COUNT) == (1400, 10)


def test_a_cause_that_there_is_not_is_refused() -> None:
    with pytest.raises(ConfigError, match="--causes: 'rain' is none of camera_focus, "):
        measure(Selection(600, 1, ("rain",)))


def judged(cause: str, seed: int) -> Judged:
    return Judged(cause, seed, (cause,), "useless", float("inf"), 0.0)


def test_an_interrupted_judging_goes_on_from_its_record(tmp_path: Path) -> None:
    first, path = judged("bands", 3), tmp_path / "record.jsonl"
    Record(path).add(judged, "bands", 3, first)
    Record(path).add(follow, "flicker", 4, Followed("flicker", 1.02, 2))
    whole = path.read_text()
    path.write_text(whole + '{"of": ["judged", "ba')  # killed while it wrote
    again = Record(path)
    assert path.read_text() == whole
    assert again.known(judged, "bands", 3) == first
    assert again.known(follow, "flicker", 4) == Followed("flicker", 1.02, 2)
    assert again.known(judged, "bands", 5) is None


def test_a_record_of_another_commit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    path.write_text('{"commit": "0000000"}\n')
    with pytest.raises(ConfigError, match=r"record\.jsonl: is of commit 0000000, and this is commit "):
        Record(path)


@pytest.mark.nightly
def test_a_part_runs_without_any_setting_of_the_environment() -> None:
    plain = {name: value for name, value in os.environ.items() if name != "FPPLAB_ALLOW_BACKEND"}
    command = [sys.executable, "-m", "benchmarks.diagnosis", *ARGUMENTS]
    done = subprocess.run(command, cwd=ROOT, env=plain, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    values = {one["name"]: one["value"] for one in json.loads(done.stdout)["results"]}
    assert values["first"] == 100.0
    assert values["faults_called_good"] == 0.0
