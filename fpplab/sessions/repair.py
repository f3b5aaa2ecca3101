"""A damaged session made readable again: what is whole is kept, what is lost is named, nothing is deleted.

A damaged file stays until the one that replaces it is on disk, so that a repair can be made again.
"""

import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from fpplab.core import config
from fpplab.core.checksums import RecordedFile, recorded_files
from fpplab.core.errors import DataError, FppError
from fpplab.core.files import read_bounded, write_text, writing
from fpplab.core.journals import whole_lines
from fpplab.core.progress import Progress, no_progress
from fpplab.core.session_names import CHECKSUMS, FORMAT, JOURNAL, PLAN, RIG
from fpplab.patterns.plan import Plan
from fpplab.sessions.folder import remove_incomplete_files
from fpplab.sessions.format import present_format, upgrade_format
from fpplab.sessions.inspection import frame_faults, session_faults
from fpplab.sessions.journal import readable_lines
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.log import begin_session_log
from fpplab.sessions.session import Session


@dataclass
class RepairReport:
    """What a repair found and did."""

    kept: int = 0  # frames that are whole
    restored: list[str] = field(default_factory=list)  # files that were rewritten, and from what
    lost: list[str] = field(default_factory=list)  # what is lost, in sentences
    aside: list[str] = field(default_factory=list)  # where damaged files are now

    @property
    def is_unchanged(self) -> bool:
        return not (self.restored or self.lost or self.aside)


def repair_session(path: Path, progress: Progress = no_progress) -> RepairReport:
    with exclusive_write(path):
        report = RepairReport()
        if not session_faults(path):
            report.kept = len(Session.open(path).records)
            return report
        begin_session_log(path)
        _restore_small_files(path, report)
        _restore_journal(path, _plan_of(path), report, progress)
        remove_incomplete_files(path)
        for fault in session_faults(path):  # what is left are results, which can be made again
            if (path / fault.file).is_file():
                _set_aside(path, fault.file, report)
            report.lost.append(fault.message)
        upgrade_format(path)
        Session.open(path)
    return report


def _restore_small_files(path: Path, report: RepairReport) -> None:
    kept = list(_readable_records(path, report))
    newest = {record.file: record for record in kept if record.is_whole}
    for name in (PLAN, RIG, FORMAT):
        copy = newest.get(name)
        if copy is None or copy.text is None or _holds(path / name, copy.text):
            continue
        _replace_session_file(path, name, copy.text, report)
        report.restored.append(f"{name}, from its copy in {CHECKSUMS}")


def _readable_records(path: Path, report: RepairReport) -> Iterable[RecordedFile]:
    try:
        return recorded_files(path)
    except DataError as error:
        report.lost.append(f"{error}; the checksums in it can no longer be verified")
        records = list(_renewed_records(path))
        _replace_session_file(path, CHECKSUMS, "".join(f"{record.line}\n" for record in records), report)
        report.restored.append(CHECKSUMS)
        return records


def _renewed_records(path: Path) -> Iterator[RecordedFile]:
    """What is whole of a damaged record, and new records of the files that it lacks."""
    kept: set[str] = set()
    for line in whole_lines(path / CHECKSUMS):
        with suppress(ValueError):
            record = RecordedFile.of_line(line)
            if record.is_whole:
                kept.add(record.file)
                yield record
    for name in sorted({PLAN, RIG} - kept):
        with suppress(OSError, UnicodeDecodeError):  # a file that cannot be read is no copy of itself
            text = read_bounded(path / name, config.MAX_TEXT_BYTES).decode("utf-8")
            yield RecordedFile.of_text(name, text)
    if FORMAT not in kept:
        yield RecordedFile.of_text(FORMAT, present_format())


def _holds(file: Path, text: str) -> bool:
    return file.is_file() and file.read_bytes() == text.encode("utf-8")


def _plan_of(path: Path) -> Plan:
    try:
        return config.load_document(path / PLAN, Plan)
    except FppError as error:
        raise DataError(
            f"{path}: cannot be repaired: its plan is lost, without which frames mean nothing "
            f"({error}); restore {PLAN} from a backup"
        ) from error


def _restore_journal(path: Path, plan: Plan, report: RepairReport, progress: Progress) -> None:
    if not (path / JOURNAL).is_file():
        raise DataError(f"{path}: cannot be repaired: its journal is missing, which says what its frames are")
    lines = readable_lines(path, plan)
    damaged = list(frame_faults(path, list(lines.records.values()), progress))
    bad = {fault.file for fault in damaged}
    whole = [record for record in lines.records.values() if record.file not in bad]
    report.kept = len(whole)
    report.lost += [*lines.faults, *(fault.message for fault in damaged)]
    for name in sorted(bad):  # before the journal forgets them
        if (path / name).exists():
            _set_aside(path, name, report)
    if lines.faults or bad:
        kept = "".join(json.dumps(record.model_dump()) + "\n" for record in whole)
        _replace_session_file(path, JOURNAL, kept, report)
        report.restored.append(f"{JOURNAL}, with the {len(whole)} frames that are whole")


def _replace_session_file(path: Path, name: str, text: str, report: RepairReport) -> None:
    if not (path / name).exists():
        write_text(path / name, text)
        return
    place = _place_aside(path, name)
    with writing(place):
        place.parent.mkdir(parents=True, exist_ok=True)
    try:
        with writing(place):
            shutil.copyfile(path / name, place)
        write_text(path / name, text)
    except BaseException:
        place.unlink(missing_ok=True)
        raise
    report.aside.append(str(place))


def _set_aside(path: Path, name: str, report: RepairReport) -> None:
    place = _place_aside(path, name)
    with writing(place):
        place.parent.mkdir(parents=True, exist_ok=True)
        (path / name).rename(place)
    report.aside.append(str(place))


def _place_aside(path: Path, name: str) -> Path:
    place = path.with_name(f"{path.name}.damaged") / name
    number = 1
    while place.exists():
        place = place.with_name(f"{Path(name).name}.{number}")
        number += 1
    return place
