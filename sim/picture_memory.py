"""Memory for pictures that two processes share; the system takes it back with the last of them.

Windows knows it by a tag. Elsewhere it is a file without a name, in memory where the system has such files,
which the other process inherits open: it does not depend on the size of /dev/shm.
"""

import mmap
import os
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from fpplab.core.system import posix, system_module


@dataclass(frozen=True)
class MemoryPlace:
    """Where the other process finds the memory."""

    size: int  # in bytes
    descriptor: int = -1  # of the inherited file
    tag: str = ""  # on Windows

    def mapped(self) -> NDArray[np.float32]:
        if self.tag:
            tagged: Any = mmap.mmap  # whose tags are those of Windows alone
            return np.frombuffer(tagged(-1, self.size, tagname=self.tag), np.float32)
        return np.frombuffer(mmap.mmap(self.descriptor, self.size), np.float32)


class PictureMemory:
    """Memory that grows with the pictures."""

    def __init__(self) -> None:
        self._descriptor = -1 if system_module("fcntl") is None else _nameless_file()
        self.place = MemoryPlace(0, self._descriptor)
        self._pixels = np.empty(0, np.float32)

    @property
    def inherited(self) -> tuple[int, ...]:
        """File descriptors that the other process has to inherit."""
        return () if self._descriptor < 0 else (self._descriptor,)

    def grown_to(self, size: int) -> NDArray[np.float32]:
        """Map at least `size` bytes; `OSError` where the system has not as many."""
        if size > self._pixels.nbytes:
            if self._descriptor >= 0:
                _allocate(self._descriptor, size)
            tag = "" if self._descriptor >= 0 else f"fpplab-{uuid4()}"
            self.place = MemoryPlace(size, self._descriptor, tag)
            self._pixels = self.place.mapped()
        return self._pixels

    def close(self) -> None:
        """Release the memory; pictures that are still in use keep theirs."""
        self._pixels = np.empty(0, np.float32)
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1


def _nameless_file() -> int:
    with suppress(AttributeError, OSError):  # Linux alone has it, and not in every container
        return int(posix.memfd_create("fpplab-pictures"))
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _allocate(descriptor: int, size: int) -> None:
    if hasattr(os, "posix_fallocate"):  # too little memory is refused here, not found while writing
        posix.posix_fallocate(descriptor, 0, size)
    else:
        os.ftruncate(descriptor, size)
