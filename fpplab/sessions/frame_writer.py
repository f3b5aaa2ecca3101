"""Frames go to disk while the next ones are taken."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

from fpplab.devices import Frame
from fpplab.sessions.limits import SESSION_LIMITS as LIMITS
from fpplab.sessions.session import Session


@contextmanager
def write_frames(session: Session, observe: Callable[[Frame], None]) -> Iterator[Callable[[Frame], None]]:
    # Frames are written one by one, in the order in which they are given, and none after one that could not
    # be. The caller's thread shows each to `observe` once it is on disk. What was given is written also when
    # the block ends by an exception. What `Session.write` raises is raised by the function or at the end of
    # the block.
    waiting: deque[tuple[Frame, Future[None]]] = deque()

    def settle() -> None:
        frame, written = waiting[0]
        written.result()
        waiting.popleft()
        observe(frame)

    def record(frame: Frame) -> None:
        before = waiting[-1][1] if waiting else None
        waiting.append((frame, writer.submit(_write_after, before, session, frame)))
        while waiting and (len(waiting) > LIMITS.max_waiting_frames or waiting[0][1].done()):
            settle()

    with ThreadPoolExecutor(max_workers=1) as writer:
        try:
            yield record
            while waiting:
                settle()
        finally:
            for _, written in waiting:
                written.result()


def _write_after(before: Future[None] | None, session: Session, frame: Frame) -> None:
    """Write a frame, unless the one before it failed: then fail with the same error."""
    if before is not None:
        before.result()
    session.write(frame)
