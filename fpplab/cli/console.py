"""What all commands share: progress on stderr, results on stdout, faults in one sentence."""

from __future__ import annotations

import errno
import json
import logging
import os
import re
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, NoReturn

from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment

from fpplab.cli.trace import COLUMNS, TRACE
from fpplab.core import interrupts
from fpplab.core.errors import Cancelled, ConfigError, DataError, FppError
from fpplab.core.extras import missing_extra
from fpplab.core.progress import Progress, Say, ignore, no_progress
from fpplab.core.strict_json import json_value

if TYPE_CHECKING:
    from fpplab.diagnosis import Diagnosis


NOT_PRINTED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff]")
"""Characters that a terminal obeys instead of showing them, or that turn the order of others around."""


def printable(text: str) -> str:
    """Write out the characters that a terminal would obey, as Python does in strings."""
    return NOT_PRINTED.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def readable(value: Any) -> str:
    if isinstance(value, dict) and value:
        return ", ".join(f"{k} {readable(v)}" for k, v in value.items())
    if isinstance(value, list | tuple) and value:
        return ", ".join(readable(v) for v in value)
    if value is None or (isinstance(value, dict | list | tuple) and not value):
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def as_table(value: Any) -> tuple[list[str], list[list[Any]]] | None:
    if isinstance(value, dict) and value and all(isinstance(row, dict) for row in value.values()):
        rows = [{"": name, **_flatten_row(row)} for name, row in value.items()]
    elif isinstance(value, list | tuple) and value and all(isinstance(row, dict) for row in value):
        rows = [_flatten_row(row) for row in value]
    else:
        return None
    columns = list(dict.fromkeys(key for row in rows for key in row))
    return columns, [[row.get(column, "") for column in columns] for row in rows]


def _flatten_row(row: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in row.items():
        inner = {f"{key} {k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
        flat |= inner
    return flat


class _Reporting(Console):
    """A spinner or bar, for as long as it is shown."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render what is printed, with characters that would not be seen written out."""
        for segment in super().render(renderable, options):
            is_text = not segment.control and NOT_PRINTED.search(segment.text)
            yield Segment(printable(segment.text), segment.style) if is_text else segment

    def on_broken_pipe(self) -> None:
        raise  # noqa: PLE0704 - called where BrokenPipeError is handled


stderr = _Reporting(stderr=True, highlight=False, markup=False)
stdout = _Reporting(highlight=False, soft_wrap=True, markup=False)

_log = logging.getLogger(__name__)


@contextmanager
def progress(description: str) -> Iterator[Progress]:
    start = time.perf_counter()
    try:
        with TRACE.phase(description), telling_progress(description) as (report, _):
            yield report
    finally:
        seconds = time.perf_counter() - start
        _log.info("%s: %.3f s", description, seconds, extra={"phase": description, "seconds": seconds})


@contextmanager
def telling_progress(description: str) -> Iterator[tuple[Progress, Say]]:
    """Show a progress bar, or one line, whose message changes with what is done."""
    if not stderr.is_terminal:
        log_status(f"{description} …")
        yield no_progress, ignore
        return
    # Most commands end without, and `--help` does.
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as ProgressBars

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with ProgressBars(*columns, console=stderr, transient=True) as bars:
        task = bars.add_task(description, total=1.0)
        yield (
            lambda share: bars.update(task, completed=share),
            lambda message: bars.update(task, description=escape(f"{description}: {message}")),
        )


def log_status(sentence: str) -> None:
    with suppress(OSError):  # stderr may be closed: no reason to stop the work
        stderr.print(sentence, soft_wrap=True)


def log_verdict(sentence: str) -> None:
    if not stdout.is_terminal:  # where the result itself shows it
        log_status(sentence)


def print_result(result: dict[str, Any], as_json: bool, show: Callable[[], None] | None = None) -> None:
    if as_json:
        sys.stdout.write(json.dumps(result, default=json_value, allow_nan=False) + "\n")
    elif show:
        show()
    else:
        for key, value in result.items():
            if key == "provenance":  # the report shows it as a table
                continue
            laid_out = as_table(value)
            if laid_out:
                table(key, *laid_out)
            else:
                stdout.print(f"{key}: {readable(value)}")


def print_verdict_and_result(
    diagnosis: Diagnosis, name: str, result: dict[str, Any], as_json: bool, show: Callable[[], None]
) -> None:
    log_status(diagnosis.sentence)
    for finding in diagnosis.findings:
        is_reason = finding.sentence == diagnosis.reason  # which the first line has said
        log_status(f"  {finding.remedy}" if is_reason else f"  {finding.sentence}; {finding.remedy}")
    if not (as_json and diagnosis.is_useless):
        print_result(result, as_json, show)
    diagnosis.require_usable(name, result)


def print_trace() -> None:
    if TRACE.enabled:
        table("Where the time went", [*COLUMNS], TRACE.rows(), stderr)


def table(title: str, columns: list[str], rows: list[list[Any]], console: Console = stdout) -> None:
    from rich.table import Table

    grid = Table(title=title, title_justify="left")
    for i, column in enumerate(columns):
        grid.add_column(column, justify="left" if i == 0 else "right")
    for row in rows:
        grid.add_row(*(readable(cell) for cell in row))
    console.print(grid)


@contextmanager
def stopwatch() -> Iterator[Callable[[], float]]:
    start = time.perf_counter()
    yield lambda: round(time.perf_counter() - start, 3)


class CommandExit(SystemExit):
    """Ends a command that has given its whole answer, with an exit code that is part of it."""


def run_program(command: Callable[[], object], as_json: bool) -> NoReturn:
    # A foreseeable fault is one sentence on stderr (and `{"error": …}` on stdout with --json); SIGTERM is
    # treated like Ctrl-C, so that the bench is left safe.
    interrupts.watch_signals()
    try:
        _check_arguments(sys.argv[1:])
        command()
        sys.stdout.flush()
    except BaseException as error:  # noqa: BLE001 - each kind has its own answer
        waits = interrupts.end_on_next_signal() and not _is_answered(error)
        if waits or (
            interrupts.is_caused_by(error, KeyboardInterrupt) and not isinstance(error, CommandExit)
        ):
            error = Cancelled("cancelled")
        elif isinstance(error, SystemExit) and interrupts.is_caused_by(error, BrokenPipeError):
            error = BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))  # typer ends with code 1
        _end_with(error, as_json)
    interrupts.end_on_next_signal()
    sys.exit(0)


