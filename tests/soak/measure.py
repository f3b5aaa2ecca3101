"""What a process holds, and whether it grows."""

from __future__ import annotations

import gc
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import psutil

SETTLED = 10
"""Rounds after which nothing may grow any more: caches are full, libraries loaded."""
MB_PER_ROUND, MB_IN_ALL = 0.05, 20.0
"""Growth of memory that counts as flat: of a line through all rounds, and of the last over the first."""


@dataclass(frozen=True)
class Held:
    """Open handles, threads, segments of shared memory, and resident memory in MB."""

    handles: int
    threads: int
    shared: int
    memory_mb: float

    @classmethod
    def now(cls) -> Held:
        """Of this process."""
        gc.collect()
        process = psutil.Process()
        shared = sum(1 for _ in Path("/dev/shm").glob("*"))
        return cls(process.num_fds(), process.num_threads(), shared, process.memory_info().rss / 1e6)


def growth(rounds: list[Held]) -> list[str]:
    """What grew after the rounds that settle; empty if nothing."""
    left = rounds[SETTLED:]
    complaints = []
    for name in ("handles", "threads"):
        counts = [getattr(one, name) for one in left]
        if max(counts[len(counts) // 2 :]) > max(counts[: max(1, len(counts) // 2)]):
            complaints.append(f"{name} grow from {counts[0]} to {counts[-1]}")
    memory = np.array([one.memory_mb for one in left])
    slope = float(np.polyfit(np.arange(len(memory)), memory, 1)[0]) if len(memory) > 2 else 0.0
    if slope > MB_PER_ROUND and memory[-1] - memory[0] > MB_IN_ALL:
        complaints.append(
            f"memory grows by {slope:.3f} MB a round, from {memory[0]:.0f} to {memory[-1]:.0f} MB"
        )
    return complaints


def words(held: Held) -> str:
    """One line."""
    return "{} handles, {} threads, {} segments, {:.0f} MB".format(*astuple(held))
