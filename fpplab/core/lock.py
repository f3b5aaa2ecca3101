"""Locks between processes: of files, given back by the system when a process ends, however it does.

Linux and macOS lock a whole file by `flock`. Windows locks single bytes, each for one process alone: one of a
row far behind the content is taken to share the lock, and all of them to have it alone.
"""

import errno
import json
import os
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from fpplab.core.errors import DataError
from fpplab.core.strict_json import parse_object
from fpplab.core.system import system_module

fcntl = system_module("fcntl")  # None on Windows

FIRST_BYTE, SHARES = 1 << 30, 32
"""Where the bytes begin that are locked on Windows, and how many processes can share a lock there."""


def open_lock(path: Path, mode: int = 0o644) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT, mode)  # Python lets no child inherit it


def try_lock(handle: int, shared: bool = False) -> bool:
    if fcntl is None:
        return _try_bytes(handle, shared)
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _try_bytes(handle: int, shared: bool) -> bool:
    byte_ranges = [(FIRST_BYTE + n, 1) for n in range(SHARES)] if shared else [(FIRST_BYTE, SHARES)]
    return any(_lock_bytes(handle, *bytes_) for bytes_ in byte_ranges)


def _lock_bytes(handle: int, first: int, count: int) -> bool:
    import msvcrt

    windows: Any = msvcrt  # whose types are those of another system
    place = os.lseek(handle, 0, os.SEEK_CUR)
    os.lseek(handle, first, os.SEEK_SET)
    try:
        windows.locking(handle, windows.LK_NBLCK, count)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EDEADLK):
            return False
        raise
    finally:
        os.lseek(handle, place, os.SEEK_SET)  # or what is written next would begin behind the locked bytes
    return True


@contextmanager
def locked_file(path: Path) -> Iterator[bool]:
    """Hold a file's lock alone for a while; the file, made for it, is deleted afterwards."""
    handle = _locked(path)
    try:
        yield handle is not None
    finally:
        if handle is not None:
            _delete_and_close(handle, path)


def _locked(path: Path) -> int | None:
    while True:
        handle, let_go = open_lock(path), os.close
        try:
            if not _lock(handle, path):
                os.close(handle)
                return None
            if _is_there_still(handle, path):
                let_go = partial(_delete_and_close, path=path)  # or on a full disk an empty file would stay
                write_lock_owner(handle)
                return handle
        except BaseException:
            let_go(handle)
            raise
        os.close(handle)


def _delete_and_close(handle: int, path: Path) -> None:
    """Delete a file that is locked here, and no other process's."""
    if fcntl is None:
        os.close(handle)  # Windows deletes no file that any process has open
    with suppress(OSError):  # of a disk that is gone: the file stays, unlocked
        path.unlink(missing_ok=True)
    if fcntl is not None:
        os.close(handle)  # only now, or another process could have locked it


def _lock(handle: int, path: Path) -> bool:
    try:
        return try_lock(handle)
    except OSError as error:
        raise DataError(
            f"{path.parent}: this file system cannot lock files ({error.strerror}), so that two commands "
            "could write into one folder; name an output on a disk of this computer"
        ) from error


def _is_there_still(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def write_lock_owner(handle: int) -> None:
    owner = {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "since": time.strftime("%Y-%m-%d %H:%M:%S"),
        "command": " ".join(["fpplab", *sys.argv[1:]])[:200],
    }
    os.ftruncate(handle, 0)
    os.lseek(handle, 0, os.SEEK_SET)
    os.write(handle, json.dumps(owner).encode())


def lock_owner(lock: Path) -> str:
    """Say who holds a lock; it may not have written its name yet."""
    try:
        with lock.open("rb") as file:
            owner = parse_object(file.read(10_000))
        return "process {pid} on {host} ('{command}', since {since})".format(**owner)
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
