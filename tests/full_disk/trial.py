"""One writing command on a disk with room for 0, 1, 2 … pages, until it has room enough."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fpplab.sessions.session import Session
from tests.full_disk.disks import PAGE, disk, resize
from tests.support.commands import Outcome, run

FULL, DONE = 4, 0
MOST_PAGES = 2000


@dataclass(frozen=True)
class Writing:
    """A command that writes on a disk.

    `prepare` fills the folder of a disk, of which the rest is the command's; `words` are the command, told
    that folder.
    """

    name: str
    prepare: Callable[[Path], object]
    words: Callable[[Path], list[object]]


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


def used_pages(folder: Path) -> int:
    """Pages that are taken."""
    usage = shutil.disk_usage(folder)
    return -(-usage.used // PAGE)


def try_every_size(writing: Writing, place: Path, step: int = 1) -> Iterator[str]:
    """Give the command 0, 1, 2 … pages; what is wrong each time it has been refused, and with the last."""
    with disk(place) as folder:
        writing.prepare(folder)
        kept, before = contents(folder), used_pages(folder)
        for pages in range(0, MOST_PAGES, step):
            resize(folder, before + pages)
            done = run(*writing.words(folder))
            if done.code == DONE:
                yield "" if pages else "needs no space at all"
                return
            yield _complaint(done, kept, folder, pages)
        yield f"is refused with {MOST_PAGES} pages too"


def _complaint(done: Outcome, kept: dict[str, bytes], folder: Path, pages: int) -> str:
    """What is wrong with a command that met a full disk; empty if nothing."""
    here, said = f"with {pages} pages: ", done.err.strip()
    if done.code != FULL:
        return f"{here}exit {done.code}: {said[-200:]}"
    if "no space left" not in said and "are free" not in said:
        return f"{here}does not say that the disk is full: {said[-200:]}"
    found = contents(folder)
    if damaged := [name for name, content in kept.items() if found.get(name) != content]:
        return f"{here}changed {damaged}"
    if drafts := [name for name in found if any(part.startswith(".") for part in Path(name).parts)]:
        return f"{here}left {drafts}"
    for journal in folder.rglob("journal.jsonl"):
        session = Session.open(journal.parent)
        for record in session.records:
            session.read(record.index)
    return ""
