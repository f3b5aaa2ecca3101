"""Commands run in a process forked for them do as in one of their own."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import ROOT, run
from tests.support.ready_program import ReadyProgram


@pytest.mark.whole_after(2)
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


@pytest.mark.whole
def test_a_command_can_be_killed_and_the_next_one_runs(tmp_path: Path) -> None:
    ready, given = ReadyProgram(ROOT), dict(os.environ)
    words = ["artefact", "pyramid", "--out", "pyramid.stl"]
    try:
        killed = ready.run(words, tmp_path, given, 60.0, lambda process: os.kill(process, signal.SIGKILL))
        assert killed.returncode == -signal.SIGKILL
        assert ready.run(words, tmp_path, given, 60.0).returncode == 0
    finally:
        ready.close()


def test_an_environment_that_modules_may_have_read_needs_a_process_of_its_own() -> None:
    ready, given = ReadyProgram(ROOT), dict(os.environ)
    assert ready.fits({**given, "DISPLAY": ":7"}) == (sys.platform == "linux")
    assert not ready.fits({**given, "NUMBA_NUM_THREADS": "7"})


def test_what_libraries_set_while_they_are_loaded_costs_no_process() -> None:
    code = (
        "import os, pathlib; from tests.support.ready_program import ReadyProgram; "
        "ready = ReadyProgram(pathlib.Path('.')); "
        "import cv2, pypylon.pylon, rerun, sdl2, threadpoolctl, trimesh; "
        "assert os.environ['LD_LIBRARY_PATH']; raise SystemExit(0 if ready.fits(dict(os.environ)) else 1)"
    )
    bare = {name: value for name, value in os.environ.items() if name != "LD_LIBRARY_PATH"}
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=bare, check=False).returncode == 0
