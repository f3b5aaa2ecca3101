"""Options that are followed by any number of paths: `--spheres A B C`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from typer.core import TyperCommand

from fpplab.core.errors import ConfigError

LISTS = ("--spheres", "--planes", "--reference", "--scan")


class TakesLists(TyperCommand):
    """Lets the options of `LISTS` be followed by any number of paths."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, spread(args))


def spread(words: Sequence[str]) -> list[str]:
    """`--spheres A B` as `--spheres A --spheres B`."""
    plain: list[str] = []
    current, followed = "", True
    for word in [*words, "-"]:
        if current and not word.startswith("-"):
            plain += [current, word]
            followed = True
        elif not followed:
            raise ConfigError(f"{current} is followed by no path; name the clouds or sessions")
        elif word in LISTS:
            current, followed = word, False
        else:
            plain.append(word)
            current = ""
    return plain[:-1]
