"""A least-recently-used cache in memory, limited in bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar


class Sized(Protocol):
    """Whatever knows its size in bytes."""

    @property
    def nbytes(self) -> int:
        """Size in bytes."""


T = TypeVar("T", bound=Sized)  # type of the results that a cache keeps


class ByteLimitedCache(Generic[T]):
    """Results by key; when they exceed a limit the least recently used are dropped.

    The usual limit is 512 MiB (chosen).
    """

    def __init__(self, limit_bytes: int = 1 << 29) -> None:
        self._limit_bytes = limit_bytes
        self._results: OrderedDict[object, T] = OrderedDict()

    def get(self, key: object, make: Callable[[], T]) -> T:
        if key not in self._results:
            self._results[key] = make()
        self._results.move_to_end(key)
        while len(self._results) > 1 and sum(r.nbytes for r in self._results.values()) > self._limit_bytes:
            self._results.popitem(last=False)
        return self._results[key]

    def put(self, key: object, result: T) -> T:
        """Keep a result that was made elsewhere, unless there is one of that key."""
        return self.get(key, lambda: result)

    def __contains__(self, key: object) -> bool:
        return key in self._results

    def take(self, other: ByteLimitedCache[T]) -> None:
        """Add all results of another cache, which keeps them too."""
        self._results.update(other._results)

    def clear(self) -> None:
        self._results.clear()
