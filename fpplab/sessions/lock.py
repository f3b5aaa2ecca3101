"""One process at a time writes into a session."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fpplab.core.errors import DataError
from fpplab.core.files import writing
from fpplab.core.lock_owner import lock_owner, write_lock_owner

_held: dict[Path, int] = {}
"""How many parts of this process hold each lock: a scan holds it while it acquires, and then reconstructs."""


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Keep other processes from writing into a session.

    The lock is a file beside the session, `.NAME.lock`, which the system unlocks when its process ends,
    however it does; a session that is replaced keeps its lock. It names the process that holds it.

    Parameters
    ----------
    path : Path
        Directory of the session; it need not exist yet.

    Yields
    ------
    None
        While the lock is held.

    Raises
    ------
    DataError
        Another process writes into it, or the file system cannot lock files.
    """
    place = path.resolve()
    if place in _held:
        _held[place] += 1
        try:
            yield
        finally:
            _held[place] -= 1
        return
    lock = place.with_name(f".{place.name}.lock")
    made = [folder for folder in place.parents if not folder.exists()]
    handle = _locked(lock, path)
    _held[place] = 1
    try:
        yield
    finally:
        del _held[place]
        lock.unlink(missing_ok=True)  # while it is locked, so that nobody else's is taken away
        os.close(handle)
        with suppress(OSError):  # the first that holds something
            for folder in made:
                folder.rmdir()


def _locked(lock: Path, path: Path) -> int:
    """Open and lock a file; gives its descriptor."""
    while True:
        with writing(path):
            lock.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            _lock(handle, lock, path)
            if _is_there_still(handle, lock):
                write_lock_owner(handle)
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _is_there_still(handle: int, lock: Path) -> bool:
    """Whether the file was not deleted, by the one who held it before, since it was opened."""
    try:
        return os.path.samestat(os.fstat(handle), lock.stat())
    except FileNotFoundError:
        return False


def _lock(handle: int, lock: Path, path: Path) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DataError(
            f"{path}: {lock_owner(lock)} is writing into it; wait until that is done, or name another output"
        ) from None
    except OSError as error:
        raise DataError(
            f"{path}: this file system cannot lock files ({error.strerror}), so that two commands could "
            "write into one session; name an output on a disk of this computer"
        ) from error
