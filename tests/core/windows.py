"""What Windows lacks and has, in this process; the locks of files are still the system's own."""

import errno
import fcntl
import mmap
import os
import select
import signal
import struct
import subprocess  # which asks for msvcrt to know where it runs  # noqa: F401
import sys
import tempfile
from types import ModuleType
from typing import Any

import psutil  # has another part for each system, which this one's needs  # noqa: F401

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
