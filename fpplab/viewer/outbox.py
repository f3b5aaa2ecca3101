"""Messages that wait to be sent: as many as memory should hold, so that who adds one never waits."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

MOST_WAITING = 32
"""Messages that may wait; each image of them has at most `SHOWN_COLUMNS` columns."""


@dataclass(frozen=True)
class Message:
    """Something to show."""

    content: Any  # what is sent
    droppable: bool = False  # whether the view is still right without it: one of many images


class Outbox:
    """A queue between one thread that adds and one that takes.

    Where it is full, the oldest droppable message gives way, or else the oldest.
    """

    def __init__(self, most: int = MOST_WAITING, waits: bool = False) -> None:
        self.dropped = 0
        self._most, self._waits = most, waits
        self._waiting: deque[Message] = deque()
        self._changed = threading.Condition()
        self._ended = False

    def add(self, message: Message) -> None:
        """Add a message; after the end it is ignored."""
        with self._changed:
            if self._waits:
                self._changed.wait_for(lambda: self._ended or len(self._waiting) < self._most)
            if self._ended:
                return
            if len(self._waiting) >= self._most:
                victim = next((one for one in self._waiting if one.droppable), self._waiting[0])
                self._waiting.remove(victim)
                self.dropped += 1
            self._waiting.append(message)
            self._changed.notify_all()

    def take(self) -> Message | None:
        """Take the oldest message, and wait for one."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._ended)
            message = self._waiting.popleft() if self._waiting else None
            self._changed.notify_all()
            return message

    def end(self, discard: bool = False) -> None:
        """Say that no more messages will come."""
        with self._changed:
            self._ended = True
            if discard:
                self._waiting.clear()
            self._changed.notify_all()
