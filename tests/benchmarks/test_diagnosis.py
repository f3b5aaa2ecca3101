"""The benchmark of causes runs by itself, whole or a part of it."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from benchmarks.diagnosis import COUNT, JUDGES, JUDGING_SEED, Selection, measure
from fpplab.core.errors import ConfigError
from tests.support.commands import ROOT

ARGUMENTS = ["--seed", "600", "--count", "1", "--causes", "small_angle,no_permission", "--json"]


def test_more_than_the_faults_asked_for_are_judged_on_seeds_of_their_own() -> None:
    assert len(JUDGES) >= 24
    assert Selection() == Selection(JUDGING_SEED, COUNT, ())
    assert (JUDGING_SEED, COUNT) == (1200, 10)


def test_a_cause_that_there_is_not_is_refused() -> None:
    with pytest.raises(ConfigError, match="--causes: 'rain' is none of camera_focus, "):
        measure(Selection(600, 1, ("rain",)))


@pytest.mark.slow
def test_a_part_runs_without_any_setting_of_the_environment() -> None:
    plain = {name: value for name, value in os.environ.items() if name != "FPPLAB_ALLOW_BACKEND"}
    command = [sys.executable, "-m", "benchmarks.diagnosis", *ARGUMENTS]
    done = subprocess.run(command, cwd=ROOT, env=plain, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    values = {one["name"]: one["value"] for one in json.loads(done.stdout)["results"]}
    assert values["first"] == 100.0
    assert values["faults_called_good"] == 0.0
