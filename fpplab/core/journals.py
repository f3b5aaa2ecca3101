"""Journals, to which whole lines are appended; one of them has the checksums of a session's texts."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path

from fpplab.core.errors import DataError
from fpplab.core.files import read_bounded, write_text, writing
from fpplab.core.session_names import CHECKSUMS
from fpplab.core.strict_json import parse_object

MAX_JOURNAL_BYTES = 256_000_000  # greatest size in bytes of a journal (chosen): some 700,000 frames


def make_journal(path: Path) -> None:
    """Make an empty journal with its folder; an existing one stays as it is."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def append_line(path: Path, line: str) -> None:
    """Append one line to a journal, on disk before this returns."""
    # On an error the journal is as it was before.
    with writing(path):
        end = path.stat().st_size
        try:
            with path.open("ab") as stream:
                stream.write(line.encode("utf-8") + b"\n")
                stream.flush()
                os.fsync(stream.fileno())
        except BaseException:
            os.truncate(path, end)
            raise


def whole_lines(path: Path) -> list[bytes]:
    # What follows the last newline was cut off while it was written, and is left out.
    try:
        return read_bounded(path, MAX_JOURNAL_BYTES).split(b"\n")[:-1]
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error


def cut_torn_line(path: Path) -> None:
    # Searches backwards from the end of the file, which is not read as a whole.
    with writing(path):
        if path.stat().st_size == 0:  # which cannot be mapped
            return
        with path.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as text:
            end, whole_bytes = len(text), text.rfind(b"\n") + 1
        if whole_bytes < end:
            os.truncate(path, whole_bytes)


@dataclass(frozen=True)
class RecordedFile:
    """One line of the record: a content that was written."""

    file: str  # name of the file in the session's folder
    sha256: str  # checksum of the content
    text: str | None = None  # the content, where it is kept here too

    @classmethod
    def of_line(cls, line: bytes) -> RecordedFile:
        entry = parse_object(line)
        file, sha256, text = (entry.get(name) for name in ("file", "sha256", "text"))
        if not (isinstance(file, str) and isinstance(sha256, str) and isinstance(text, str | None)):
            raise ValueError("its 'file', 'sha256' and 'text' are not all texts")
        return cls(file, sha256, text)

    @classmethod
    def of_text(cls, file: str, text: str, keep: bool = True) -> RecordedFile:
        return cls(file, _sha256(text.encode("utf-8")), text if keep else None)

    @property
    def line(self) -> str:
        kept = {} if self.text is None else {"text": self.text}
        return json.dumps({"file": self.file, "sha256": self.sha256, **kept})

    @property
    def is_whole(self) -> bool:
        return self.text is not None and _sha256(self.text.encode("utf-8")) == self.sha256


def write_recorded(path: Path, text: str, keep: bool = False) -> None:
    """Write a text file of a session, and its checksum before it."""
    record = path.parent / CHECKSUMS
    written = RecordedFile.of_text(path.name, text, keep)
    with writing(record):
        record.touch()
    cut_torn_line(record)
    if written.sha256 not in _recorded(record, path.name):  # what goes on after a crash writes the same again
        append_line(record, written.line)
    write_text(path, text)


def check_recorded(path: Path, content: bytes) -> None:
    recorded = _recorded(path.parent / CHECKSUMS, path.name)
    if recorded and _sha256(content) not in recorded:
        raise DataError(
            f"{path}: was changed since the session wrote it: its checksum is not in {CHECKSUMS}; put back "
            "the file as it was"
        )


def recorded_files(folder: Path) -> list[RecordedFile]:
    record = folder / CHECKSUMS
    if not record.is_file():
        return []
    records = []
    for number, line in enumerate(whole_lines(record), 1):
        try:
            records.append(RecordedFile.of_line(line))
        except ValueError as error:
            raise DataError(f"{record} line {number}: is not the checksum of a file") from error
    return records


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _recorded(record: Path, name: str) -> list[str]:
    return [entry.sha256 for entry in recorded_files(record.parent) if entry.file == name]
