"""Tables of direct light on disk, under a hash of everything that they depend on.

A file is one line that names the format, one line of JSON, the arrays, and the SHA-256 of all that. A file
that is damaged, or written by another version of Blender or of its shaders, is removed and rendered again.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import logging
import math
import os
import tempfile
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import IO, BinaryIO, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fpplab.core.extras import need_extra
from fpplab.core.system import cache_directory
from sim.light.table import LightTable
from sim.scene import RenderScene, SubpixelView


class Sized(Protocol):
    """Whatever knows its size in bytes."""

    @property
    def nbytes(self) -> int:
        """Size in bytes."""


T = TypeVar("T", bound=Sized)  # type of the results that a cache keeps


class ByteLimitedCache(Generic[T]):
    """Results by key; when they exceed a limit the least recently used are dropped.

    The usual limit is 512 MiB (chosen).
    """

    def __init__(self, limit_bytes: int = 1 << 29) -> None:
        self._limit_bytes = limit_bytes
        self._results: OrderedDict[object, T] = OrderedDict()

    def get(self, key: object, make: Callable[[], T]) -> T:
        if key not in self._results:
            self._results[key] = make()
        self._results.move_to_end(key)
        while len(self._results) > 1 and sum(r.nbytes for r in self._results.values()) > self._limit_bytes:
            self._results.popitem(last=False)
        return self._results[key]

    def put(self, key: object, result: T) -> T:
        """Keep a result that was made elsewhere, unless there is one of that key."""
        return self.get(key, lambda: result)

    def __contains__(self, key: object) -> bool:
        return key in self._results

    def take(self, other: ByteLimitedCache[T]) -> None:
        """Add all results of another cache, which keeps them too."""
        self._results.update(other._results)

    def clear(self) -> None:
        self._results.clear()


FORMAT = "fpplab light table 4"  # first line of a file

_log = logging.getLogger(__name__)


def table_digest(scene: RenderScene, views: list[SubpixelView], *more: object) -> str:
    hashed = hashlib.sha256()
    _feed(hashed, (scene, views, *more))
    return hashed.hexdigest()[:32]


def _feed(hashed: hashlib._Hash, value: object) -> None:
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            hashed.update(field.name.encode())
            _feed(hashed, getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        hashed.update(f"{value.dtype}{value.shape}".encode())
        hashed.update(np.ascontiguousarray(value).data)
    elif isinstance(value, tuple | list):
        hashed.update(f"({len(value)}".encode())
        for part in value:
            _feed(hashed, part)
    else:
        hashed.update(f"{value!r};".encode())


@lru_cache(maxsize=1)
def renderer_name() -> str:
    sim = Path(__file__).parents[1]
    hashed = hashlib.sha256()
    for path in sorted(
        [*(sim / "blender").glob("*.py"), *(sim / "blender").glob("*.osl"), sim / "light/table.py"]
    ):
        hashed.update(path.read_bytes())
    need_extra("bpy")
    return f"Blender {version('bpy')} with shaders {hashed.hexdigest()[:12]}"


class TableCache:
    """Tables in one directory, of which the least recently used are removed beyond a limit."""

    def __init__(self, directory: Path | None = None, limit_bytes: int = 2 << 30) -> None:
        self._directory = directory or cache_directory() / "light"
        self._limit_bytes = limit_bytes

    def load(self, key: str) -> LightTable | None:
        """Read a table; a file that is damaged or of another renderer is removed."""
        path = self._path(key)
        try:
            with path.open("rb") as stream:
                table = _read(stream)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            _log.warning("%s: is discarded and rendered again: %s", path, error)
            with suppress(OSError):  # a file that cannot be removed is discarded again next time
                path.unlink(missing_ok=True)
            return None
        with suppress(OSError):  # the file may be another user's and read-only
            os.utime(path)
        return table

    def store(self, key: str, table: LightTable) -> None:
        """Write a table; a failure is only logged, because the table can be rendered again."""
        if table.nbytes > self._limit_bytes:
            _log.warning("%.1f GB of light exceed the cache's limit and are not stored", table.nbytes / 1e9)
            return
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            self._write_whole(self._path(key), table)
        except OSError as error:
            _log.warning("a table of light cannot be stored in %s: %s", self._directory, error)
            return
        self._make_room()

    def _write_whole(self, path: Path, table: LightTable) -> None:
        """Rename the file once it is complete; without fsync, because the checksum reveals a torn file."""
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f"{path.name}.", delete=False) as draft:
            try:
                _write_table(draft, table)
                draft.close()
                os.replace(draft.name, path)
            except BaseException:
                Path(draft.name).unlink(missing_ok=True)
                raise

    def _path(self, key: str) -> Path:
        return self._directory / f"{key}.table"

    def _make_room(self) -> None:
        """Remove the least recently used files, including temporary ones of processes that were killed."""
        files = []
        for path in self._directory.glob("*.table*"):
            with suppress(OSError):  # another process has removed it
                files.append((path.stat(), path))
        total = sum(stat.st_size for stat, _ in files)
        for stat, path in sorted(files, key=lambda entry: entry[0].st_mtime_ns):
            if total <= self._limit_bytes:
                return
            with suppress(OSError):
                path.unlink(missing_ok=True)
            total -= stat.st_size


def _write_table(stream: IO[bytes], table: LightTable) -> None:
    about = {
        "renderer": renderer_name(),
        "samples": table.samples.shape,
        "albedo": table.albedo.shape,
        "corner": table.corner,
    }
    hashed = hashlib.sha256()
    for part in (f"{FORMAT}\n{json.dumps(about)}\n".encode(), table.samples.data, table.albedo.data):
        stream.write(part)
        hashed.update(part)
    stream.write(hashed.digest())


def _read(stream: BinaryIO) -> LightTable:
    """Read and check a file; `ValueError` says what is wrong, a bad header is `KeyError` or `TypeError`."""
    first = stream.readline(200)
    name = first.decode(errors="replace").strip()
    if name != FORMAT:
        raise ValueError(f"it is '{name[:40]}', not '{FORMAT}'")
    second = stream.readline(1000)
    about = json.loads(second)
    if about["renderer"] != renderer_name():
        raise ValueError(f"it was rendered by {about['renderer']}, not {renderer_name()}")
    hashed = hashlib.sha256(first + second)
    samples, albedo = (_read_array(stream, tuple(about[part]), hashed) for part in ("samples", "albedo"))
    if stream.read(64) != hashed.digest():
        raise ValueError("its checksum is wrong")
    left, top = about["corner"]
    return LightTable(samples, albedo, (int(left), int(top)))


def _read_array(stream: BinaryIO, shape: tuple[int, ...], hashed: hashlib._Hash) -> NDArray[np.float32]:
    if 4 * math.prod(shape) > os.fstat(stream.fileno()).st_size:  # before memory is asked for
        raise ValueError("it is truncated")
    values = np.empty(shape, np.float32)
    if stream.readinto(values.data.cast("B")) != values.nbytes:  # type: ignore[attr-defined]
        raise ValueError("it is truncated")
    hashed.update(values.data)
    return values
