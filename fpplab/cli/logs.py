"""What the program logs of its work: `--verbose` shows it on stderr, `--log FILE` writes it to a file."""

import logging
from collections.abc import Sequence
from pathlib import Path

from fpplab.cli import console
from fpplab.core.files import writing
from fpplab.core.host import host_facts
from fpplab.core.logs import LOGGERS
from fpplab.core.version import __version__

_log = logging.getLogger(__name__)
_installed: list[logging.Handler] = []


class StderrHandler(logging.Handler):
    """Prints records on stderr above a progress bar, if there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        console.log_status(f"{self._time(record)}{record.getMessage()}")

    def _time(self, record: logging.LogRecord) -> str:
        """Seconds since the start, but for warnings, which look as without `--verbose`."""
        return "" if record.levelno >= logging.WARNING else f"{record.relativeCreated / 1e3:8.3f} s  "


def start_logging(verbose: bool, file: Path | None, arguments: Sequence[str]) -> None:
    """Write what the packages log, as the options say; without options everything stays as Python has it."""
    stop_logging()
    if not (verbose or file):
        return
    # With a handler of ours Python no longer prints warnings itself: they go to stderr in any case.
    shown = StderrHandler(logging.INFO if verbose else logging.WARNING)
    _installed.append(shown)
    if file:
        with writing(file):
            written = logging.FileHandler(file, encoding="utf-8")
        written.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        _installed.append(written)
    for name in LOGGERS:
        logging.getLogger(name).setLevel(logging.DEBUG if file else logging.INFO)
        for handler in _installed:
            logging.getLogger(name).addHandler(handler)
    _log.info("fpplab %s: %s", __version__, " ".join(arguments))
    _log.debug("%s", host_facts())


def stop_logging() -> None:
    for handler in _installed:
        for name in LOGGERS:
            logging.getLogger(name).removeHandler(handler)
        handler.close()
    for name in LOGGERS:
        logging.getLogger(name).setLevel(logging.NOTSET)
    _installed.clear()
