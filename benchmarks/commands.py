"""Every command: processor time and modules until its own work begins.

A command that needs input is given files that do not exist, and has begun when it refuses them; another one
when its function is called. The baseline of the seconds is what is wanted, that of the modules is
`fpplab --help`.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any

import typer

from benchmarks import Result, below
from fpplab.cli.every import app

HELP_S, START_S = 0.3, 0.6
MAX_S = 60.0  # after which a command that ought to refuse is ended
ROUNDS = 3
MISSING = "missing.yaml"
PROGRAM = """
import atexit, sys
atexit.register(lambda: print("\\nmodules", len(sys.modules), file=sys.stderr))
if sys.argv.pop(1) == "entered":
    import typer.core
    typer.core.TyperCommand.invoke = lambda *_: sys.exit(0)
from fpplab.__main__ import main
main()
"""


def run() -> list[Result]:
    """Start every command three times; four minutes."""
    help_s, help_modules = measure_start("refused", ["--help"])
    results = [below("--help", help_s, "s", HELP_S)]
    for words, needs_input in every_command(typer.main.get_command(app), []):
        seconds, modules = measure_start("refused" if needs_input else "entered", words)
        name = " ".join(words[: words.index(MISSING)] if MISSING in words else words).partition(" --")[0]
        results.append(below(name, seconds, "s", START_S))
        results.append(Result(name, modules, "modules", help_modules, help_modules / modules))
    return results


def every_command(command: Any, before: list[str]) -> Iterator[tuple[list[str], bool]]:
    """List the words that start each command, and whether it is given input that does not exist."""
    if hasattr(command, "commands"):
        for name, each in command.commands.items():
            if not each.hidden:  # a group shows those that are
                yield from every_command(each, [*before, name])
        return
    words, needs_input = list(before), False
    for parameter in command.params:
        if not parameter.required:
            continue
        kind = parameter.type_descriptor.annotation
        is_name = kind in (str, Path, list[Path])
        is_output = parameter.name == "out" or words == ["sample"]
        needs_input = needs_input or (is_name and not is_output)
        value = MISSING if is_name else str(next(iter(kind))) if isinstance(kind, type(StrEnum)) else "1"
        option = [parameter.opts[0]] if parameter.param_type_name == "option" else []
        words += [*option, *[value] * max(parameter.nargs, 1)]
    yield words, needs_input


def measure_start(how: str, words: list[str]) -> tuple[float, int]:
    """Give the least processor time of some starts, and how many modules there are then."""
    seconds, modules = float("inf"), 0
    # An installed program has its byte code: the first start leaves it here as well.
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory() as folder:
            before = os.times()
            done = subprocess.run(
                [sys.executable, "-P", "-c", PROGRAM, how, *words],
                cwd=folder,
                env={**environment, "PYTHONPATH": str(Path(__file__).parents[1])},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=MAX_S,
                check=False,
            )
            after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        seconds, modules = min(seconds, spent), int(done.stderr.rpartition("modules")[2])
    return seconds, modules
