"""What memory and disk of this machine allow, measured in the same run as the speeds that stand beside it."""

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import Result
from fpplab.phase.code_decoding import processors
from fpplab.phase.kernels import read_all

ARRAYS, BYTES = 4, 1 << 26
"""Arrays of so many bytes, which no cache holds."""
ROUNDS = 5


def machine_figures() -> list[Result]:
    """Measure reading of memory, by all processors beside one, and writing, flushed beside into the cache.

    Returns
    -------
    list of Result
        In GB/s, the best of some rounds.
    """
    arrays = [np.ones(BYTES, np.uint8) for _ in range(ARRAYS)]
    single, shared = (_rate(partial(read_memory, arrays, n)) for n in (1, processors()))
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        file = Path(folder) / "bytes"
        cached, flushed = (_rate(partial(_write, file, arrays, flush)) for flush in (False, True))
    return [
        Result("machine_memory_read", shared, "GB/s", single, shared / single),
        Result("machine_disk_write", flushed, "GB/s", cached, flushed / cached),
    ]


def read_memory(arrays: Sequence[NDArray[np.uint8]], workers: int) -> None:
    """Touch every byte of arrays of one size once, as fast as the machine can.

    Parameters
    ----------
    arrays : sequence of ndarray of uint8
        Contiguous.
    workers : int
        Number of threads.
    """
    words = [a.reshape(-1)[: a.size // 8 * 8].view(np.uint64) for a in arrays]
    n, like = len(words[0]), np.empty(0, np.uint64)
    edges = [n * k // workers for k in range(workers + 1)]
    addresses = np.array([w.ctypes.data for w in words], np.uintp)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda k: read_all(addresses, like, edges[k], edges[k + 1]), range(workers)))


def _rate(work: Callable[[], None]) -> float:
    """GB/s at which the arrays are worked on."""
    seconds = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return ARRAYS * BYTES / min(seconds) / 1e9


def _write(path: Path, arrays: Sequence[NDArray[np.uint8]], flush: bool) -> None:
    with path.open("wb") as file:
        for array in arrays:
            file.write(array.data)
        file.flush()
        if flush:
            os.fsync(file.fileno())
