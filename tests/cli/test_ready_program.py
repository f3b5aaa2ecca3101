"""Commands run in a process forked for them do as in one of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import ROOT, run
from tests.support.ready_program import ReadyProgram


@pytest.mark.parametrize("words", [["--version"], ["rubbish"], ["plan", "show", "none.yaml"], ["artefact"]])
def test_the_same_answer(words: list[str], tmp_path: Path) -> None:
    alone = subprocess.run(
        [sys.executable, "-m", "fpplab", *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    forked = run(*words, cwd=tmp_path)
    assert (forked.code, forked.out, forked.err) == (alone.returncode, alone.stdout, alone.stderr)


def test_a_file_is_written_where_the_command_runs(tmp_path: Path) -> None:
    done = run("artefact", "pyramid", "--out", "pyramid.stl", cwd=tmp_path)
    assert done.code == 0, done.err
    assert [path.name for path in tmp_path.iterdir()] == ["pyramid.stl"]


def test_an_environment_that_modules_may_have_read_needs_a_process_of_its_own() -> None:
    ready, given = ReadyProgram(ROOT), dict(os.environ)
    assert ready.fits({**given, "DISPLAY": ":7"}) == (sys.platform == "linux")
    assert not ready.fits({**given, "NUMBA_NUM_THREADS": "7"})
