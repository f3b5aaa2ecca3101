"""Pages and scripts are run once for each state of the sources; their files are kept in build/docs.

So the tests and the site share what either has run first.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from docs.generate.pages import DOCS, ROOT, PageError, alone, run_page, state_of

PLACE = ROOT / "build" / "docs"
PICTURES = PLACE / "pictures"
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
    picture, made = PICTURES / "gallery" / f"{script.stem}.png", PLACE / "gallery"
    with alone(made / f".{script.stem}.lock"):
        said = made / f"{script.stem}.{state_of(script, script.parent / 'bench.py')}.txt"
        if not (said.is_file() and picture.is_file()):
            for old in made.glob(f"{script.stem}.*"):
                old.unlink()
            picture.parent.mkdir(parents=True, exist_ok=True)
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
