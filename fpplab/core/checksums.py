"""Checksums of a session's texts: a journal with one line for every content that was written."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

from fpplab.core.errors import DataError
from fpplab.core.files import write_text, writing
from fpplab.core.journals import append_line, cut_torn_line, whole_lines
from fpplab.core.session_names import CHECKSUMS
from fpplab.core.strict_json import parse_object


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
