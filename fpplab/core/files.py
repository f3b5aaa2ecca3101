"""Files that are written completely or not at all, and outputs that are never overwritten by accident."""

import errno
import io
import os
import re
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from mmap import mmap
from pathlib import Path
from typing import Any, BinaryIO, cast

from fpplab.core.errors import ConfigError, DataError
from fpplab.core.lock import try_lock
from fpplab.core.system import WINDOWS, posix, system_module
from fpplab.core.units import readable_bytes

fcntl = system_module("fcntl")  # None on Windows

STAGED_BYTES = 1 << 22  # bytes that are written at a time (chosen)


class DirectWriter(io.BufferedIOBase):
    """A stream that writes a file from front to back."""

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self._staged = memoryview(mmap(-1, STAGED_BYTES))  # begins at a page, as the system demands
        self._filled = self._before = 0
        _set_direct(handle, True)

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        source, done = memoryview(data).cast("B"), 0
        while done < len(source):
            part = source[done : done + STAGED_BYTES - self._filled]
            self._staged[self._filled : self._filled + len(part)] = part
            self._filled += len(part)
            done += len(part)
            if self._filled == STAGED_BYTES:
                self._write_staged()
        return len(source)

    def tell(self) -> int:
        return self._before + self._filled

    def finish(self) -> None:
        _set_direct(self._handle, False)  # which takes whole blocks only
        self._write_staged()
        os.fsync(self._handle)

    def _write_staged(self) -> None:
        unwritten = self._staged[: self._filled]
        while unwritten:
            unwritten = unwritten[os.write(self._handle, unwritten) :]
            if unwritten:
                # What is left does not begin at a block; without the cache the reason would be lost.
                _set_direct(self._handle, False)
        self._before += self._filled
        self._filled = 0


def _set_direct(handle: int, direct: bool) -> None:
    """Switch the cache off or on, where the file system supports it; the file's content is the same."""
    if fcntl is None or not hasattr(os, "O_DIRECT"):
        return
    flags = fcntl.fcntl(handle, fcntl.F_GETFL)
    with suppress(OSError):
        fcntl.fcntl(handle, fcntl.F_SETFL, flags | posix.O_DIRECT if direct else flags & ~posix.O_DIRECT)


@dataclass(frozen=True)
class FileLimits:
    """How long Windows keeps a file from being replaced."""

    opened_s: float = 2.0  # for which scanners of viruses and readers have a new file open (chosen)
    again_s: float = 0.02  # after which it is tried again (chosen)


LIMITS = FileLimits()


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; a pipe in its place would block forever."""
    return open(path, "rb", opener=_open_regular_file)


def _open_regular_file(path: str, flags: int) -> int:
    """Open a descriptor without waiting for another process, and refuse what is not a file."""
    handle = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))  # which Windows has not
    kind = os.fstat(handle).st_mode
    if not stat.S_ISREG(kind):
        os.close(handle)
        code = errno.EISDIR if stat.S_ISDIR(kind) else errno.EINVAL
        reason = os.strerror(code) if stat.S_ISDIR(kind) else "it is a pipe or a device, not a file"
        raise OSError(code, reason, path)
    return handle


def read_bounded(path: Path, max_bytes: int) -> bytes:
    with open_regular(path) as stream:
        content = stream.read(max_bytes + 1)
    if len(content) > max_bytes:
        reason = f"it is larger than {readable_bytes(max_bytes)}, the most that one of its kind has"
        raise OSError(errno.EFBIG, reason, str(path))
    return content


def no_such_file(path: Path, *suffixes: str) -> str:
    own = path.suffix.lower()
    accepted = suffixes or ((".yaml", ".yml") if own in (".yaml", ".yml") else (own,))
    entries = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
    nearby = {file.stem: file for file in entries if file.suffix.lower() in accepted}
    nearby |= {file.stem: file for file in entries if file.suffix.lower() == own or file.stem == path.name}
    closest = get_close_matches(path.stem, nearby, n=1, cutoff=0.7)
    kind = "file" if own else "file or folder"
    return f"{path}: there is no such {kind}" + (f"; did you mean {nearby[closest[0]]}?" if closest else "")


def write_atomic(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file that appears only once it is complete and on disk."""
    sweep_file_drafts(path)
    with _draft_replacing(path) as stream:
        write(cast(BinaryIO, _Sink(stream)))


def write_large(
    path: Path, write: Callable[[BinaryIO], object], approve: Callable[[], object] | None = None
) -> None:
    """Write a large file as `write_atomic` does, from front to back and past the system's cache."""
    sweep_file_drafts(path)
    with _draft_replacing(path) as stream:
        straight = DirectWriter(stream.fileno())
        write(cast(BinaryIO, straight))
        straight.finish()
        if approve is not None:
            approve()


