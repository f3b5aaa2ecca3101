"""The command line: every file of `fpplab.cli.commands` is a command; drivers and twin bring their own.

Only the command that is named is loaded, and heavy modules are imported where they are used.
"""

import sys
from functools import partial
from importlib import import_module
from importlib.util import find_spec

from fpplab.cli import console
from fpplab.cli.app import GROUPS, app, leave_out_parameters
from fpplab.cli.lists import split_global


def main() -> None:
    """Run the command that `sys.argv` names and leave with its exit code."""
    console.run_program(partial(_run, sys.argv[1:]), as_json="--json" in sys.argv)


def _run(arguments: list[str]) -> None:
    command = next(iter(split_global(arguments)[1]), "")
    name = "" if command in GROUPS else command.replace("-", "_")  # whose group holds those of other files
    modules = [f"{__name__}.commands.{each}" for each in (name, f"{name}_") if each.isidentifier()]
    import_module(next((each for each in modules if find_spec(each)), f"{__name__}.every"))
    if command in ("--help", "-h"):
        leave_out_parameters()
    app(prog_name="fpplab")


__all__ = ["main"]
