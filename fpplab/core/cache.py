"""The user's cache folder: what is kept there to save time, and can be computed again."""

import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fpplab.core.disk_space import disk_bytes
from fpplab.core.files import writing
from fpplab.core.system import cache_directory

CONTENTS = {"light": "rendered light of simulated scenes; the next scan of a scene renders it again"}


@dataclass(frozen=True)
class CachedFolder:
    """A folder of the cache."""

    path: Path
    holds: str
    files: int
    bytes: int


def cached_folders() -> list[CachedFolder]:
    directory = cache_directory()
    inside = sorted(directory.iterdir()) if directory.is_dir() else []
    # A link may lead to anything.
    return [_cached_folder(path) for path in inside if path.is_dir() and not path.is_symlink()]


def clear_cache() -> list[CachedFolder]:
    """Delete all folders of the cache, and return what they were."""
    folders = cached_folders()
    for folder in folders:
        with writing(folder.path), suppress(FileNotFoundError):  # another process clears it too
            shutil.rmtree(folder.path)
    return folders


def _cached_folder(path: Path) -> CachedFolder:
    files = sum(file.is_file() for file in path.rglob("*"))
    return CachedFolder(path, CONTENTS.get(path.name, "unknown to this version"), files, disk_bytes(path))
