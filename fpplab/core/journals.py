"""Journals, to which whole lines are appended."""

import os
from mmap import ACCESS_READ, mmap
from pathlib import Path

from fpplab.core.errors import DataError
from fpplab.core.files import read_bounded, writing

MAX_JOURNAL_BYTES = 256_000_000  # greatest size in bytes of a journal (chosen): some 700,000 frames


def make_journal(path: Path) -> None:
    """Make an empty journal with its folder; an existing one stays as it is."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def append_line(path: Path, line: str) -> None:
    """Append one line to a journal, on disk before this returns."""
    # On an error the journal is as it was before.
    with writing(path):
        end = path.stat().st_size
        try:
            with path.open("ab") as stream:
                stream.write(line.encode("utf-8") + b"\n")
                stream.flush()
                os.fsync(stream.fileno())
        except BaseException:
            os.truncate(path, end)
            raise


def whole_lines(path: Path) -> list[bytes]:
    # What follows the last newline was cut off while it was written, and is left out.
    try:
        return read_bounded(path, MAX_JOURNAL_BYTES).split(b"\n")[:-1]
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error


def cut_torn_line(path: Path) -> None:
    # Searches backwards from the end of the file, which is not read as a whole.
    with writing(path):
        if path.stat().st_size == 0:  # which cannot be mapped
            return
        with path.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as text:
            end, whole_bytes = len(text), text.rfind(b"\n") + 1
        if whole_bytes < end:
            os.truncate(path, whole_bytes)
