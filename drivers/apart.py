"""Questions to a library in a process of its own, where it can neither crash nor block this one."""

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any


def ask_apart(answer: Callable[..., None], *arguments: Any, timeout_s: float) -> Any:
    """Have a function answer in a process of its own; None where it crashes or takes too long."""
    context = multiprocessing.get_context("spawn")  # libraries and threads do not survive a fork
    mine, theirs = context.Pipe(duplex=False)
    process = context.Process(target=answer, args=(theirs, *arguments), name=answer.__name__, daemon=True)
    with main_left_out():
        process.start()
    theirs.close()
    try:
        return mine.recv() if mine.poll(timeout_s) else None
    except EOFError:
        return None
    finally:
        mine.close()
        process.join(5.0)
        if process.is_alive():
            process.kill()
            process.join()
        process.close()


@contextmanager
def main_left_out() -> Iterator[None]:
    """Start processes that do not run the user's script again, which need not ask for its own name."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


@contextmanager
def native_stderr_silenced() -> Iterator[None]:
    """Keep what libraries print off the terminal; what Python writes to `sys.stderr` still appears."""
    sys.stderr.flush()
    descriptor, stream = os.dup(2), sys.stderr
    with os.fdopen(descriptor, "w", buffering=1) as terminal, open(os.devnull, "w") as null:
        os.dup2(null.fileno(), 2)
        sys.stderr = terminal
        try:
            yield
        finally:
            sys.stderr = stream
            os.dup2(descriptor, 2)
