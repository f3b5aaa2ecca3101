"""What every command does alike: progress on stderr, results on stdout, faults in one sentence."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from fpplab.errors import FppError

Report = Callable[[float], None]
"""Told how much of a piece of work is done, 0 … 1."""

stderr = Console(stderr=True, highlight=False)
stdout = Console(highlight=False, soft_wrap=True)


@contextmanager
def progress(what: str) -> Iterator[Report]:
    """A progress bar on stderr while the work lasts; gone when it is done."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=stderr, transient=True) as bars:
        task = bars.add_task(what, total=1.0)
        yield lambda share: bars.update(task, completed=share)


def say(sentence: str) -> None:
    """One line to the operator, on stderr, so that stdout stays a result."""
    stderr.print(sentence, soft_wrap=True, markup=False)


def answer(result: dict[str, Any], as_json: bool, words: Callable[[], None] | None = None) -> None:
    """The command's result: exactly one JSON object, or words for a person."""
    if as_json:
        sys.stdout.write(json.dumps(result, default=_plain, allow_nan=False) + "\n")
    elif words:
        words()
    else:
        for key, value in result.items():
            stdout.print(f"{key}: {_readable(value)}", markup=False)


def table(title: str, columns: list[str], rows: list[list[Any]]) -> None:
    """A table on stdout."""
    grid = Table(title=title, title_justify="left")
    for i, column in enumerate(columns):
        grid.add_column(column, justify="left" if i == 0 else "right")
    for row in rows:
        grid.add_row(*(_readable(cell) for cell in row))
    stdout.print(grid)


def _readable(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_readable(v)}" for k, v in value.items())
    if isinstance(value, list):
        return ", ".join(_readable(v) for v in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"{type(value).__name__} does not go into JSON")


@contextmanager
def stopwatch() -> Iterator[Callable[[], float]]:
    """Gives a function that tells the seconds since the beginning."""
    start = time.perf_counter()
    yield lambda: round(time.perf_counter() - start, 3)


def run(command: Callable[[], object], as_json: bool) -> NoReturn:
    """Run a program's whole command and leave with the exit code of its fault, or 0.

    A foreseeable fault is one sentence on stderr (and `{"error": …}` on stdout with --json);
    SIGTERM is treated like Ctrl-C, so that the bench is left safe.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        command()
    except FppError as error:
        _fail(error, as_json)
    except SystemExit as end:  # wrong usage has been explained on stderr
        if as_json and end.code:
            _answer_fault("wrong usage; see stderr", int(end.code))
        raise
    sys.exit(0)


def _fail(error: FppError, as_json: bool) -> NoReturn:
    say(f"fpplab: {error}")
    if as_json:
        _answer_fault(str(error), error.exit_code)
    sys.exit(error.exit_code)


def _answer_fault(sentence: str, exit_code: int) -> None:
    sys.stdout.write(json.dumps({"error": sentence, "exit_code": exit_code}) + "\n")
