"""Reading and writing the part of the PLY format that clouds need: scalar vertex properties and comments."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_NAMES = {"u1": "uchar", "i4": "int", "f4": "float"}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_LONGEST_LINE = 1 << 12
_BLOCK = 1 << 13

VertexTable = NDArray[Any]
"""A structured array, one record per vertex."""


def write(columns: Mapping[str, NDArray[Any]], comments: list[str], stream: BinaryIO) -> None:
    """Write vertices as a little-endian binary PLY file.

    Parameters
    ----------
    columns : mapping of str to ndarray, (N,)
        By property, of type u1, i4 and f4; at least one.
    comments : list of str
        Lines for the header.
    stream : binary file
        Where to write.
    """
    kinds, count = {name: values.dtype.str[1:] for name, values in columns.items()}, _count(columns)
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines += [f"element vertex {count}"]
    lines += [f"property {_NAMES[kind]} {name}" for name, kind in kinds.items()]
    stream.write(("\n".join([*lines, "end_header"]) + "\n").encode("ascii"))
    # Block by block: as a whole the records would leave the processor's cache between two columns.
    block = np.empty(_BLOCK, [(name, "<" + kind) for name, kind in kinds.items()])
    for start in range(0, count, _BLOCK):
        records = block[: min(_BLOCK, count - start)]
        for name, values in columns.items():
            records[name] = values[start : start + _BLOCK]
        stream.write(records.view(np.uint8).data)


def _count(columns: Mapping[str, NDArray[Any]]) -> int:
    return len(next(iter(columns.values())))


def read(path: Path) -> tuple[VertexTable, list[str]]:
    """Read the vertices of a PLY file, text or binary of any byte order.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    table : structured ndarray
        One record per vertex, its fields named as the properties.
    comments : list of str
        Of the header, without the word "comment".

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It is no PLY file, ends too early, or has lists as vertex properties or elements before the vertices.
    """
    with path.open("rb") as stream:
        order, count, kinds, comments = _header(stream)
        dtype = np.dtype([(name, (order if order != "=" else "<") + kind) for name, kind in kinds])
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
    while line := stream.readline(_LONGEST_LINE):
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
