"""A command whose disk is full leaves nothing half-written and says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.full_disk.commands import COMMANDS
from tests.full_disk.disks import can_mount, detach, disk
from tests.full_disk.trial import try_every_size
from tests.support.commands import run


@pytest.fixture
def place(tmp_path: Path) -> Path:
    if not can_mount(tmp_path / "trial"):
        pytest.skip("this process may not mount a file system")
    return tmp_path / "disk"


@pytest.mark.slow
@pytest.mark.parametrize("writing", COMMANDS, ids=lambda writing: writing.name)
def test_full_at_every_page(place: Path, writing: object) -> None:
    complaints = list(try_every_size(writing, place))  # type: ignore[arg-type]
    assert len(complaints) > 1
    assert [complaint for complaint in complaints if complaint] == []


def test_a_disk_that_is_gone_is_told(place: Path) -> None:
    with disk(place):
        COMMANDS[1].prepare(place)
        detach(place)
        done = run("decode", place / "session", "--out", place / "decoded.npz")
    assert done.code == 4
    assert "is not a session" in done.err
