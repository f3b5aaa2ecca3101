"""Turns on a rig: a command that only watches closes the devices when another command needs them.

Of three files per rig file, `wanted` is locked, shared, by all that want to measure, `used` by those that do,
or by the watcher alone, and `watched` by the watcher. A watcher holds the rig for one frame at a time.
"""

import hashlib
import json
import logging
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from fpplab.core.errors import DeviceError
from fpplab.core.lock import lock_owner, open_lock, try_lock, write_lock_owner
from fpplab.core.strict_json import parse_object

TURN_TIMEOUT_S = 60.0  # longest wait in s for a rig (chosen): a watcher releases the rig after one frame

USER = os.getuid() if hasattr(os, "getuid") else 0
"""Whose folder it is; on Windows each user has a folder for temporary files."""

_log = logging.getLogger(__name__)

_watched: set[str] = set()  # rigs that this very process watches: what it opens of them needs no turn


class RigTurn:
    """The turn of a watcher on a rig; made by `watching_rig`."""

    def __init__(self, lock_stem: Path) -> None:
        self._lock_stem = lock_stem
        self._used: int | None = None

    @property
    def is_mine(self) -> bool:
        return self._used is not None

    def is_requested(self) -> bool:
        handle = _open_lock_file(self._lock_stem, "wanted")
        try:
            return not _try_lock(handle)
        finally:
            os.close(handle)

    def requested_by(self) -> str:
        return lock_owner(_lock_path(self._lock_stem, "wanted"))

    def take(self) -> bool:
        if self._used is None and not self.is_requested():
            self._used = _open_and_try_lock(self._lock_stem, "used")
        return self.is_mine

    def yield_rig(self) -> None:
        """Let the other commands have the rig; its devices are closed by now."""
        handle, self._used = self._used, None
        if handle is not None:
            os.close(handle)


@contextmanager
def watching_rig(source: Path | str) -> Iterator[RigTurn]:
    lock_stem = _lock_stem_of(source)
    handle = _open_and_try_lock(lock_stem, "watched")
    if handle is None:
        who = lock_owner(_lock_path(lock_stem, "watched"))
        raise DeviceError(str(source), "watch", f"{who} watches it already", "end that first")
    write_lock_owner(handle)
    turn = RigTurn(lock_stem)
    _watched.add(str(lock_stem))
    try:
        yield turn
    finally:
        _watched.discard(str(lock_stem))
        turn.yield_rig()
        os.close(handle)


@contextmanager
def using_rig(source: Path | str) -> Iterator[None]:
    lock_stem = _lock_stem_of(source)
    if str(lock_stem) in _watched:
        yield
        return
    with ExitStack() as stack:
        for name in ("wanted", "used"):
            handle = _open_lock_file(lock_stem, name)
            stack.callback(os.close, handle)
            _acquire_shared_lock(handle, lock_stem, source)
            if name == "wanted":
                write_lock_owner(handle)
        yield


@contextmanager
def announcing_service(source: Path | str, announcement: dict[str, object]) -> Iterator[Path]:
    """Leave where other commands of this user find the rig's service, as long as it runs."""
    lock_stem = _lock_stem_of(source)
    place = _lock_path(lock_stem, "service")
    for _ in range(20):  # a command that looks for a service holds the lock for a moment
        if (handle := _open_and_try_lock(lock_stem, "service")) is not None:
            break
        time.sleep(0.02)
    else:
        raise DeviceError(str(source), "serve", f"{_announced(place)} serves it already", "end that first")
    try:
        os.ftruncate(handle, 0)
        os.write(handle, json.dumps(announcement).encode())
        yield place
    finally:
        os.ftruncate(handle, 0)
        os.close(handle)


def announced_service(source: Path | str) -> dict[str, object] | None:
    """Find what the service of a rig has announced, if one runs."""
    place = _lock_path(_lock_stem_of(source), "service")
    try:
        handle = os.open(place, os.O_RDWR)
    except OSError:
        return None
    try:
        if _try_lock(handle, shared=True):  # its service is gone
            return None
        return parse_object(os.read(handle, 10_000))
    except ValueError:  # it is being written
        return None
    finally:
        os.close(handle)


def _announced(place: Path) -> str:
    try:
        return "process {pid} at {url}".format(**parse_object(place.read_bytes()))
    except (OSError, ValueError, KeyError):
        return "another process"


def _acquire_shared_lock(handle: int, lock_stem: Path, rig_file: Path | str) -> None:
    """Wait until a lock can be shared; short sleeps keep Ctrl-C working."""
    end = time.monotonic() + TURN_TIMEOUT_S
    if _try_lock(handle, shared=True):
        return
    _log.info("%s: waiting until %s releases it", rig_file, lock_owner(_lock_path(lock_stem, "watched")))
    while not _try_lock(handle, shared=True):
        if time.monotonic() > end:
            who = lock_owner(_lock_path(lock_stem, "watched"))
            reason = f"{who} has not released it within {TURN_TIMEOUT_S:g} s"
            raise DeviceError(str(rig_file), "open", reason, "end that process")
        time.sleep(0.02)  # one frame's time at 50 Hz: the operator does not notice it


def _lock_stem_of(source: Path | str) -> Path:
    folder = Path(tempfile.gettempdir()) / f"fpplab-rigs-{USER}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        owner = folder.lstat().st_uid
    except OSError as error:
        raise _lock_error(folder, error) from error
    if owner != USER:
        raise DeviceError(str(source), "open", f"{folder} belongs to another user", "delete it")
    return folder / hashlib.sha256(str(Path(source).resolve()).encode()).hexdigest()[:16]


def _lock_error(place: Path, error: OSError) -> DeviceError:
    reason = f"{place} cannot be used ({error.strerror})"
    return DeviceError("rig", "lock", reason, "let TMPDIR name a folder that can be written to")


def _lock_path(lock_stem: Path, name: str) -> Path:
    return lock_stem.with_name(f"{lock_stem.name}.{name}")


def _open_lock_file(lock_stem: Path, name: str) -> int:
    """A lock file; it stays, for its lock is what counts, and to delete it would make two of it."""
    place = _lock_path(lock_stem, name)
    try:
        return open_lock(place, 0o600)
    except OSError as error:
        raise _lock_error(place, error) from error


def _try_lock(handle: int, shared: bool = False) -> bool:
    try:
        return try_lock(handle, shared)
    except OSError as error:
        raise _lock_error(Path(tempfile.gettempdir()), error) from error


def _open_and_try_lock(lock_stem: Path, name: str) -> int | None:
    handle = _open_lock_file(lock_stem, name)
    if _try_lock(handle):
        return handle
    os.close(handle)
    return None
