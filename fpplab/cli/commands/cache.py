"""`fpplab cache`: what is kept to save time."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import TWIN, Commands, Json, app
from fpplab.core.system import cache_directory
from fpplab.core.units import readable_bytes

if TYPE_CHECKING:
    from fpplab.core.caches import CacheFolder

HELP = """Show the cache and its size; `fpplab cache clear` deletes it.

Rendered light of simulated scenes, up to 2 GiB, is kept in the user's cache folder ($XDG_CACHE_HOME/fpplab,
otherwise ~/.cache/fpplab), so that the next scan of a scene does not render it again. Code compiled by numba
is stored next to the sources, in `__pycache__`, and is not included here."""

cache_app = typer.Typer(cls=Commands, help=HELP)
app.add_typer(cache_app, name="cache", rich_help_panel=TWIN)


@cache_app.callback(invoke_without_command=True)
def _cache(context: typer.Context, json: Json = False) -> None:
    """Show what is kept, unless it is to be cleared."""
    context.obj = json
    if context.invoked_subcommand is None:
        from fpplab.core.caches import cache_folders

        folders = cache_folders()
        console.print_result(_summary(folders), json, lambda: _show(folders, "Kept"))


@cache_app.command("clear")
def clear_command(context: typer.Context, json: Json = False) -> None:
    """Delete the whole cache. Measurement results are not part of it.

    The next scan of a simulated scene renders it again, which takes seconds to minutes.
    """
    from fpplab.core.caches import clear_caches

    cleared = clear_caches()
    console.print_result(_summary(cleared), json or bool(context.obj), lambda: _show(cleared, "Deleted"))


def _summary(folders: list[CacheFolder]) -> dict[str, Any]:

    return {
        "directory": cache_directory(),
        "bytes": sum(folder.bytes for folder in folders),
        "folders": [asdict(folder) for folder in folders],
    }


def _show(folders: list[CacheFolder], title: str) -> None:

    if not folders:
        console.stdout.print(f"{cache_directory()}: nothing is kept")
    for folder in folders:
        console.stdout.print(
            f"{title}: {folder.path}: {readable_bytes(folder.bytes)} in {folder.files} files, {folder.holds}"
        )
