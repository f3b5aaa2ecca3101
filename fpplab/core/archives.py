"""NPZ files of strangers: what they declare to unpack to is believed only in proportion to their size."""

from __future__ import annotations

import zipfile
from pathlib import Path

from fpplab.core.files import open_regular, readable_bytes

ALWAYS_ALLOWED = 256_000_000
"""Bytes that any archive may unpack to."""
GREATEST_RATIO = 100
"""By how many times a greater one may grow; recorded images and maps grow by less than ten."""


def check_archive(archive: zipfile.ZipFile, size: int) -> None:
    """Refuse an archive that unpacks to far more than recorded data would, before any of it is unpacked.

    Parameters
    ----------
    archive : ZipFile
        Open.
    size : int
        Bytes of its file.

    Raises
    ------
    ValueError
        It would unpack to more than `ALWAYS_ALLOWED` and `GREATEST_RATIO` times its own size.
    """
    unpacked = sum(member.file_size for member in archive.infolist())
    if unpacked > max(ALWAYS_ALLOWED, GREATEST_RATIO * size):
        raise ValueError(
            f"{readable_bytes(size)} that unpack to {readable_bytes(unpacked)}, more than {GREATEST_RATIO} "
            "times as much; save it without compression"
        )


def check_npz(path: Path) -> None:
    """Refuse an NPZ file as `check_archive` does.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    ValueError
        It is too large for its size.
    OSError, zipfile.BadZipFile
        It cannot be read.
    """
    with open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
        check_archive(archive, path.stat().st_size)
