"""Results that several parts of a measurement ask for, computed once for each object."""

from collections.abc import Callable
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

K = TypeVar("K")
V = TypeVar("V")


def remembered(compute: Callable[[K], V]) -> Callable[[K], V]:
    """Keep the result as long as the argument, which must be compared by identity."""
    results: WeakKeyDictionary[K, V] = WeakKeyDictionary()

    @wraps(compute)
    def look_up(of: K) -> V:
        if of not in results:
            results[of] = compute(of)
        return results[of]

    return look_up
