"""The command line: one function per command, each a few lines over `measurement`.

Heavy modules are imported where they are used, so that `--help` is at once.
"""

import sys
from importlib import import_module

from fpplab.cli import console
from fpplab.cli.app import app

# In the order of --help.
for _commands in (
    "whole",
    "prepare",
    "measure",
    "look",
    "accept",
    "match",
    "optimise",
    "dataset",
    "convert",
    "camera",
    "projector",
    "emulate",
    "speed",
):
    import_module(f"fpplab.cli.{_commands}")


def main() -> None:
    """Entry point: run the command and leave with its exit code."""
    console.run_program(app, as_json="--json" in sys.argv)


__all__ = ["app", "main"]
