"""Pictures from before, as long as there is room."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar


class Sized(Protocol):
    """Whatever knows its size in bytes."""

    @property
    def nbytes(self) -> int: ...


T = TypeVar("T", bound=Sized)


class ByteLimitedCache(Generic[T]):
    """Results by key; when they are more than `limit` bytes the longest unused go."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._results: OrderedDict[object, T] = OrderedDict()

    def get(self, key: object, make: Callable[[], T]) -> T:
        """The result of that key, made if it is not there."""
        if key not in self._results:
            self._results[key] = make()
        self._results.move_to_end(key)
        while len(self._results) > 1 and sum(r.nbytes for r in self._results.values()) > self._limit:
            self._results.popitem(last=False)
        return self._results[key]

    def put(self, key: object, result: T) -> T:
        """Keep a result that was made elsewhere."""
        return self.get(key, lambda: result)

    def __contains__(self, key: object) -> bool:
        return key in self._results

    def take(self, other: ByteLimitedCache[T]) -> None:
        """Share all that another keeps."""
        self._results.update(other._results)

    def clear(self) -> None:
        """Let go of all."""
        self._results.clear()
