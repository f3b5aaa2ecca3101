"""Options of commands, and the names that a shell completes: shipped configurations, and files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

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


def option(flags: str, help_text: str, **more: Any) -> Any:
    return typer.Option(*flags.split(), help=help_text, **more)


def config_option(kind: ConfigKind, help_text: str, flag: str = "") -> Any:
    """Make an option, by default of the kind's own name, that takes a configuration of this kind."""
    return option(flag or f"--{kind}", help_text, autocompletion=names_of(kind))
