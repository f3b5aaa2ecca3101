"""Versions of the format of sessions: which one a session has, and how it is brought to the present one.

=====  =====================================================================================================
1      Version 0.1.0: plan, rig, journal and frames. A session without `session.yaml` has this format.
2      `session.yaml`; checksums of the small files, and plan and rig once more, in `files.jsonl`.
=====  =====================================================================================================

Every version is read as it is. A session that is completed, or repaired, is brought to the present one first.
"""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from fpplab.core import config
from fpplab.core.checksums import recorded_files, write_recorded
from fpplab.core.config import Document
from fpplab.core.errors import DataError
from fpplab.core.session_names import CHECKSUMS, FORMAT, PLAN, RIG

PRESENT = 2  # the version of the format that is written


class SessionFormat(Document):
    """The file `session.yaml`."""

    format: Annotated[int, Field(ge=1)]
    """Version of the format."""


def session_format(path: Path) -> int:
    file = path / FORMAT
    if not file.exists():
        return 1
    version = config.load_document(file, SessionFormat).format
    if version > PRESENT:
        raise DataError(
            f"{path}: has format {version}, of a later version of fpplab; this one reads 1 to {PRESENT}, so "
            "update fpplab"
        )
    return version


def check_format(path: Path) -> None:
    version = session_format(path)
    if version > 1 and not (path / CHECKSUMS).is_file():
        raise DataError(f"{path}: {CHECKSUMS} is gone; `fpplab session repair` lists what is lost")
    recorded = {record.file for record in recorded_files(path)}
    for name in (FORMAT, PLAN, RIG):
        if name in recorded and not (path / name).exists():
            raise DataError(f"{path}: {name} is gone; `fpplab session repair` restores it")


def present_format() -> str:
    return config.dump(SessionFormat(format=PRESENT))


def write_format(path: Path) -> None:
    write_recorded(path / FORMAT, present_format(), keep=True)


def upgrade_format(path: Path) -> None:
    if session_format(path) == PRESENT:
        return
    for name in (PLAN, RIG):
        if (path / name).is_file():
            write_recorded(path / name, config.read_text(path / name), keep=True)
    write_format(path)