class _Sink(io.BufferedIOBase):
    """A file without descriptor: with one, writers of arrays lose the system's reason for a refusal."""

    def __init__(self, stream: io.BufferedWriter) -> None:
        self._stream = stream

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        return self._stream.write(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.tell()


def write_parts(path: Path, *parts: bytes | memoryview) -> None:
    """Write parts one after the other into a file that appears only once it is complete and on disk."""
    # The parts are not copied. On an error nothing is left behind.
    with _draft_replacing(path) as stream:
        stream.writelines(parts)


@contextmanager
def _draft_replacing(path: Path) -> Iterator[io.BufferedWriter]:
    """A file next to `path` that replaces it once the context ends, complete and on disk."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise DataError(_cannot_write(path, error)) from error
    try:
        os.chmod(name, 0o644)
        with os.fdopen(handle, "wb") as stream:
            with suppress(OSError):  # a file system without locks: its drafts stay, see `sweep_file_drafts`
                try_lock(handle)
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        replace_file(Path(name), path)
        flush_folder(path.parent)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise DataError(_cannot_write(path, error)) from error
        raise


def replace_file(draft: Path, path: Path) -> None:
    """Give a file the name of another; on Windows only once no program has that one open."""
    end_s = time.monotonic() + LIMITS.opened_s
    while True:
        try:
            os.replace(draft, path)
        except PermissionError:
            if not WINDOWS or time.monotonic() > end_s:
                raise
            time.sleep(LIMITS.again_s)
        else:
            return


DRAFT_END = re.compile("[a-z0-9_]{8}")  # of tempfile's names


def sweep_file_drafts(path: Path) -> None:
    """Take away drafts of a file whose process was killed while it wrote."""
    # The draft that another process writes is locked, and stays.
    start = f".{path.name}."
    with suppress(OSError):  # whether the folder can be written shows when writing
        for name in [name for name in os.listdir(path.parent) if name.startswith(start)]:
            if DRAFT_END.fullmatch(name, len(start)):
                _remove_unlocked(path.with_name(name))


def _remove_unlocked(draft: Path) -> None:
    with open_regular(draft) as stream:
        is_left = try_lock(stream.fileno())
    if is_left:  # closed by now: Windows deletes no open file
        draft.unlink()


def flush_folder(folder: Path) -> None:
    """Flush a folder to disk, so that a new file's name survives a power failure as its content does."""
    if os.name == "nt":  # where folders cannot be opened
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text completely or not at all."""
    write_atomic(path, lambda stream: stream.write(text.encode("utf-8")))


def make_directory(path: Path, fill: Callable[[Path], object]) -> None:
    """Make a directory that appears only once it is complete. On an error nothing is left behind."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as hidden:
            draft = Path(hidden) / path.name
            draft.mkdir()
            fill(draft)
            draft.rename(path)
    except OSError as error:
        raise DataError(_cannot_write(path, error)) from error


def write_by_name(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file that appears only once it is complete, with a library that opens files itself."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as hidden:
            draft = Path(hidden) / path.name
            write(draft)
            with draft.open("rb+") as stream:
                os.fsync(stream.fileno())
            replace_file(draft, path)
            flush_folder(path.parent)


@contextmanager
def removed_on_failure(path: Path) -> Iterator[None]:
    try:
        yield
    except BaseException:
        path.unlink(missing_ok=True)
        raise


@contextmanager
def writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise DataError(_cannot_write(path, error)) from error


def _cannot_write(path: Path, error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{path}: no space left on the disk; free some and run the same command again"
    if WINDOWS and isinstance(error, PermissionError):
        return f"{path}: cannot be written ({error.strerror}); close it in other programs"
    return f"{path}: cannot be written ({error.strerror})"


def need_suffix(path: Path, *allowed: str) -> None:
    if path.suffix.lower() not in allowed:
        raise ConfigError(f"{path}: its name must end in {' or '.join(allowed)}")


RESERVED = re.compile(
    r'(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?|.*[<>:"/\\|?*\x00-\x1f].*|.*[. ]|', re.IGNORECASE | re.DOTALL
)


def is_portable_name(name: str) -> bool:
    """Whether a file can have this name on every system: Windows reserves some, for devices."""
    return not RESERVED.fullmatch(name)


def refuse_existing(path: Path, force: bool) -> None:
    if path.exists() and not force:
        raise ConfigError(f"{path}: exists already; name another output, or add --force to replace it")


def check_new_file(path: Path, force: bool, *suffixes: str) -> None:
    """Refuse a file to be written whose name ends in none of the suffixes, or that exists already."""
    need_suffix(path, *suffixes)
    refuse_existing(path, force)
