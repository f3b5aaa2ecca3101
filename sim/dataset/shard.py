"""A shard on disk: a folder with one NumPy file for each field, samples along its first axis.

It is written to a hidden draft folder, which gets its final name once everything in it is on disk, so that a
shard under its final name is complete. A draft belongs to the process that holds the lock of the
file next to it, which the operating system releases when the process dies; the next one starts it again.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from io import BufferedReader
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

import numpy as np

from fpplab.core.errors import DataError
from fpplab.core.files import flush_folder, open_regular, read_bounded, writing
from fpplab.core.lock import locked_file
from fpplab.core.strict_json import parse_object
from sim.dataset.fields import Arrays, FieldSpec

CHECKSUMS, SCENES = "sha256.json", "scenes.jsonl"
"""Files besides the arrays: checksums of all others, and a line for each sample with all that was drawn."""


def shard_name(number: int) -> str:
    return f"shard_{number:05d}"


def draft_name(number: int) -> str:
    return f".{shard_name(number)}"


@contextmanager
def claim_shard(folder: Path, number: int) -> Iterator[Path | None]:
    """Open an empty draft of a shard, which is renamed to the shard when the block ends."""
    final = folder / shard_name(number)
    draft = folder / draft_name(number)
    with writing(final), ExitStack() as stack:
        is_mine = stack.enter_context(locked_file(draft.with_name(f"{draft.name}.lock")))
        if not is_mine or final.exists():
            yield None
            return
        draft.mkdir(exist_ok=True)
        for remnant in draft.iterdir():
            remnant.unlink()
        try:
            yield draft
            flush_folder(draft)
            draft.rename(final)
            flush_folder(folder)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise


class ShardWriter:
    """Writes samples in turn; leaving the `with` block puts everything on disk, checksums last."""

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
    return f"{field}.npy"


class _Hashed:
    """A file being written, with the checksum of its content."""

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
    try:
        sums = parse_object(read_bounded(shard / CHECKSUMS, 1_000_000))  # bytes
        for name, expected in sums.items():
            if Path(name).name != name:
                raise DataError(f"{shard / CHECKSUMS}: names '{name}', which is not in its folder")
            with open_regular(shard / name) as stream:
                if hashlib.file_digest(cast(BufferedReader, stream), "sha256").hexdigest() != expected:
                    raise DataError(
                        f"{shard / name}: is damaged, its checksum is not the shard's; remove {shard} and "
                        "run the same `fpplab dataset` again"
                    )
    except (OSError, ValueError, AttributeError) as error:
        raise DataError(
            f"{shard}: is not a complete shard ({error}); remove it and run the same `fpplab dataset` again"
        ) from error
