"""What Windows lacks, has and refuses, in this process; the locks of files are still the system's own."""

import errno
import fcntl
import mmap
import os
import select
import shutil
import signal
import struct
import subprocess  # which asks for msvcrt to know where it runs  # noqa: F401
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import psutil  # has another part for each system, which this one's needs  # noqa: F401
import serial  # likewise  # noqa: F401

LACKING = ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty")
"""Modules."""
OF_OS = (
    "fchmod", "fork", "getuid", "geteuid", "memfd_create", "openpty", "posix_fallocate", "pread", "pwrite",
    "sched_getaffinity", "sched_setaffinity", "O_CLOEXEC", "O_DIRECT", "O_NOFOLLOW", "O_NONBLOCK",
)  # fmt: skip
OF_SIGNAL = ("SIGALRM", "SIGHUP", "SIGKILL", "setitimer", "ITIMER_REAL", "pthread_sigmask")
SET_LOCK = fcntl.F_OFD_SETLK
"""Locks bytes for an open file, not for a process, as Windows does."""


def locking(handle: int, how: int, count: int) -> None:
    """As of msvcrt: locks bytes from where the file stands, for one alone."""
    assert how == 2, "only this was thought of"
    wanted = struct.pack("hhqqi0q", fcntl.F_WRLCK, os.SEEK_CUR, 0, count, 0)
    try:
        fcntl.fcntl(handle, SET_LOCK, wanted)
    except BlockingIOError:
        raise PermissionError(errno.EACCES, "Permission denied") from None


map_file: Any = mmap.mmap


def tagged(file: int, size: int, *more: Any, tagname: str = "", **named: Any) -> Any:
    """As mmap.mmap there: memory of a tag is shared by all processes that name it."""
    if not tagname:
        return map_file(file, size, *more, **named)
    handle = os.open(os.path.join(tempfile.gettempdir(), tagname), os.O_RDWR | os.O_CREAT)
    try:
        os.ftruncate(handle, size)
        return map_file(handle, size)
    finally:
        os.close(handle)


remove_file, rename_path, replace_path = os.unlink, os.rename, os.replace
open_file, write_bytes = os.open, os.write


def is_open(path: Any) -> bool:
    """Whether this process has a file open or mapped, or one in a folder."""
    place = os.path.realpath(path)
    handles = (f"/proc/self/fd/{number}" for number in os.listdir("/proc/self/fd"))
    held = [os.readlink(handle) for handle in handles if os.path.lexists(handle)]
    held += [line.split(maxsplit=5)[-1] for line in Path("/proc/self/maps").read_text().splitlines()]
    return any(file == place or file.startswith(f"{place}/") for file in held)


def _refuse_open(*paths: Any) -> None:
    for path in paths:
        if is_open(path):
            raise PermissionError(errno.EACCES, "The file is used by another process", str(path))


def unlink(path: Any, *, dir_fd: int | None = None) -> None:
    """As there: a file that is open stays."""
    _refuse_open(path if dir_fd is None else f"/proc/self/fd/{dir_fd}/{path}")
    remove_file(path, dir_fd=dir_fd)


def rename(source: Any, target: Any) -> None:
    """As there: nothing is replaced, and what is open keeps its name."""
    if os.path.exists(target):
        raise FileExistsError(errno.EEXIST, "The file exists already", str(source), None, str(target))
    _refuse_open(source)
    rename_path(source, target)


def replace(source: Any, target: Any) -> None:
    """As there: neither file is open."""
    _refuse_open(source, target)
    replace_path(source, target)


def symlink(source: Any, target: Any, target_is_directory: bool = False) -> None:
    """As there for all but administrators."""
    raise OSError(errno.EPERM, "A required privilege is not held by the client", str(target))


BINARY = 1 << 30  # a flag that Linux does not know, and takes no notice of
_texts = dict[int, os.stat_result]()
"""Descriptors that were opened as texts, as all are without that flag, and the files they stood for."""


def open_text(path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
    """As there: of texts, newlines are written as two bytes."""
    handle = open_file(path, flags & ~BINARY, mode, dir_fd=dir_fd)
    _texts.pop(handle, None)
    if not flags & BINARY:
        _texts[handle] = os.fstat(handle)
    return handle


def write(handle: int, data: Any) -> int:
    """As there."""
    if handle not in _texts or not os.path.samestat(_texts[handle], os.fstat(handle)):
        return write_bytes(handle, data)
    write_bytes(handle, bytes(data).replace(b"\n", b"\r\n"))
    return len(data)


FILES: dict[str, Callable[..., Any]] = {
    "unlink": unlink, "remove": unlink, "rename": rename, "replace": replace, "symlink": symlink,
    "open": open_text, "write": write,
}  # fmt: skip
"""What else files there do, by the name in `os`."""


def pretend() -> None:
    """From now on imports find what Windows has."""
    windows: Any = ModuleType("msvcrt")
    windows.LK_NBLCK, windows.locking = 2, locking
    sys.modules["msvcrt"] = windows
    for name in LACKING:
        sys.modules[name] = None  # type: ignore[assignment]
    mmap.mmap = tagged  # type: ignore[assignment, misc]
    for module, names in ((os, OF_OS), (signal, OF_SIGNAL), (select, ("poll", "epoll"))):
        for name in names:
            delattr(module, name)
    for name, function in FILES.items():
        setattr(os, name, function)
    os.O_BINARY = BINARY  # type: ignore[attr-defined]
    tempfile._bin_openflags |= BINARY  # type: ignore[attr-defined]
    shutil._use_fd_functions = False  # type: ignore[attr-defined]