def _is_answered(error: BaseException) -> bool:
    return isinstance(error, CommandExit) or (isinstance(error, SystemExit) and not error.code)


def _check_arguments(arguments: Sequence[str]) -> None:
    """Refuse names that are no text: nothing could print them, or write them into a record."""
    for argument in arguments:
        shown = argument.encode("utf-8", "replace").decode("utf-8")
        if shown != argument:
            raise ConfigError(f"{shown}: is not text in UTF-8; rename the file")
        if NOT_PRINTED.search(argument):
            raise ConfigError(f"{shown}: holds characters that cannot be seen; rename the file")


def _end_with(error: BaseException, as_json: bool) -> NoReturn:
    match error:
        case FppError():
            _log.debug("refused with exit code %d", error.exit_code, exc_info=error)
            _fail(str(error), error.exit_code, as_json, error.details)
        case SystemExit():  # wrong usage has been explained on stderr
            if as_json and error.code and not isinstance(error, CommandExit):
                _answer_fault("wrong usage; see stderr", int(error.code))
            _exit_process(error.code if isinstance(error.code, int) else int(bool(error.code)))
        case ModuleNotFoundError() if missing := missing_extra(error):
            _log.debug("an extra is missing", exc_info=error)
            _fail(str(missing), missing.exit_code, as_json)
        case MemoryError():
            _log.debug("refused for want of memory", exc_info=error)
            _fail(f"there is not enough memory for this ({error})", DataError.exit_code, as_json)
        case OSError(errno=errno.ENAMETOOLONG | errno.ENOTDIR | errno.ELOOP):
            _log.debug("refused by the system", exc_info=error)
            _fail(f"{_short(error)}: {error.strerror}; name another file", ConfigError.exit_code, as_json)
        case OSError(filename=None, errno=errno.ENOSPC | errno.EPIPE | errno.EIO):
            reason = error.strerror
            _fail(f"the answer could not be written to stdout ({reason})", DataError.exit_code, as_json)
        case _:  # a fault of ours is still one sentence, and one JSON object
            _log.debug("a fault of fpplab itself", exc_info=error)
            if os.environ.get(TRACEBACK):
                traceback.print_exception(error)
            sentence = f"a fault of fpplab itself: {type(error).__name__}: {error}"
            _fail(f"{sentence}; set {TRACEBACK}=1 to see where, and report it", 1, as_json)


def _short(error: OSError, max_characters: int = 100) -> str:
    name = str(error.filename)
    return name if len(name) <= max_characters else f"{name[:max_characters]}…"


TRACEBACK = "FPPLAB_TRACEBACK"
"""The environment variable that has unforeseen faults shown with their traceback."""


def _fail(
    sentence: str, exit_code: int, as_json: bool, details: Mapping[str, object] | None = None
) -> NoReturn:
    log_status(f"fpplab: {sentence}")
    if as_json:
        _answer_fault(sentence, exit_code, details)
    _exit_process(exit_code)


def _exit_process(exit_code: int) -> NoReturn:
    """End the process, also where stdout takes nothing any more."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        exit_code = exit_code or DataError.exit_code
    if exit_code == Cancelled.exit_code:
        # Everything is closed by now. What an interruption has torn out of native code is not
        # taken down piece by piece as well: that has crashed.
        with suppress(OSError):
            sys.stderr.flush()
        os._exit(exit_code)
    sys.exit(exit_code)


def _answer_fault(sentence: str, exit_code: int, details: Mapping[str, object] | None = None) -> None:
    fault = {"error": sentence, "exit_code": exit_code, **(details or {})}
    with suppress(OSError):  # what cannot be written is in the exit code
        sys.stdout.write(json.dumps(fault, default=json_value) + "\n")
