"""Files as Windows treats them: what is open is neither deleted, replaced nor renamed."""

import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from io import BufferedReader
from pathlib import Path

import numpy as np
import pytest

from fpplab.core import files
from fpplab.core.errors import DataError
from fpplab.core.files import is_portable_name, write_text
from fpplab.sessions.folder import remove_session
from tests.core.windows import FILES
from tests.support.recorded import record


@pytest.fixture(autouse=True)
def windows(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, function in FILES.items():
        monkeypatch.setattr(os, name, function)
    monkeypatch.setattr(shutil, "_use_fd_functions", False)
    monkeypatch.setattr(files, "WINDOWS", True)


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[BufferedReader]:
    (tmp_path / "cloud.ply").write_text("old")
    with (tmp_path / "cloud.ply").open("rb") as stream:
        yield stream


def test_a_file_is_replaced_once_others_have_read_it(
    opened: BufferedReader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files.time, "sleep", lambda seconds: opened.close())
    write_text(tmp_path / "cloud.ply", "new")
    assert (tmp_path / "cloud.ply").read_text() == "new"


def test_a_file_that_stays_open_is_told_and_kept(
    opened: BufferedReader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "LIMITS", replace(files.LIMITS, opened_s=0.0))
    with pytest.raises(DataError, match=r"cloud\.ply: cannot be written .*; close it in other programs"):
        write_text(tmp_path / "cloud.ply", "new")
    assert opened.read() == b"old"
    assert os.listdir(tmp_path) == ["cloud.ply"]


def test_a_session_of_which_a_frame_is_open_is_kept_as_a_whole(tmp_path: Path) -> None:
    path = record(tmp_path / "scan").path
    whole = sorted(path.rglob("*"))
    frame = np.memmap(next(path.glob("frames/*")), np.uint8, "r")
    with pytest.raises(DataError, match="close it in other programs"):
        remove_session(path)
    assert sorted(path.rglob("*")) == whole
    del frame
    remove_session(path)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "name", ["", "con", "Aux.txt", "nul", "COM1", "a:b", "a/b", "a\\b", "dot.", "blank ", "a\n"]
)
def test_names_that_windows_does_not_allow_are_known(name: str) -> None:
    assert not is_portable_name(name)


@pytest.mark.parametrize("name", ["pyramid", "Größe 2", "console", "com", "ball.bar", ".hidden"])
def test_all_other_names_are_allowed(name: str) -> None:
    assert is_portable_name(name)
