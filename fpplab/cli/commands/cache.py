"""`fpplab cache`: what is kept outside of the user's results to save time, and can be computed again."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from fpplab.cli import console
from fpplab.cli.app import Commands, Json, app
from fpplab.core.system import cache_directory
from fpplab.core.units import readable_bytes

if TYPE_CHECKING:
    from fpplab.core.cache import CachedFolder

HELP = """Show the cache and its size; `fpplab cache clear` deletes it.

Rendered light of simulated scenes, up to 2 GiB, is kept in the user's cache folder ($XDG_CACHE_HOME/fpplab,
otherwise ~/.cache/fpplab), so that the next scan of a scene does not render it again. Code compiled by numba
is stored next to the sources, in `__pycache__`, and is not included here."""

cache_app = typer.Typer(cls=Commands, help=HELP)
app.add_typer(cache_app, name="cache", rich_help_panel="system")


@cache_app.callback(invoke_without_command=True)
def _cache(context: typer.Context, json: Json = False) -> None:
    """Show what is kept, unless it is to be cleared."""
    from fpplab.core.cache import cached_folders

    context.obj = json
    if context.invoked_subcommand is None:
        _print_folders(cached_folders(), "Kept", json)


@cache_app.command("clear")
def clear_command(context: typer.Context, json: Json = False) -> None:
    """Delete the whole cache. Measurement results are not part of it.

    The next scan of a simulated scene renders it again, which takes seconds to minutes.
    """
    from fpplab.core.cache import clear_cache

    _print_folders(clear_cache(), "Deleted", json or bool(context.obj))


def _print_folders(folders: list[CachedFolder], title: str, json: bool) -> None:
    directory = cache_directory()
    rows = [asdict(folder) for folder in folders]
    answer = {"directory": directory, "bytes": sum(folder.bytes for folder in folders), "folders": rows}

    def show() -> None:
        if not folders:
            console.stdout.print(f"{directory}: nothing is kept")
        for folder in folders:
            size = f"{readable_bytes(folder.bytes)} in {folder.files} files"
            console.stdout.print(f"{title}: {folder.path}: {size}, {folder.holds}")

    console.print_result(answer, json, show)
