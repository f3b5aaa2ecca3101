"""NPZ files from any source: the sizes that they declare are checked before any memory is asked for."""

import math
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.files import open_regular
from fpplab.core.units import readable_bytes


@dataclass(frozen=True)
class ArchiveLimits:
    """Limits of what an archive may unpack to."""

    always_allowed_bytes: int = 256_000_000  # bytes that any archive may unpack to (chosen)
    max_growth: int = 100
    """By how many times a greater one may grow (chosen: recorded images grow by less than ten)"""


LIMITS = ArchiveLimits()

NUMBERS = "biuf"  # kinds of arrays that are read: truth values and numbers


def check_archive(archive: zipfile.ZipFile, size: int) -> None:
    unpacked = sum(member.file_size for member in archive.infolist())
    if unpacked > max(LIMITS.always_allowed_bytes, LIMITS.max_growth * size):
        raise ValueError(
            f"{readable_bytes(size)} that unpack to {readable_bytes(unpacked)}, more than "
            f"{LIMITS.max_growth} times as much; save it without compression"
        )


def array_head(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    version: tuple[int, int] = np.lib.format.read_magic(stream)  # type: ignore[no-untyped-call]
    if version not in readers:
        raise ValueError(f"an array in NumPy's format {version}; save it again with a present NumPy")
    shape, columns_first, dtype = readers[version](stream)  # type: ignore[no-untyped-call]
    if any(length < 0 for length in shape):
        raise ValueError(f"an array of the shape {shape}")
    return shape, columns_first, dtype


def load_arrays(path: Path, names: Iterable[str] | None) -> dict[str, NDArray[Any]]:
    """Read arrays of numbers from an NPZ file: those of these names that are there, or all."""
    with open_regular(path) as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                check_archive(archive, path.stat().st_size)
                members = {member.filename: member for member in archive.infolist()}
                if names is None:
                    names = [name.removesuffix(".npy") for name in members if name.endswith(".npy")]
                chosen = {name: members[f"{name}.npy"] for name in names if f"{name}.npy" in members}
                return {name: _array(archive, member) for name, member in chosen.items()}
        except Exception as error:  # the unpackers raise exceptions of any kind
            raise ValueError(" ".join(str(error).split()) or type(error).__name__) from error


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as inside:
        shape, columns_first, dtype = array_head(inside)
        if dtype.kind not in NUMBERS:
            raise ValueError(f"{member.filename} is an array of {dtype}, not of numbers")
        stored_bytes, expected_bytes = member.file_size - inside.tell(), math.prod(shape) * dtype.itemsize
        if stored_bytes != expected_bytes:
            raise ValueError(f"{member.filename} takes {expected_bytes} bytes, and {stored_bytes} are there")
        values: NDArray[Any] = np.empty(math.prod(shape), dtype)
        if inside.readinto(values.view(np.uint8).data) != expected_bytes:  # type: ignore[attr-defined]
            raise ValueError(f"{member.filename} is truncated")
    return values.reshape(shape, order="F" if columns_first else "C")
