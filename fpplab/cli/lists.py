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
        """Parse the words of the command.

        Parameters
        ----------
        ctx : click.Context
            Of the command line.
        args : list of str
            The words behind the command.

        Returns
        -------
        list of str
            What is left over.
        """
        return super().parse_args(ctx, spread(args))


def spread(words: Sequence[str]) -> list[str]:
    """Repeat an option before each of its paths: `--spheres A B` becomes `--spheres A --spheres B`.

    Parameters
    ----------
    words : sequence of str
        The words behind the command.

    Returns
    -------
    list of str
        The same with every option of `LISTS` repeated.

    Raises
    ------
    ConfigError
        No path follows such an option.
    """
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
