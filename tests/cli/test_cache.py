"""`fpplab cache`: what is kept outside of results is shown and cleared, and nothing else is touched."""

from pathlib import Path

import numpy as np
import pytest

from sim.light.cache import TableCache
from sim.light.table import LightTable
from tests.support.commands import Command

PIXELS = 400


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user's cache folder with one table of light, beside another program's."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("of another program")
    samples = np.zeros((PIXELS, PIXELS, 2, 6), np.float32)
    TableCache().store("0" * 32, LightTable(samples, np.zeros((PIXELS, PIXELS), np.float32), (0, 0)))
    return tmp_path


def test_what_is_kept_is_shown(fpplab: Command, home: Path) -> None:
    (table,) = (home / "fpplab" / "light").iterdir()
    found = fpplab("cache", "--json").json
    assert found["directory"] == str(home / "fpplab")
    (folder,) = found["folders"]
    assert (folder["path"], folder["files"]) == (str(home / "fpplab" / "light"), 1)
    assert "light" in folder["holds"]
    assert found["bytes"] == folder["bytes"]
    assert abs(folder["bytes"] - table.stat().st_size) <= 8192  # whole blocks
    shown = fpplab("cache")
    assert shown.code == 0
    assert shown.out.startswith(f"Kept: {home / 'fpplab' / 'light'}: 8.")
    assert " MB in 1 files, " in shown.out
    assert table.exists()


def test_what_is_kept_is_cleared_and_nothing_else(fpplab: Command, home: Path) -> None:
    precious = home / "precious"
    precious.mkdir()
    (precious / "result").write_text("1")
    (home / "fpplab" / "link").symlink_to(precious)
    before = fpplab("cache", "--json").json["bytes"]
    done = fpplab("cache", "clear", "--json")
    assert done.code == 0, done.err
    assert done.json["bytes"] == before > 0
    assert fpplab("cache", "--json", "clear").json["bytes"] == 0
    assert not (home / "fpplab" / "light").exists()
    assert (precious / "result").exists()
    assert (home / "other" / "file").exists()
    assert fpplab("cache", "--json").json["bytes"] == 0
    assert fpplab("cache", "clear").code == 0


def test_nothing_kept_is_said(fpplab: Command, tmp_path: Path) -> None:
    done = fpplab("cache", env={"XDG_CACHE_HOME": str(tmp_path / "none")})
    assert (done.code, done.out) == (0, f"{tmp_path / 'none' / 'fpplab'}: nothing is kept\n")
