"""What fpplab keeps outside of the user's results to save time, and can compute again."""

import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fpplab.core.disk_space import disk_bytes
from fpplab.core.files import writing
from fpplab.core.system import cache_directory

CONTENTS = {"light": "rendered light of simulated scenes; the next scan of a scene renders it again"}


@dataclass(frozen=True)
class CacheFolder:
    """One folder of the cache directory."""

    path: Path  # the folder
    holds: str  # what it holds
    files: int  # how many files
    bytes: int  # space that they take on the disk


def cache_folders() -> list[CacheFolder]:
    directory = cache_directory()
    inside = sorted(directory.iterdir()) if directory.is_dir() else []
    # A link may lead to anything.
    return [_described(path) for path in inside if path.is_dir() and not path.is_symlink()]


def clear_caches() -> list[CacheFolder]:
    cleared = cache_folders()
    for folder in cleared:
        with writing(folder.path), suppress(FileNotFoundError):  # another process clears it too
            shutil.rmtree(folder.path)
    return cleared


def _described(path: Path) -> CacheFolder:
    files = [file for file in path.rglob("*") if file.is_file()]
    return CacheFolder(path, CONTENTS.get(path.name, "unknown to this version"), len(files), disk_bytes(path))
