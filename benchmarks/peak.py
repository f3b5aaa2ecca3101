"""The peak of what rises and falls while something runs."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def peak_of(sample: Callable[[], int], every_s: float) -> Iterator[list[int]]:
    """Take the greatest that a figure comes to while the block runs.

    It is taken before the block, regularly by a thread of its own, and after the block.
    """
    peak, done = [sample()], threading.Event()

    def watch() -> None:
        while not done.wait(every_s):
            peak[0] = max(peak[0], sample())

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield peak
    finally:
        done.set()
        watcher.join()
        peak[0] = max(peak[0], sample())
