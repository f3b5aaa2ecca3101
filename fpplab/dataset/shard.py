"""A shard on disk: a folder with one NumPy file for each field, samples along its first axis.

It is filled as a hidden draft and takes its name once everything in it is on disk, so that what has the name
is whole. A draft belongs to the process that holds its lock, which the system takes back from a process that
dies; the next one begins the draft anew.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from fpplab.core.errors import DataError
from fpplab.core.files import flush_folder, writing
from fpplab.dataset.fields import Arrays, FieldSpec

CHECKSUMS, SCENES = "sha256.json", "scenes.jsonl"
"""Beside the arrays: checksums of all other files, and one line for each sample with all that was drawn."""


def shard_name(number: int) -> str:
    """The folder of a shard."""
    return f"shard_{number:05d}"


@contextmanager
def claim_shard(folder: Path, number: int) -> Iterator[Path | None]:
    """An empty draft of a shard, which takes its name at the end, or None if it is another's business.

    That is when it is whole already, or another process is at it. Raises `DataError` when it cannot be
    written.
    """
    final = folder / shard_name(number)
    draft = folder / f".{final.name}"
    with writing(final), ExitStack() as stack:
        if final.exists():
            yield None
            return
        draft.mkdir(exist_ok=True)
        handle = os.open(draft, os.O_RDONLY)
        stack.callback(os.close, handle)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield None
            return
        if final.exists():  # finished between the two looks
            with suppress(OSError):
                draft.rmdir()
            yield None
            return
        for left in draft.iterdir():
            left.unlink()
        try:
            yield draft
            flush_folder(draft)
            draft.rename(final)
            flush_folder(folder)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise


class ShardWriter:
    """Writes samples one behind the other; `with` ends with everything on disk, checksums last."""

    def __init__(
        self, draft: Path, fields: dict[str, FieldSpec], samples: int, dimensions: dict[str, int]
    ) -> None:
        self._draft, self._stack = draft, ExitStack()
        self._files = {SCENES: self._open(SCENES)}
        for name, field in fields.items():
            head = {
                "descr": field.dtype,
                "fortran_order": False,
                "shape": (samples, *field.extent(dimensions)),
            }
            self._files[array_file(name)] = self._open(array_file(name))
            np.lib.format.write_array_header_2_0(self._files[array_file(name)], head)  # type: ignore[no-untyped-call]
        self._fields, self._dimensions = fields, dimensions

    def _open(self, name: str) -> _Hashed:
        return self._stack.enter_context(_Hashed(self._draft / name))

    def add(self, arrays: Arrays, scene: dict[str, Any]) -> None:
        """The next sample."""
        for name, field in self._fields.items():
            array = np.asarray(arrays[name], order="C")
            assert (array.dtype.str, array.shape) == (field.dtype, field.extent(self._dimensions)), name
            self._files[array_file(name)].write(array.reshape(-1).view(np.uint8).data)
        self._files[SCENES].write(json.dumps(scene).encode() + b"\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()
        if error is None:
            sums = {name: file.digest for name, file in sorted(self._files.items())}
            with _Hashed(self._draft / CHECKSUMS) as file:
                file.write(json.dumps(sums, indent=1).encode() + b"\n")


def array_file(field: str) -> str:
    """The file of a field in a shard."""
    return f"{field}.npy"


class _Hashed:
    """A file that is being written, and the checksum of what went into it."""

    def __init__(self, path: Path) -> None:
        self._stream, self._hash = path.open("wb"), hashlib.sha256()

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()

    def write(self, data: bytes | memoryview) -> int:
        self._hash.update(data)
        return self._stream.write(data)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._stream:
            self._stream.flush()
            os.fsync(self._stream.fileno())


def check_shard(shard: Path) -> None:
    """Compare every file of a shard with its checksum. Raises `DataError` that names a damaged one."""
    try:
        sums = json.loads((shard / CHECKSUMS).read_bytes())
        for name, expected in sums.items():
            with (shard / name).open("rb") as stream:
                if hashlib.file_digest(stream, "sha256").hexdigest() != expected:
                    raise DataError(
                        f"{shard / name}: is damaged, its checksum is not the shard's; remove {shard} and "
                        "run the same `fpplab dataset` again"
                    )
    except (OSError, ValueError, AttributeError) as error:
        raise DataError(
            f"{shard}: is no whole shard ({error}); remove it and run the same `fpplab dataset` again"
        ) from error
