"""`fpplab cache`: what is kept outside of the user's results to save time, and can be computed again."""

import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import typer

from fpplab.cli import console
from fpplab.cli.app import Commands, Json, app
from fpplab.core.disk_space import disk_bytes
from fpplab.core.files import writing
from fpplab.core.system import cache_directory
from fpplab.core.units import readable_bytes

CONTENTS = {"light": "rendered light of simulated scenes; the next scan of a scene renders it again"}
HELP = """Show the cache and its size; `fpplab cache clear` deletes it.

Rendered light of simulated scenes, up to 2 GiB, is kept in the user's cache folder ($XDG_CACHE_HOME/fpplab,
otherwise ~/.cache/fpplab), so that the next scan of a scene does not render it again. Code compiled by numba
is stored next to the sources, in `__pycache__`, and is not included here."""

cache_app = typer.Typer(cls=Commands, help=HELP)
app.add_typer(cache_app, name="cache", rich_help_panel="system")


@cache_app.callback(invoke_without_command=True)
def _cache(context: typer.Context, json: Json = False) -> None:
    """Show what is kept, unless it is to be cleared."""
    context.obj = json
    if context.invoked_subcommand is None:
        _print_folders(_described_folders(), "Kept", json)


@cache_app.command("clear")
def clear_command(context: typer.Context, json: Json = False) -> None:
    """Delete the whole cache. Measurement results are not part of it.

    The next scan of a simulated scene renders it again, which takes seconds to minutes.
    """
    cleared = _described_folders()
    for folder in cleared:
        with writing(folder["path"]), suppress(FileNotFoundError):  # another process clears it too
            shutil.rmtree(folder["path"])
    _print_folders(cleared, "Deleted", json or bool(context.obj))


def _described_folders() -> list[dict[str, Any]]:
    directory = cache_directory()
    inside = sorted(directory.iterdir()) if directory.is_dir() else []
    # A link may lead to anything.
    return [_described(path) for path in inside if path.is_dir() and not path.is_symlink()]


def _described(path: Path) -> dict[str, Any]:
    files = [file for file in path.rglob("*") if file.is_file()]
    holds = CONTENTS.get(path.name, "unknown to this version")
    return {"path": path, "holds": holds, "files": len(files), "bytes": disk_bytes(path)}


def _print_folders(folders: list[dict[str, Any]], title: str, json: bool) -> None:
    directory = cache_directory()
    answer = {"directory": directory, "bytes": sum(each["bytes"] for each in folders), "folders": folders}
    console.print_result(answer, json, lambda: _show(folders, title))


def _show(folders: list[dict[str, Any]], title: str) -> None:
    if not folders:
        console.stdout.print(f"{cache_directory()}: nothing is kept")
    for folder in folders:
        size = f"{readable_bytes(folder['bytes'])} in {folder['files']} files"
        console.stdout.print(f"{title}: {folder['path']}: {size}, {folder['holds']}")
