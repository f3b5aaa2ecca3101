"""Messages to the process that draws, and the bounded queue in which they wait to be sent."""

import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.viewer.server import ViewerPlace

WAITING = "waiting"
"""Message in place of a method: answer now, and again whenever the operator has closed the view."""

MAX_QUEUED = 32  # messages that may wait (chosen to bound memory)


@dataclass(frozen=True)
class Opening:
    """First message to the process that draws."""

    view: type  # subclass of `CommandView`
    shown: ViewerPlace | None  # where it is shown; None: it is only recorded
    recording: Path | None  # file (.rrd) that is left when the view is closed


@dataclass(frozen=True)
class Message:
    """Something to show."""

    content: Any  # what is sent
    droppable: bool = False  # whether the view is still right without it: one of many images


class Outbox:
    """A queue between threads: when full it drops the oldest (droppable) message or, with `waits`, waits."""

    def __init__(self, max_queued: int = MAX_QUEUED, waits: bool = False) -> None:
        self.dropped = 0
        self._max_queued, self._waits = max_queued, waits
        self._queue: deque[Message] = deque()
        self._changed = threading.Condition()
        self._ended = False

    def add(self, message: Message) -> None:
        with self._changed:
            if self._waits:
                self._changed.wait_for(lambda: self._ended or len(self._queue) < self._max_queued)
            if self._ended:
                return
            if len(self._queue) >= self._max_queued:
                victim = next((queued for queued in self._queue if queued.droppable), self._queue[0])
                self._queue.remove(victim)
                self.dropped += 1
            self._queue.append(message)
            self._changed.notify_all()

    def take(self) -> Message | None:
        """Take the oldest message, waiting for one; None after the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._queue or self._ended)
            message = self._queue.popleft() if self._queue else None
            self._changed.notify_all()
            return message

    def end(self, discard: bool = False) -> None:
        with self._changed:
            self._ended = True
            if discard:
                self._queue.clear()
            self._changed.notify_all()
