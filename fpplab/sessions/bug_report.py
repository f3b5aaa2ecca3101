"""A ZIP file with what somebody else needs to see what went wrong, and a list of what is in it."""

import json
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from fpplab.core.errors import ConfigError, DataError, FppError
from fpplab.core.files import open_regular, write_atomic
from fpplab.core.host import host_facts
from fpplab.core.session_names import (
    CALIBRATION,
    CHECKSUMS,
    FORMAT,
    FRAMES,
    JOURNAL,
    LOG,
    ORIGIN,
    PLAN,
    RIG,
    VERDICT,
)
from fpplab.core.units import readable_bytes
from fpplab.sessions.inspection import session_faults
from fpplab.sessions.limits import SESSION_LIMITS as LIMITS

SMALL = {
    FORMAT: "version of the session's format",
    PLAN: "plan",
    RIG: "rig as resolved",
    ORIGIN: "when, where and with which devices",
    LOG: "what was done with it",
    JOURNAL: "a line for each frame",
    CHECKSUMS: "checksums of the small files",
    CALIBRATION: "calibration",
    VERDICT: "verdict and findings",
}


@dataclass(frozen=True)
class ReportEntry:
    """A file in a bug report."""

    name: str  # in the ZIP file
    content: bytes  # what it holds
    what: str  # what it is, as text

    @property
    def size(self) -> int:
        return len(self.content)


def write_bug_report(out: Path, sources: Sequence[Path], frames: bool) -> list[ReportEntry]:
    entries = [_host()]
    for number, source in enumerate(sources, 1):
        entries += (
            _session_entries(source, number, frames) if source.is_dir() else [_file_entry(source, number)]
        )
    listed = [_contents_entry(entries), *entries]

    def write(stream: BinaryIO) -> None:
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for entry in listed:
                archive.writestr(zipfile.ZipInfo(entry.name), entry.content, zipfile.ZIP_DEFLATED)

    write_atomic(out, write)
    return listed


def _host() -> ReportEntry:
    facts = json.dumps(host_facts(), indent=1).encode()
    return ReportEntry("host.json", facts, "versions of fpplab and its packages, and the computer")


def _contents_entry(entries: Sequence[ReportEntry]) -> ReportEntry:
    lines = [f"{entry.name}  ({entry.size} bytes): {entry.what}" for entry in entries]
    text = "What is in this bug report of fpplab; look through it before you send it.\n\n" + "\n".join(lines)
    return ReportEntry("contents.txt", f"{text}\n".encode(), "this list")


def _session_entries(path: Path, number: int, frames: bool) -> Iterator[ReportEntry]:
    folder = f"{number}_{path.resolve().name}"
    taken = dict(SMALL)
    if frames and not (path / FRAMES).is_symlink():
        taken |= {f"{FRAMES}/{file.name}": "a frame" for file in sorted((path / FRAMES).glob("*.tif"))}
    files = [path / name for name in taken if (path / name).is_file() and not (path / name).is_symlink()]
    size = sum(file.stat().st_size for file in files)
    if size > LIMITS.max_report_bytes:
        raise ConfigError(
            f"{path}: {readable_bytes(size)} would go into the bug report, more than "
            f"{readable_bytes(LIMITS.max_report_bytes)}; send its frames by themselves"
        )
    for file in files:
        name = file.relative_to(path).as_posix()
        yield ReportEntry(f"{folder}/{name}", _read(file), taken[name])
    yield ReportEntry(f"{folder}/verified.txt", _verified(path), "what is wrong with the session's files")


def _verified(path: Path) -> bytes:
    try:
        links = [file.relative_to(path) for file in sorted(path.rglob("*")) if file.is_symlink()]
        messages = [f"{name} is a symbolic link, which is not followed" for name in links]
        if not links:  # a message could quote what one leads to
            messages = [fault.message for fault in session_faults(path)] or ["nothing is damaged"]
    except FppError as error:
        messages = [str(error)]
    return ("\n".join(messages) + "\n").encode()


def _file_entry(path: Path, number: int) -> ReportEntry:
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file or session")
    if path.stat().st_size > LIMITS.max_attachment_bytes:
        raise ConfigError(
            f"{path}: is larger than {LIMITS.max_attachment_bytes >> 20} MB; shorten it, or send it by itself"
        )
    return ReportEntry(f"{number}_{path.name}", _read(path), "a file that was named")


def _read(path: Path) -> bytes:
    try:
        with open_regular(path) as stream:
            return stream.read()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
