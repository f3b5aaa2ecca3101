"""Reading and writing the part of the PLY format that clouds need: scalar vertex properties and comments."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import cycle
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fpplab.core.files import open_regular

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_NAMES = {"u1": "uchar", "i4": "int", "f4": "float"}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_BLOCK = 1 << 16
"""Vertices that are written at a time (chosen)."""

VertexTable = NDArray[Any]
"""A structured array, one record per vertex."""


def write(columns: Mapping[str, NDArray[Any]], comments: list[str], stream: BinaryIO) -> None:
    """Write vertices as a little-endian binary PLY file."""
    # columns (N,)
    kinds, count = {name: values.dtype.str[1:] for name, values in columns.items()}, _count(columns)
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines += [f"element vertex {count}"]
    lines += [f"property {_NAMES[kind]} {name}" for name, kind in kinds.items()]
    stream.write(("\n".join([*lines, "end_header"]) + "\n").encode("ascii"))
    dtype = np.dtype([(name, "<" + kind) for name, kind in kinds.items()])
    with ThreadPoolExecutor(1) as writer:  # one half is written while the other is filled
        written: Future[int] | None = None
        halves = cycle(np.empty((2, _BLOCK), dtype))
        for start in range(0, count, _BLOCK):
            records = next(halves)[: min(_BLOCK, count - start)]
            _fill(records, columns, start)
            if written is not None:
                written.result()
            written = writer.submit(stream.write, records.view(np.uint8).data)
        if written is not None:
            written.result()


def _fill(
    records: VertexTable, columns: Mapping[str, NDArray[Any]], start: int, at_a_time: int = 1 << 13
) -> None:
    """Fill some records at a time: as a whole they would leave the processor's cache between two columns."""
    for first in range(0, len(records), at_a_time):
        part = records[first : first + at_a_time]
        for name, values in columns.items():
            part[name] = values[start + first : start + first + len(part)]


def _count(columns: Mapping[str, NDArray[Any]]) -> int:
    return len(next(iter(columns.values())))


def read(path: Path) -> tuple[VertexTable, list[str]]:
    """Read the vertices of a PLY file, text or binary of any byte order."""
    with open_regular(path) as stream:
        order, count, kinds, comments = _header(stream)
        dtype = np.dtype([(name, (order if order != "=" else "<") + kind) for name, kind in kinds])
        # The number of vertices is believed only where the file has room for them.
        remaining_bytes = path.stat().st_size - stream.tell()
        min_vertex_bytes = max(1, 2 * len(kinds)) if order == "=" else dtype.itemsize
        if count * min_vertex_bytes > remaining_bytes + (order == "="):  # the last line may have no end
            raise ValueError(
                f"it ends after at most {remaining_bytes // min_vertex_bytes} of {count} vertices"
            )
        if order == "=":
            rows = [stream.readline().split() for _ in range(count)]
            return np.array([tuple(map(float, row[: len(kinds)])) for row in rows], dtype), comments
        table = np.fromfile(stream, dtype, count)
    if len(table) != count:
        raise ValueError(f"it ends after {len(table)} of {count} vertices")
    return table, comments


def _header(stream: BinaryIO) -> tuple[str, int, list[tuple[str, str]], list[str]]:
    """Read the byte order, the number of vertices, their properties as (name, kind), and the comments."""
    order, count, kinds, comments, element = "", -1, [], [], ""
    if stream.readline().strip() != b"ply":
        raise ValueError("it does not begin with 'ply'")
    while line := stream.readline(1 << 12):  # a longer line is read in parts
        match line.decode("ascii", "replace").split():
            case ["format", name, *_]:
                order = _ORDERS[name]
            case ["comment", *text]:
                comments.append(" ".join(text))
            case ["element", element, number]:
                if element == "vertex":
                    count = int(number)
                elif count < 0:
                    raise ValueError(f"element '{element}' comes before the vertices")
            case ["property", "list", *_] if element == "vertex":
                raise ValueError("a vertex has a list as property")
            case ["property", kind, name] if element == "vertex":
                kinds.append((name, _TYPES[kind]))
            case ["end_header"]:
                if not order or count < 0:
                    raise ValueError("its header names no format or no vertices")
                return order, count, kinds, comments
    raise ValueError("its header has no end")
