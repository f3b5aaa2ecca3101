"""Checksums of the small files of a session, which decide what its frames mean.

`files.jsonl` beside them has a line for every content that was written, appended before the file is: a crash
between the two leaves a file that still has its own line. Whoever reads such a file compares. Sessions of
earlier versions have no such record, and are read as they are.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from fpplab.core.errors import DataError
from fpplab.core.files import append_line, cut_torn_line, whole_lines, write_text, writing
from fpplab.core.session_names import CHECKSUMS
from fpplab.core.strict_json import parse_object


def write_recorded(path: Path, text: str) -> None:
    """Write a text file of a session, and its checksum before it.

    Parameters
    ----------
    path : Path
        Of the file, whose folder exists.
    text : str
        The content.

    Raises
    ------
    DataError
        There is no space left or the place cannot be written.
    """
    record = path.parent / CHECKSUMS
    line = {"file": path.name, "sha256": hashlib.sha256(text.encode("utf-8")).hexdigest()}
    with writing(record):
        record.touch()
    cut_torn_line(record)
    append_line(record, json.dumps(line))
    write_text(path, text)


def check_recorded(path: Path, content: bytes) -> None:
    """Refuse a file that is not what its session wrote.

    Parameters
    ----------
    path : Path
        Of the file.
    content : bytes
        What it holds.

    Raises
    ------
    DataError
        Its folder records checksums of it, and none is its own; or the record is damaged.
    """
    known = _recorded(path.parent / CHECKSUMS, path.name)
    if known and hashlib.sha256(content).hexdigest() not in known:
        raise DataError(
            f"{path}: was changed since the session wrote it: its checksum is not in {CHECKSUMS}; put back "
            "the file as it was"
        )


def _recorded(record: Path, name: str) -> list[str]:
    """Checksums of everything that was written under a name."""
    if not record.is_file():
        return []
    known = []
    for number, line in enumerate(whole_lines(record), 1):
        try:
            entry = parse_object(line)
            file, sha256 = entry["file"], entry["sha256"]
        except (ValueError, TypeError, KeyError) as error:
            raise DataError(f"{record} line {number}: is not the checksum of a file") from error
        known += [sha256] if file == name else []
    return known
