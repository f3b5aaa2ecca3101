"""Reading and writing the part of the PLY format that clouds need: scalar vertex properties and comments."""

from __future__ import annotations

from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.files import open_regular

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_NAMES = {"u1": "uchar", "i4": "int", "f4": "float", "f8": "double"}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_BLOCK = 1 << 16  # vertices that are written at a time (chosen)

VertexTable = NDArray[Any]  # a structured array, one record per vertex
TextRows = list[tuple[int, list[bytes]]]  # the values of lines, with the numbers of the lines


def write(columns: Mapping[str, NDArray[Any]], comments: list[str], stream: BinaryIO) -> None:
    # columns (N,)
    kinds = {name: values.dtype.str[1:] for name, values in columns.items()}
    vertices = len(next(iter(columns.values())))
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines += [f"element vertex {vertices}"]
    lines += [f"property {_NAMES[kind]} {name}" for name, kind in kinds.items()]
    stream.write(("\n".join([*lines, "end_header"]) + "\n").encode("ascii"))
    dtype = np.dtype([(name, "<" + kind) for name, kind in kinds.items()])
    with ThreadPoolExecutor(1) as writer:  # one half is written while the other is filled
        written: Future[int] | None = None
        halves = cycle(np.empty((2, _BLOCK), dtype))
        for start in range(0, vertices, _BLOCK):
            records = next(halves)[: min(_BLOCK, vertices - start)]
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


def read(path: Path) -> tuple[VertexTable, list[str]]:
    with open_regular(path) as stream:
        order, elements, comments, lines = _header(stream)
        place = next((i for i, element in enumerate(elements) if element.name == "vertex"), None)
        if place is None:
            raise ValueError("its header names no vertices")
        before, vertex, after = elements[:place], elements[place], elements[place + 1 :]
        if vertex.lists:
            raise ValueError(f"a vertex has the list '{vertex.lists[0]}' as property; export it without")
        dtype = np.dtype([(name, order + kind) for name, kind in vertex.kinds.items()])
        # The number of vertices is believed only where the file has room for them.
        remaining_bytes = path.stat().st_size - stream.tell()
        min_vertex_bytes = max(1, dtype.itemsize if order else 2 * len(vertex.kinds))
        if vertex.count * min_vertex_bytes > remaining_bytes + (not order):  # the last line may have no end
            raise ValueError(
                f"it ends after at most {remaining_bytes // min_vertex_bytes} of {vertex.count} vertices"
            )
        if not order:
            rows = numbered_rows(stream, lines + 1)
            if len(rows) != (announced := sum(element.count for element in elements)):
                raise ValueError(f"it has {len(rows)} lines of data, but its header announces {announced}")
            first = sum(element.count for element in before)
            return _parse(rows[first : first + vertex.count], vertex.kinds), comments
        return _read_binary(stream, before, vertex.count, dtype, any(e.count for e in after)), comments


def _read_binary(
    stream: BinaryIO, before: list[_Element], vertices: int, dtype: np.dtype[Any], more: bool
) -> VertexTable:
    for element in before:
        if element.lists and element.count:
            raise ValueError(
                f"element '{element.name}' comes before the vertices with lists; export points alone"
            )
        stream.seek(element.count * sum(np.dtype(kind).itemsize for kind in element.kinds.values()), 1)
    table = np.fromfile(stream, dtype, vertices)
    if len(table) != vertices:
        raise ValueError(f"it ends after {len(table)} of {vertices} vertices")
    if not more and (excess := len(stream.read())):
        raise ValueError(f"{excess} bytes follow its last vertex, of which its header says nothing")
    return table


@dataclass
class _Element:
    """What the header says of one kind of rows."""

    name: str
    count: int
    kinds: dict[str, str] = field(default_factory=dict)  # of the properties that are single numbers
    lists: list[str] = field(default_factory=list)


def _header(stream: BinaryIO) -> tuple[str, list[_Element], list[str], int]:
    """Read the byte order (none for text), the elements, the comments, and the number of lines."""
    order, elements, comments = None, list[_Element](), list[str]()
    start = stream.readline(1 << 12).removeprefix(BOM_UTF8)
    if start.startswith(b"ply\r") and start.strip() != b"ply":
        raise ValueError("its lines end in carriage returns alone; save it with line feeds")
    if b"\0" in start and start.replace(b"\0", b"").lstrip(BOM_UTF16_LE + BOM_UTF16_BE).startswith(b"ply"):
        raise ValueError("it is in UTF-16; save it in UTF-8")
    if start.strip() != b"ply":
        raise ValueError("it does not begin with 'ply'")
    # A line beyond 4096 bytes is read in parts, which are not understood.
    for number, line in enumerate(iter(lambda: stream.readline(1 << 12), b""), 2):
        place = f"line {number} of its header, '{line[:60].decode('utf-8', 'replace').strip()}',"
        match line.decode("utf-8", "replace").split():
            case ["format", name, "1.0"] if name in _ORDERS and order is None:
                order = _ORDERS[name]
            case ["comment" | "obj_info", *text]:
                comments.append(" ".join(text))
            case ["element", name, number_of] if number_of.isdecimal():
                if name in [element.name for element in elements]:
                    raise ValueError(f"{place} announces '{name}' a second time")
                elements.append(_Element(name, int(number_of)))
            case ["property", "list", _, _, *name] if elements and name:
                elements[-1].lists.append(" ".join(name))
            case ["property", kind, *name] if elements and name:
                if kind not in _TYPES:
                    raise ValueError(f"{place} has an unknown type; PLY has {', '.join(_TYPES)}")
                if " ".join(name) in elements[-1].kinds:
                    raise ValueError(f"{place} gives a name a second time")
                elements[-1].kinds[" ".join(name)] = _TYPES[kind]
            case ["end_header"]:
                if order is None:
                    raise ValueError("its header names no format")
                return order, elements, comments, number
            case [_, *_]:
                raise ValueError(f"{place} is not understood")
    raise ValueError("its header has no end")


def numbered_rows(stream: Iterable[bytes], first: int) -> TextRows:
    return [(number, values) for number, line in enumerate(stream, first) if (values := line.split())]


def check_widths(rows: TextRows, columns: int) -> None:
    for number, values in rows:
        if len(values) != columns:
            raise ValueError(f"line {number} has {len(values)} values instead of {columns}")


def parse_rows(rows: TextRows, columns: int) -> Floats:
    # returns (N, columns)
    check_widths(rows, columns)
    try:
        return np.array([values for _, values in rows], np.float64).reshape(len(rows), columns)
    except ValueError:
        for number, values in rows:
            for value in values:
                if not is_number(value):
                    text = value.decode("utf-8", "replace")[:40]
                    comma = "; write decimals with points" if b"," in value else ""
                    raise ValueError(f"line {number}: '{text}' is not a number{comma}") from None
        raise


def is_number(value: bytes) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def _parse(rows: TextRows, kinds: Mapping[str, str]) -> VertexTable:
    values = parse_rows(rows, len(kinds))
    table = np.empty(len(rows), np.dtype(list(kinds.items())))
    for column, (name, kind) in zip(values.T, kinds.items(), strict=True):
        if kind[0] != "f":
            limits = np.iinfo(kind)
            wrong = (column != np.rint(column)) | (column < limits.min) | (column > limits.max)
            if wrong.any():
                i = int(np.argmax(wrong))
                raise ValueError(
                    f"line {rows[i][0]}: {name} is {column[i]:g}, which must be a whole number "
                    f"{limits.min} … {limits.max}"
                )
        table[name] = column
    return table
