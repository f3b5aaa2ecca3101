"""What Windows lacks and has, in this process; the locks of files are still the system's own."""

import errno
import fcntl
import os
import signal
import struct
import subprocess  # which asks for msvcrt to know where it runs  # noqa: F401
import sys
from types import ModuleType
from typing import Any

LACKING = ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty")
"""Modules."""
OF_OS = ("fchmod", "fork", "getuid", "geteuid", "pread", "pwrite", "O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK")
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


def pretend() -> None:
    """From now on imports find what Windows has."""
    windows: Any = ModuleType("msvcrt")
    windows.LK_NBLCK, windows.locking = 2, locking
    sys.modules["msvcrt"] = windows
    for name in LACKING:
        sys.modules[name] = None  # type: ignore[assignment]
    for module, names in ((os, OF_OS), (signal, OF_SIGNAL)):
        for name in names:
            delattr(module, name)
