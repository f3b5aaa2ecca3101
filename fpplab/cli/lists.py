"""Words of the command line that are put in order before they are parsed: lists of paths, global options."""

from collections.abc import Sequence
from typing import Any

from typer.core import TyperCommand

from fpplab.core.errors import ConfigError

LISTS = ("--spheres", "--planes", "--reference", "--scan", "--surface")


class VariadicOptionsCommand(TyperCommand):
    """Lets the options of `LISTS` be followed by any number of paths."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, repeat_option_per_path(args))


def repeat_option_per_path(arguments: Sequence[str]) -> list[str]:
    """Repeat an option before each of its paths: `--spheres A B` becomes `--spheres A --spheres B`."""
    plain: list[str] = []
    current, followed = "", True
    for argument in [*arguments, "-"]:
        if current and not argument.startswith("-"):
            plain += [current, argument]
            followed = True
        elif not followed:
            raise ConfigError(f"{current} is followed by no path; name the clouds or sessions")
        elif argument in LISTS:
            current, followed = argument, False
        else:
            plain.append(argument)
            current = ""
    return plain[:-1]


GLOBAL, GLOBAL_WITH_VALUE = ("--verbose", "-v", "--trace"), ("--log", "--allow", "--allow-backend")


def global_first(arguments: Sequence[str]) -> list[str]:
    """Put the options of the program before its command: `scan -v` becomes `-v scan`."""
    front, rest = split_global(arguments)
    return [*front, *rest]


def split_global(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Give the options of the program, and the command with its own words."""
    front: list[str] = []
    rest: list[str] = []
    remaining = list(arguments)
    while remaining and remaining[0] != "--":
        word = remaining.pop(0)
        if word in GLOBAL or word.startswith(tuple(f"{option}=" for option in GLOBAL_WITH_VALUE)):
            front.append(word)
        elif word in GLOBAL_WITH_VALUE and remaining:
            front += [word, remaining.pop(0)]
        else:
            rest.append(word)
    return front, [*rest, *remaining]
