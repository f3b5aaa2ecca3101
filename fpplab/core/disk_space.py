"""Disk space: what a command needs is checked and reported before it writes anything."""

import logging
import shutil
from contextlib import suppress
from pathlib import Path

from fpplab.core.errors import DataError
from fpplab.core.files import writing
from fpplab.core.units import readable_bytes

_log = logging.getLogger(__name__)


def need_space(folder: Path, needed: int, what: str, freed: int = 0) -> None:
    # A GiB and more is logged as a warning, which is printed in any case, less as information.
    place = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    with writing(folder):
        free = shutil.disk_usage(place).free + freed
    if needed > free:
        raise DataError(
            f"{folder}: {what} need {readable_bytes(needed)}, but only {readable_bytes(free)} are free "
            "there; free some space, or name an output on another disk"
        )
    _log.log(
        logging.WARNING if needed >= 1 << 30 else logging.INFO,
        "%s: %s take %s; %s are free there",
        folder,
        what,
        readable_bytes(needed),
        readable_bytes(free),
    )


def disk_bytes(folder: Path) -> int:
    total = 0
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):  # another process has deleted it
            status = path.lstat()
            blocks: int | None = getattr(status, "st_blocks", None)  # Windows does not count them
            total += status.st_size if blocks is None else blocks * 512
    return total
