"""Pages and scripts are run once for each state of the sources; their files are kept in build/docs.

So the tests and the site share what either has run first.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from docs.generate.pages import DOCS, ROOT, PageError, run_page

PLACE = ROOT / "build" / "docs"
PICTURES = PLACE / "pictures"
SOURCES = ("fpplab", "drivers", "sim", "configs", "examples", "docs")
GALLERY = sorted(p for p in (ROOT / "examples" / "gallery").glob("*.py") if p.stem != "bench")
"""Scripts of which each makes one picture."""


def run_once(page: Path) -> Path:
    """Run a page unless it was, and keep its pictures for the site.

    Parameters
    ----------
    page : Path
        Markdown.

    Returns
    -------
    Path
        The folder that it has left.

    Raises
    ------
    PageError
        The page shows what does not happen, or a picture that its code does not make.
    """
    with _state_of_now():
        folder = run_page(page, PLACE / "pages", invoke)
    for name in pictures_of(page):
        if not (folder / name).is_file():
            raise PageError(f"{page.relative_to(DOCS)}: its code makes no {name}")
        target = PICTURES / page.relative_to(DOCS).with_suffix("") / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / name, target)
    return folder


def verdict_of(script: Path) -> str:
    """Run a script of the gallery unless it was, and keep its picture for the site.

    Parameters
    ----------
    script : Path
        One of `GALLERY`.

    Returns
    -------
    str
        What it printed: the verdict.

    Raises
    ------
    PageError
        It failed.
    """
    with _state_of_now():
        picture, said = PICTURES / "gallery" / f"{script.stem}.png", PLACE / "gallery" / f"{script.stem}.txt"
        if not said.is_file():
            for path in (picture, said):
                path.parent.mkdir(parents=True, exist_ok=True)
            command = [sys.executable, str(script), str(picture)]
            done = subprocess.run(command, capture_output=True, text=True, check=False, env=_environment())
            if done.returncode:
                raise PageError(f"{script.relative_to(ROOT)}: {done.stderr}")
            said.write_text(done.stdout, encoding="utf-8")
        return said.read_text(encoding="utf-8")


def pictures_of(page: Path) -> list[str]:
    """Give the names of the pictures that a page's code makes, and that this or another page shows.

    Parameters
    ----------
    page : Path
        Markdown.

    Returns
    -------
    list of str
        As its code saves them.
    """
    name = re.escape(page.relative_to(DOCS).with_suffix("").as_posix())
    text = "".join(one.read_text(encoding="utf-8") for one in sorted(DOCS.rglob("*.md")))
    return sorted(set(re.findall(rf"\]\((?:\.\./)*generated/{name}/([\w.-]+)\)", text)))


def invoke(words: list[str]) -> tuple[int, str, str]:
    """Run a command of fpplab in the present folder.

    Parameters
    ----------
    words : list of str
        What follows `fpplab`.

    Returns
    -------
    code : int
        Exit code.
    out, err : str
        What it prints.
    """
    command = [sys.executable, "-m", "fpplab", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=_environment())
    return done.returncode, done.stdout, done.stderr


def _environment() -> dict[str, str]:
    """Of a process that uses this checkout, and has no screen."""
    return {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT), "DISPLAY": "", "COLUMNS": "100"}


@contextmanager
def _state_of_now() -> Iterator[None]:
    """What was run with other sources is removed first; several processes may run pages."""
    PLACE.mkdir(parents=True, exist_ok=True)
    with (PLACE / "lock").open("a+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        made = PLACE / "made_of"
        if not made.is_file() or made.read_text(encoding="utf-8") != _state():
            for name in ("pages", "pictures", "gallery"):
                shutil.rmtree(PLACE / name, ignore_errors=True)
            made.write_text(_state(), encoding="utf-8")
    yield


@cache
def _state() -> str:
    """A number that changes with all that pages and pictures are made of."""
    found = hashlib.sha256()
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".md", ".yaml") and "__pycache__" not in path.parts:
                found.update(path.read_bytes())
    return found.hexdigest()
