"""Memory for large arrays that is used again, because the system clears fresh pages slowly."""

import math
import threading
import weakref
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import psutil
from numpy.typing import DTypeLike, NDArray


@dataclass(frozen=True)
class BufferLimits:
    """Limits of the memory that is kept for reuse."""

    min_bytes: int = 1 << 22
    """Smaller arrays come from the allocator, which reuses its memory itself (chosen)"""
    max_kept_bytes: int = min(3 << 30, psutil.virtual_memory().total // 6)
    """Unused memory that is kept. Chosen: what a measurement at twenty megapixels needs."""
    max_waste: int = 2  # how many times larger than needed a block may be (chosen)


LIMITS = BufferLimits()


_Block = NDArray[np.uint8]
_free: list[_Block] = []
_returned: deque[_Block] = deque()
_lock = threading.Lock()


def empty(shape: int | tuple[int, ...], dtype: DTypeLike = np.float32) -> NDArray[Any]:
    kind = np.dtype(dtype)
    count = math.prod(shape) if isinstance(shape, tuple) else shape
    size = count * kind.itemsize
    if size < LIMITS.min_bytes:
        return np.empty(shape, kind)
    block = _kept(size)
    if block is None:
        block = np.empty(size, np.uint8)
    # All views of the array hold `loan`, because its memory belongs to an object that is no array.
    loan = np.frombuffer(block.data, np.uint8)
    # Called in whatever thread drops the last view, and so it must not wait for a lock.
    weakref.finalize(loan, _returned.append, block).atexit = False
    return loan[:size].view(kind).reshape(shape)


def _kept(size: int) -> _Block | None:
    """The smallest block that is free and large enough, unless it is far too large."""
    with _lock:
        while _returned:
            _free.append(_returned.popleft())
        fitting = [block for block in _free if size <= block.nbytes <= LIMITS.max_waste * size]
        smallest = min(fitting, key=lambda block: block.nbytes, default=None)
        kept = [block for block in _free if block is not smallest]
        while sum(block.nbytes for block in kept) > LIMITS.max_kept_bytes:
            del kept[0]
        _free[:] = kept
        return smallest
