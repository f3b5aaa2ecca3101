"""Locks of files between processes, by `flock` and by the single bytes of Windows."""

import errno
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from fpplab.core.lock import SHARES, locked_file, open_lock

WINDOWS = "from tests.core.windows import pretend; pretend()\n"
SYSTEMS = {"flock": "", "bytes": WINDOWS}
TRY = """
import sys
from fpplab.core.lock import open_lock, try_lock
handle = open_lock(FILE)
print(try_lock(handle, SHARED), flush=True)
sys.stdin.read()
"""


@pytest.fixture(params=SYSTEMS)
def system(request: pytest.FixtureRequest) -> str:
    """The beginning of a program that locks in this way."""
    return SYSTEMS[request.param]


@contextmanager
def program(text: str, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A process, which is killed in the end."""
    command = [sys.executable, "-c", text, *words]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def line(process: subprocess.Popen[str]) -> str:
    assert process.stdout
    return process.stdout.readline().strip()


def locker(system: str, file: Path, shared: bool) -> str:
    return system + TRY.replace("FILE", repr(str(file))).replace("SHARED", str(shared))


def test_a_lock_is_shared_or_held_alone_until_its_process_ends(system: str, tmp_path: Path) -> None:
    shared, alone = (locker(system, tmp_path / "lock", shared) for shared in (True, False))
    with ExitStack() as stack:
        for _ in range(3):
            assert line(stack.enter_context(program(shared))) == "True"
        with program(alone) as refused:
            assert line(refused) == "False"
    with program(alone) as holder:
        assert line(holder) == "True"
        for other in (shared, alone):
            with program(other) as refused:
                assert line(refused) == "False"
    with program(shared) as last:
        assert line(last) == "True"


def test_on_windows_so_many_can_share_a_lock_and_one_more_waits(tmp_path: Path) -> None:
    all_of_them = (
        f"handles = [open_lock({str(tmp_path / 'lock')!r}) for _ in range({SHARES})]\n"
        "print(sum(try_lock(one, True) for one in handles), try_lock(handle, True), flush=True)"
    )
    one = "print(try_lock(handle, True), flush=True)"
    sharing = locker(WINDOWS, tmp_path / "lock", True).replace(one, all_of_them)
    with program(sharing) as full:
        assert line(full) == f"{SHARES} False"


HOLD = """
import sys
from pathlib import Path
from fpplab.core.lock import lock_owner, locked_file
path = Path(sys.argv[1])
with locked_file(path) as is_mine:
    print(is_mine, lock_owner(path), flush=True)
    sys.stdin.read()
"""


def test_a_lock_names_its_owner_and_leaves_no_file(system: str, tmp_path: Path) -> None:
    """On Windows others can read it as well: the bytes that are locked are not those of the name."""
    file = tmp_path / "lock"
    with program(system + HOLD, str(file)) as holder:
        first = line(holder)
        assert first.startswith("True process ")
        with program(system + HOLD, str(file)) as other:
            assert line(other) == first.replace("True", "False")
        holder.communicate()
    assert not file.exists()


def test_a_lock_on_a_disk_that_is_gone_is_let_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "lock"

    def gone(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EIO, "Input/output error", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", gone)
        with locked_file(file) as ours:
            assert ours
    assert file.exists()
    with locked_file(file) as again:
        assert again, "its file stayed, unlocked"


def test_a_file_that_is_deleted_before_it_is_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By who held it until then: a lock on a file without a name would keep nobody out."""
    opened = []

    def open_too_early(path: Path) -> int:
        opened.append(open_lock(path))
        if len(opened) == 1:
            path.unlink()
        return opened[-1]

    monkeypatch.setattr("fpplab.core.lock.open_lock", open_too_early)
    with locked_file(tmp_path / "lock") as is_mine:
        assert is_mine
        assert (tmp_path / "lock").exists()


def test_a_lock_on_the_file_before_the_present_one_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file was deleted and made again, by another process, between opening and locking it."""
    opened = []

    def open_too_early(path: Path) -> int:
        opened.append(open_lock(path))
        if len(opened) == 1:
            path.unlink()
            path.touch()
        return opened[-1]

    monkeypatch.setattr("fpplab.core.lock.open_lock", open_too_early)
    with locked_file(tmp_path / "lock") as is_mine:
        assert is_mine
        assert len(opened) == 2
        assert os.path.samestat(os.fstat(opened[-1]), (tmp_path / "lock").stat())


SESSION = """
import sys
from pathlib import Path
import numpy, tifffile
WINDOWS
from fpplab.core.files import sweep_file_drafts, write_text
from sim.dataset.shard import claim_shard
from fpplab.devices.rig_lock import using_rig, watching_rig
from fpplab.sessions.lock import exclusive_write
import fpplab.setup.live.keys, drivers.video_camera.camera
folder = Path(sys.argv[1])
with exclusive_write(folder / "part"), using_rig("rig.yaml"):
    with watching_rig("rig.yaml") as turn:
        assert turn.is_requested() and not turn.take()
    write_text(folder / "cloud.ply", "whole")
    sweep_file_drafts(folder / "cloud.ply")
    with claim_shard(folder, 0) as draft:
        (draft / "x").touch()
print(sorted(path.name for path in folder.iterdir()))
"""


def test_all_that_locks_does_without_what_windows_lacks(tmp_path: Path) -> None:
    with program(SESSION.replace("WINDOWS", WINDOWS), str(tmp_path)) as process:
        assert line(process) == "['cloud.ply', 'shard_00000']"


def test_a_file_is_written_from_its_beginning_after_it_was_locked(system: str, tmp_path: Path) -> None:
    text = "from fpplab.core.lock import open_lock, try_lock\nimport os\n"
    text += (
        f"handle = open_lock({str(tmp_path / 'file')!r})\nassert try_lock(handle)\nos.write(handle, b'1')\n"
    )
    with program(system + text) as writer:
        writer.wait()
    assert (tmp_path / "file").read_bytes() == b"1"
