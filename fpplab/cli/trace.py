"""Where the time of a command went: the table that `--trace` ends in."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

CAMERA_PHASES = ("Scanning", "Taking", "Measuring")
"""Beginnings of the names of phases that wait for exposures."""


@dataclass(frozen=True)
class TraceLimits:
    """By what a phase is said to be limited."""

    min_busy: float = 0.7  # processor time over time, from which it computes (chosen)
    min_rate: float = 30e6  # bytes per second of waiting, from which it waits for a disk (chosen)
    min_free: float = 0.05  # share of the memory that is free, below which that is short (chosen)


LIMITS = TraceLimits()


@dataclass(frozen=True)
class Usage:
    """What a process has used so far, or in a phase."""

    seconds: float
    cpu_s: float
    read: int  # bytes
    written: int  # bytes

    @classmethod
    def now(cls) -> Usage:
        import psutil

        process = psutil.Process()
        io: Any = process.io_counters() if hasattr(process, "io_counters") else None  # which macOS lacks
        read = getattr(io, "read_chars", getattr(io, "read_bytes", 0))
        written = getattr(io, "write_chars", getattr(io, "write_bytes", 0))
        return cls(time.perf_counter(), time.process_time(), read, written)

    def since(self, before: Usage) -> Usage:
        return Usage(
            self.seconds - before.seconds,
            self.cpu_s - before.cpu_s,
            self.read - before.read,
            self.written - before.written,
        )


class Trace:
    """Phases of a command, as they end."""

    def __init__(self) -> None:
        self.enabled = False
        self._phases: list[tuple[str, Usage, bool]] = []

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        if not self.enabled:
            yield
            return
        before = Usage.now()
        try:
            yield
        finally:
            self._phases.append((name, Usage.now().since(before), _is_memory_short()))

    def rows(self) -> list[list[object]]:
        """Give name, seconds, processor time, megabytes read and written, and limit of each phase."""
        total = Usage.now()
        start = Usage(total.seconds - _age_s(), 0.0, 0, 0)
        parts = [*self._phases, ("all phases", total.since(start), _is_memory_short())]
        return [
            [name, used.seconds, used.cpu_s, used.read / 1e6, used.written / 1e6, limit_of(name, used, short)]
            for name, used, short in parts
        ]


def limit_of(name: str, used: Usage, memory_is_short: bool) -> str:
    """Say what a phase waited for."""
    waited_s = used.seconds - used.cpu_s
    if memory_is_short:
        return "memory"
    if used.cpu_s >= LIMITS.min_busy * used.seconds:
        return "computing"
    if name.startswith(CAMERA_PHASES):
        return "camera"
    return "disk" if used.read + used.written >= LIMITS.min_rate * waited_s else "other processes"


def _is_memory_short() -> bool:
    import psutil

    memory = psutil.virtual_memory()
    return bool(memory.available < LIMITS.min_free * memory.total)


def _age_s() -> float:
    import psutil

    return time.time() - psutil.Process().create_time()


TRACE = Trace()
COLUMNS = ("phase", "s", "processor s", "MB read", "MB written", "limit")
