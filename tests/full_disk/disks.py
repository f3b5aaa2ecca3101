"""File systems of a size of one's own: tmpfs, which root alone can mount."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PAGE, FILLER = 4096, "filler"


@contextmanager
def disk(place: Path, pages: int = 10_000) -> Iterator[Path]:
    """A file system with room for so many pages, mounted at a folder that is made for it."""
    place.mkdir(parents=True, exist_ok=True)
    _system("mount", "-t", "tmpfs", "-o", f"size={pages * PAGE}", "tmpfs", place)
    (place / FILLER).write_bytes(b"x")  # an empty disk of no pages has no limit at all
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=False, capture_output=True)


def resize(place: Path, pages: int) -> None:
    """Give a mounted disk another size."""
    _system("mount", "-o", f"remount,size={pages * PAGE}", place)


def make_read_only(place: Path) -> None:
    """What the system does to a disk that fails."""
    _system("mount", "-o", "remount,ro", place)


def detach(place: Path) -> None:
    """Take the file system away, as a server that is gone does: nothing is there any more."""
    _system("umount", "-l", place)


def can_mount(place: Path) -> bool:
    """Whether this process may mount."""
    try:
        with disk(place, 1):
            return True
    except (subprocess.CalledProcessError, FileNotFoundError):
        return False


def _system(*words: object) -> None:
    subprocess.run(list(map(str, words)), check=True, capture_output=True)
