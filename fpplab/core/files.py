"""Files written whole or not at all, and outputs that are never overwritten by accident."""

from __future__ import annotations

import errno
import io
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import BinaryIO

from fpplab.core.errors import ConfigError, DataError


def write_atomic(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Let `write` fill a file that appears under `path` only once it is complete and on disk.

    Raises `DataError` as `write_parts`.
    """
    content = io.BytesIO()  # first in memory: writers of arrays lose the system's reason for a refusal
    write(content)
    write_parts(path, content.getbuffer())


def write_parts(path: Path, *parts: bytes | memoryview) -> None:
    """Write parts, one behind the other, into a file that appears once it is complete and on disk.

    They are not copied. Raises `DataError` when there is no space left or the place cannot be written;
    nothing is left behind then.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise DataError(_cannot_write(path, error)) from error
    try:
        os.fchmod(handle, 0o644)
        with os.fdopen(handle, "wb") as stream:
            stream.writelines(parts)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(name, path)
        flush_folder(path.parent)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise DataError(_cannot_write(path, error)) from error
        raise


def flush_folder(folder: Path) -> None:
    """Have a new name itself on disk, not only what it names: power may fail between the two."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole or not at all."""
    write_atomic(path, lambda stream: stream.write(text.encode("utf-8")))


def append_line(path: Path, line: str) -> None:
    """Add one line to a journal and have it on disk before returning.

    Raises `DataError` when there is no space left; the journal ends then where it ended before.
    """
    try:
        end = path.stat().st_size
        try:
            with path.open("ab") as stream:
                stream.write(line.encode("utf-8") + b"\n")
                stream.flush()
                os.fsync(stream.fileno())
        except BaseException:
            os.truncate(path, end)
            raise
    except OSError as error:
        raise DataError(_cannot_write(path, error)) from error


def whole_lines(path: Path) -> list[bytes]:
    """The lines of a journal. What follows the last newline is torn, and no line."""
    return path.read_bytes().split(b"\n")[:-1]


def cut_torn_line(path: Path) -> None:
    """Cut off what follows a journal's last newline, so that the next line is one of its own.

    Looks at the end of the file alone. Raises `DataError` when the place cannot be written.
    """
    with writing(path):
        if path.stat().st_size == 0:  # which cannot be mapped
            return
        with path.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as text:
            end, whole = len(text), text.rfind(b"\n") + 1
        if whole < end:
            os.truncate(path, whole)


def make_directory(path: Path, fill: Callable[[Path], object]) -> None:
    """Let `fill` furnish a directory that appears under `path` only once it is complete.

    Raises `DataError` when the place cannot be written; nothing is left behind then.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as hidden:
            draft = Path(hidden) / path.name
            draft.mkdir()
            fill(draft)
            draft.rename(path)
    except OSError as error:
        raise DataError(_cannot_write(path, error)) from error


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tell of a refusal of the system to write `path` as `DataError`."""
    try:
        yield
    except OSError as error:
        raise DataError(_cannot_write(path, error)) from error


def _cannot_write(path: Path, error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{path}: no space left on the disk; free some and run the same command again"
    return f"{path}: cannot be written ({error.strerror})"


def need_suffix(path: Path, *allowed: str) -> None:
    """Refuse an output whose name does not say what it will hold: `ConfigError`."""
    if path.suffix.lower() not in allowed:
        raise ConfigError(f"{path}: its name must end in {' or '.join(allowed)}")


def refuse_existing(path: Path, force: bool) -> None:
    """Refuse an output that exists, unless the user said `--force`: `ConfigError`."""
    if path.exists() and not force:
        raise ConfigError(f"{path}: exists already; name another output, or add --force to replace it")
