"""Writing large files past the system's cache, which would copy them and flush its copy afterwards."""

import io
import os
from contextlib import suppress
from mmap import mmap
from typing import Any

from fpplab.core.system import posix, system_module

fcntl = system_module("fcntl")  # None on Windows

STAGED_BYTES = 1 << 22  # bytes that are written at a time (chosen)


class DirectWriter(io.BufferedIOBase):
    """A stream that writes a file from front to back."""

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self._staged = memoryview(mmap(-1, STAGED_BYTES))  # begins at a page, as the system demands
        self._filled = self._before = 0
        _set_direct(handle, True)

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        source, done = memoryview(data).cast("B"), 0
        while done < len(source):
            part = source[done : done + STAGED_BYTES - self._filled]
            self._staged[self._filled : self._filled + len(part)] = part
            self._filled += len(part)
            done += len(part)
            if self._filled == STAGED_BYTES:
                self._write_staged()
        return len(source)

    def tell(self) -> int:
        return self._before + self._filled

    def finish(self) -> None:
        _set_direct(self._handle, False)  # which takes whole blocks only
        self._write_staged()
        os.fsync(self._handle)

    def _write_staged(self) -> None:
        unwritten = self._staged[: self._filled]
        while unwritten:
            unwritten = unwritten[os.write(self._handle, unwritten) :]
            if (
                unwritten
            ):  # what is left does not begin at a block; without the cache the reason would be lost
                _set_direct(self._handle, False)
        self._before += self._filled
        self._filled = 0


def _set_direct(handle: int, direct: bool) -> None:
    """Switch the cache off or on, where the file system supports it; the file's content is the same."""
    if fcntl is None or not hasattr(os, "O_DIRECT"):
        return
    flags = fcntl.fcntl(handle, fcntl.F_GETFL)
    with suppress(OSError):
        fcntl.fcntl(handle, fcntl.F_SETFL, flags | posix.O_DIRECT if direct else flags & ~posix.O_DIRECT)
