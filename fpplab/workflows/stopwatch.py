"""The time that a workflow takes."""

import time


class Stopwatch:
    """Measures time from the moment it is made."""

    def __init__(self) -> None:
        self._began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Time since then in s, to the millisecond."""
        return round(time.perf_counter() - self._began, 3)
