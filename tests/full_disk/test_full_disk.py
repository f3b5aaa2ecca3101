"""A command whose disk is full leaves nothing half-written and says so."""

import errno
from pathlib import Path

import pytest

from benchmarks.crash.programs import SCAN_EMULATED, prepare
from tests.full_disk.commands import COMMANDS
from tests.full_disk.disks import can_mount, detach, disk
from tests.full_disk.every_write import EveryWrite
from tests.full_disk.inputs import EVERY_COMMAND, prepare_inputs
from tests.full_disk.trial import try_every_size
from tests.full_disk.vanishing import can_vanish, vanishing_disks
from tests.full_disk.writes import can_refuse, refusing_program
from tests.support.commands import run


@pytest.fixture
def place(tmp_path: Path) -> Path:
    if not can_mount(tmp_path / "trial"):
        pytest.skip("this process may not mount a file system")
    return tmp_path / "disk"


@pytest.mark.nightly
@pytest.mark.parametrize("writing", COMMANDS, ids=lambda writing: writing.name)
def test_full_at_every_page(place: Path, writing: object) -> None:
    complaints = list(try_every_size(writing, place))  # type: ignore[arg-type]
    assert len(complaints) > 1
    assert [complaint for complaint in complaints if complaint] == []


@pytest.mark.whole
def test_a_disk_that_is_gone_is_told(place: Path) -> None:
    with disk(place):
        COMMANDS[1].prepare(place)
        detach(place)
        done = run("decode", place / "session", "--out", place / "decoded.npz")
    assert done.code == 4
    assert "there is no such file or folder" in done.err


@pytest.mark.nightly
def test_a_disk_that_vanishes_under_a_scan(tmp_path: Path) -> None:
    if not can_vanish(tmp_path / "trial"):
        pytest.skip("this process may not mount a loop device")
    prepare(tmp_path, (SCAN_EMULATED,))
    assert list(vanishing_disks(tmp_path, SCAN_EMULATED, times=2, seed=2)) == ["", ""]


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("error", "names"),
    [(errno.ENOSPC, {"scan", "repair"}), (errno.EDQUOT, {"convert", "artefact"})],
    ids=["full", "quota"],
)
def test_full_at_every_write(tmp_path: Path, error: int, names: set[str]) -> None:
    """Some writes of some commands; `make full-disk` tries all."""
    if not can_refuse():
        pytest.skip("there is no C compiler")
    prepare_inputs(tmp_path)
    with refusing_program(tmp_path) as program:
        for command in EVERY_COMMAND:
            if command.name in names:
                trials = EveryWrite(program, command, tmp_path, tmp_path / "disk", error, resolution=12)
                found = trials.run()
                assert found.tried > 1
                assert found.complaints == []
