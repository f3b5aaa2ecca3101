"""What a session is, and all that is wrong with it, where reading stops at the first fault."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.calibration.model import Calibration
from fpplab.clouds import load_cloud
from fpplab.core import config
from fpplab.core.checksums import recorded_files
from fpplab.core.disk_space import disk_bytes
from fpplab.core.errors import ConfigError, FppError
from fpplab.core.progress import Progress, no_progress
from fpplab.core.session_names import (
    CALIBRATION,
    CHECKSUMS,
    CLOUD,
    DECODED,
    FORMAT,
    JOURNAL,
    ORIGIN,
    PLAN,
    REPORT,
    RIG,
    VERDICT,
)
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.sessions.folder import why_no_session
from fpplab.sessions.format import check_format, session_format
from fpplab.sessions.frame_files import read_frame
from fpplab.sessions.journal import FrameRecord, readable_lines
from fpplab.sessions.origin import session_origin, taken_at
from fpplab.sessions.rig_record import read_rig
from fpplab.sessions.session import Session

RESULTS = (DECODED, CLOUD, CALIBRATION, VERDICT, REPORT)


@dataclass(frozen=True)
class SessionFault:
    """One thing that is wrong with a session."""

    file: str  # relative to the session
    message: str  # what is wrong with it, in a sentence


def describe_session(session: Session) -> dict[str, Any]:
    origin, times = session_origin(session.path), taken_at(session)
    return {
        "session": str(session.path),
        "format": session_format(session.path),
        "frames": len(session.records),
        "missing": session.missing(),
        "images": session.plan.frames,
        "size": list(session.format[:2]) if session.records else None,
        "bits": session.bits if session.records else None,
        "imported": session.is_imported,
        "rig": (session.rig() or {}).get("name"),
        "taken": [str(time) for time in times] if times else None,
        "origin": origin.model_dump(mode="json") if origin else None,
        "results": [name for name in RESULTS if (session.path / name).is_file()],
        "bytes": disk_bytes(session.path),
    }


def session_faults(path: Path, progress: Progress = no_progress) -> list[SessionFault]:
    if not (path / JOURNAL).is_file() and not (path / PLAN).is_file():
        raise ConfigError(why_no_session(path))
    faults: list[SessionFault] = []
    for name, read in _small_files(path).items():
        with _noted(faults, path, name):
            read()
    plan = None
    with _noted([], path, PLAN):
        plan = config.load_document(path / PLAN, Plan)
    if (path / JOURNAL).is_file():
        lines = readable_lines(path, plan)
        faults += [SessionFault(JOURNAL, message) for message in lines.faults]
        records = list(lines.records.values())
        faults += list(frame_faults(path, records, progress))
    else:
        faults.append(SessionFault(JOURNAL, f"{path / JOURNAL}: is gone"))
    for name, read in _results(path).items():
        if (path / name).exists():
            with _noted(faults, path, name):
                read()
    return faults


def frame_faults(
    path: Path, records: list[FrameRecord], progress: Progress = no_progress
) -> Iterator[SessionFault]:
    for done, record in enumerate(records, 1):
        faults: list[SessionFault] = []
        with _noted(faults, path, record.file):
            read_frame(path / record.file, record, verify=True)
        yield from faults
        progress(done / len(records))


def _small_files(path: Path) -> dict[str, Callable[[], object]]:
    return {
        CHECKSUMS: lambda: recorded_files(path),
        FORMAT: lambda: check_format(path),
        PLAN: lambda: config.load_document(path / PLAN, Plan),
        RIG: lambda: read_rig(path),
        ORIGIN: lambda: session_origin(path),
    }


def _results(path: Path) -> dict[str, Callable[[], object]]:
    return {
        DECODED: lambda: Decoded.load(path / DECODED),
        CLOUD: lambda: load_cloud(path / CLOUD),
        CALIBRATION: lambda: Calibration.load(path / CALIBRATION),
        VERDICT: lambda: config.parse_yaml(config.read_text(path / VERDICT), path / VERDICT),
    }


@contextmanager
def _noted(faults: list[SessionFault], path: Path, name: str) -> Iterator[None]:
    try:
        yield
    except FppError as error:
        if all(fault.message != str(error) for fault in faults):
            faults.append(SessionFault(name, str(error)))
    except OSError as error:
        faults.append(SessionFault(name, f"{path / name}: cannot be read ({error.strerror})"))
