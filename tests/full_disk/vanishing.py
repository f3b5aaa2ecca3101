"""A scan whose disk is gone from one moment to the next, and back later with what was flushed to it."""

import fcntl
import os
import shutil
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.crash.bench import bench_is_safe
from benchmarks.crash.content import content_of
from benchmarks.crash.programs import DisturbedProgram, note_of, start
from fpplab.core.errors import FppError
from fpplab.core.journals import whole_lines
from fpplab.core.session_names import JOURNAL
from fpplab.sessions.session import Session

SHUT_DOWN = 0x8004587D
"""Linux: the file system ends at once; every later access fails with EIO."""
WITHOUT_FLUSHING = struct.pack("I", 2)
BYTES = 64 << 20


class LoopDisk:
    """A file system in a file, which can vanish as a server does."""

    def __init__(self, image: Path, place: Path) -> None:
        self._image, self.place = image, place
        with image.open("wb") as file:
            file.truncate(BYTES)
        _system("mkfs.ext4", "-q", "-F", image)
        place.mkdir()

    @contextmanager
    def mounted(self) -> Iterator[Path]:
        """The disk, for as long as the context lasts."""
        _system("mount", "-o", "loop", self._image, self.place)
        try:
            yield self.place
        finally:
            _system("umount", "-l", self.place)

    def vanish(self) -> None:
        """From now on nothing on it can be read or written."""
        handle = os.open(self.place, os.O_RDONLY)
        try:
            fcntl.ioctl(handle, SHUT_DOWN, WITHOUT_FLUSHING)
        finally:
            os.close(handle)


def can_vanish(folder: Path) -> bool:
    """Whether this process may mount such a disk."""
    folder.mkdir(parents=True)
    try:
        disk = LoopDisk(folder / "image", folder / "disk")
        with disk.mounted():
            disk.vanish()
    except (OSError, subprocess.CalledProcessError):
        return False
    return True


def vanishing_disks(folder: Path, program: DisturbedProgram, times: int, seed: int) -> Iterator[str]:
    """Run a scan so many times on a disk that vanishes at a random moment; what is wrong each time.

    `folder` holds what `prepare` of the crash benchmark writes.
    """
    disk, random = LoopDisk(folder / "image", folder / "disk"), np.random.default_rng(seed)
    out, begun = disk.place / "out", time.monotonic()
    with disk.mounted():
        _end(program, folder, out)
        expected = content_of(out)
    seconds = time.monotonic() - begun
    for _ in range(times):
        with disk.mounted():
            shutil.rmtree(out)
        yield "; ".join(_trial(folder, program, disk, random.uniform(0.2, 1.0) * seconds, expected))


def _trial(
    folder: Path, program: DisturbedProgram, disk: LoopDisk, moment_s: float, expected: dict[str, str]
) -> Iterator[str]:
    out = disk.place / "out"
    note = note_of(folder / "out")
    with disk.mounted():
        process = start(program, folder, out, note=note)
        time.sleep(moment_s)
        known = whole_lines(out / JOURNAL) if (out / JOURNAL).exists() else []
        disk.vanish()
        _, said = process.communicate()
    here = f"gone after {moment_s:.2f} s with {len(known)} frames"
    if process.returncode not in (0, 3, 4) or "Traceback" in said:
        yield f"{here}: exit {process.returncode}: {said[-400:]}"
    if not bench_is_safe(note):
        yield f"{here}: the bench is not left safe"
    with disk.mounted():
        try:
            session = Session.open(out) if (out / JOURNAL).exists() else None
            kept = [session.read(record.index) for record in session.records] if session else []
        except FppError as error:
            yield f"{here}: cannot be read afterwards: {error}"
            return
        if len(kept) < len(known) - 1:  # the last line may not have been acknowledged when it was seen
            yield f"{here}: {len(kept)} frames are left"
        code, said = _end(program, folder, out)
        if code != 0 and "exists already" not in said:
            yield f"{here}: the same command ends with {code}: {said[-400:]}"
        elif (now := content_of(out)) != expected:
            apart = sorted(name for name in {*now, *expected} if now.get(name) != expected.get(name))
            yield f"{here}: completed, it differs in {', '.join(apart)}"


def _end(program: DisturbedProgram, folder: Path, out: Path) -> tuple[int, str]:
    """Run a program undisturbed; its exit code and what it says."""
    note_of(folder / "out").parent.mkdir(exist_ok=True)
    process = start(program, folder, out, note=note_of(folder / "out"))
    _, said = process.communicate()
    return process.returncode, said


def _system(*words: object) -> None:
    subprocess.run(list(map(str, words)), check=True, capture_output=True)
