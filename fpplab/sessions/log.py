"""The log of a session, for people and bug reports: JSON lines, left out where they cannot be written."""

import json
import logging
import os
import sys
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from fpplab.core.errors import DataError
from fpplab.core.host import host_facts
from fpplab.core.journals import cut_torn_line
from fpplab.core.logs import LOGGERS
from fpplab.core.session_names import LOG

BINARY = getattr(os, "O_BINARY", 0)  # without it, Windows would write newlines as two bytes
FIELDS = ("phase", "seconds", "device", "sent")  # what records may hold besides their message


class SessionLog(logging.Handler):
    """Appends records to the log of a session."""

    def __init__(self, folder: Path) -> None:
        super().__init__(logging.INFO)
        self._file = folder / LOG
        self._levels = {name: logging.getLogger(name).level for name in LOGGERS}
        with suppress(OSError, DataError):
            self._file.touch()
            cut_torn_line(self._file)
        self.append(event="begin", command=["fpplab", *sys.argv[1:]], pid=os.getpid(), **host_facts())
        for name in LOGGERS:
            logger = logging.getLogger(name)
            logger.addHandler(self)
            if not 0 < logger.level < logging.INFO:
                logger.setLevel(logging.INFO)

    def append(self, **fields: Any) -> None:
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        with suppress(OSError):  # a full disk, or a session that was removed, stops no measurement here
            handle = os.open(self._file, os.O_WRONLY | os.O_APPEND | BINARY)
            try:
                os.write(handle, json.dumps({"time": now, **fields}).encode() + b"\n")
            finally:
                os.close(handle)

    def emit(self, record: logging.LogRecord) -> None:
        more = {name: getattr(record, name) for name in FIELDS if hasattr(record, name)}
        self.append(level=record.levelname.lower(), logger=record.name, message=record.getMessage(), **more)
        if record.levelno >= logging.WARNING and logging.lastResort and not _is_heard_elsewhere(record.name):
            logging.lastResort.handle(record)  # as without this log

    def end(self, error: BaseException | None) -> None:
        for name, level in self._levels.items():
            logging.getLogger(name).removeHandler(self)
            logging.getLogger(name).setLevel(level)
        fault = {} if error is None else {"error": f"{type(error).__name__}: {error}"}
        self.append(event="end", **fault)


_open: dict[Path, SessionLog] = {}


def begin_session_log(path: Path) -> None:
    """Log into a session from now on, until the process no longer is its writer."""
    place = path.resolve()
    if place not in _open:
        _open[place] = SessionLog(path)


def end_session_log(
    place: Path, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
) -> None:
    """End the log of a session, if there is one: an exit callback."""
    log = _open.pop(place, None)
    if log is not None:
        log.end(error)


def _is_heard_elsewhere(name: str) -> bool:
    logger: logging.Logger | None = logging.getLogger(name)
    while logger is not None:
        if any(not isinstance(handler, SessionLog) for handler in logger.handlers):
            return True
        logger = logger.parent if logger.propagate else None
    return False
