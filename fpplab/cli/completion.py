"""Options of commands, the names that a shell completes, and the check that a named file exists.

The check comes before all that a command loads, so that a mistyped name is answered at once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import no_such_file

if TYPE_CHECKING:
    from fpplab.core.config import ConfigKind


def names_of(kind: ConfigKind) -> Callable[[str], list[str]]:
    def complete(incomplete: str) -> list[str]:
        from fpplab.core.config import shipped_configs  # which `--help` does not need

        shipped = [name for name in shipped_configs(kind) if name.startswith(incomplete)]
        before = Path(incomplete)
        folder, start = (before, "") if incomplete.endswith("/") else (before.parent, before.name)
        files = sorted(path for path in folder.glob("*.yaml") if path.name.startswith(start))
        return [*shipped, *(str(path) for path in files)]

    return complete


CHECKS = "fpplab.checks"
"""In a context's `meta`: what is called before the command, once all its words are understood."""


def existing_config(kind: ConfigKind, **short: str) -> Callable[[typer.Context, Any], Any]:
    # `short` gives names of files by shorter ones that the command knows
    def check(name: Any) -> None:
        from fpplab.core.config import find_config

        find_config(short.get(name, name), kind)

    return _checked(check)


def _checked(check: Callable[[Any], None]) -> Callable[[typer.Context, Any], Any]:
    def register(context: typer.Context, named: Any) -> Any:
        given = named if isinstance(named, list | tuple) else [] if named is None else [named]
        context.meta.setdefault(CHECKS, []).extend(partial(check, each) for each in given)
        return named

    return register


def _require(error: type[ConfigError | DataError], path: Path) -> None:
    if not path.exists() and not path.is_symlink():
        raise error(no_such_file(path))


existing_data, existing_file = (_checked(partial(_require, kind)) for kind in (DataError, ConfigError))


def option(flags: str, help_text: str, **more: Any) -> Any:
    return typer.Option(*flags.split(), help=help_text, **more)


def config_option(kind: ConfigKind, help_text: str, flag: str = "") -> Any:
    """Make an option, by default of the kind's own name, that takes a configuration of this kind."""
    return option(
        flag or f"--{kind}", help_text, autocompletion=names_of(kind), callback=existing_config(kind)
    )
