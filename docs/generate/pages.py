"""Run the code of a documentation page, and compare what it prints with what the page shows.

A page is Markdown. In the order of the page, and in one working folder:

* ``console`` blocks have lines ``$ fpplab …``, each followed by what it prints. Numbers may differ by a
  tenth, and a line ``…`` stands for any lines. Behind a command that fails stand what it prints on stderr,
  and ``[exit code 4]``.
* ``python`` blocks share their names.
* ``yaml`` and ``python`` blocks whose first line is ``# NAME.yaml`` or ``# NAME.py`` are saved under that
  name.

All other blocks (``sh``, ``text``, ``toml``) are for reading. The front matter ``begins_after: PAGE``
starts a page in a copy of the folder that another one has left.
"""

import fcntl
import hashlib
import os
import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
SOURCES = ("fpplab", "drivers", "sim", "configs", "docs/generate")
OMITTED = "…"
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?")
TOLERANCE = 0.1
"""Share by which a number may differ from that of the page: other processors round otherwise."""
READ_ONLY = ("sh", "powershell", "text", "toml", "matlab", "")
"""Languages that are not run."""

Invoke = Callable[[list[str]], tuple[int, str, str]]
"""Runs `fpplab WORDS` in the present folder; gives its exit code, stdout and stderr."""


class PageError(Exception):
    """A page shows what does not happen."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page.

    Attributes
    ----------
    language : str
        What stands behind the fence.
    text : str
        Its lines, without the indentation of the fence.
    line : int
        Of its first line in the page.
    """

    language: str
    text: str
    line: int

    @property
    def file_name(self) -> str | None:
        """The name under which it is saved; None if it is none."""
        found = re.match(r"# ([\w-]+\.(?:yaml|py))$", self.text.partition("\n")[0])
        return found[1] if found else None


def blocks(page: Path) -> list[Block]:
    """Give the fenced blocks of a page.

    Parameters
    ----------
    page : Path
        Markdown.

    Returns
    -------
    list of Block
        In order.
    """
    found, inside = list[Block](), False
    indent, language, begin = "", "", 0
    lines = page.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, 1):
        fence = re.match(r"( *)```(\w*)", line)
        if fence and not inside:
            inside, indent, language, begin = True, fence[1], fence[2], number + 1
        elif fence:
            text = [one.removeprefix(indent) for one in lines[begin - 1 : number - 1]]
            found.append(Block(language, "\n".join(text) + "\n", begin))
            inside = False
    return found


def front_matter(page: Path) -> dict[str, Any]:
    """Give what a page says of itself at its head.

    Parameters
    ----------
    page : Path
        Markdown.

    Returns
    -------
    dict
        Empty where it says nothing.
    """
    found = re.match(r"---\n(.*?)\n---\n", page.read_text(encoding="utf-8"), re.S)
    return dict(yaml.safe_load(found[1])) if found else {}


def commands(block: Block) -> Iterator[tuple[str, list[str]]]:
    """Give each command of a console block with the lines that it prints.

    Parameters
    ----------
    block : Block
        Of the language `console`.

    Yields
    ------
    command : str
        What stands behind `$ `; a backslash at the end of a line joins the next one.
    shown : list of str
        The lines below it.
    """
    text = re.sub(r"\\\n\s*", "", block.text)
    for part in re.split(r"^\$ ", text, flags=re.M)[1:]:
        command, *shown = part.rstrip("\n").split("\n")
        yield command.partition("  #")[0].strip(), shown


def plain(line: str) -> str:
    """Give a line without its numbers and the frames of tables.

    Parameters
    ----------
    line : str
        As printed.

    Returns
    -------
    str
        With `#` for each number.
    """
    return re.sub(r"[\s─━│┃┏┓┡┩┳╇└┘┴├┤┼]+", " ", NUMBER.sub("#", line)).strip()


def line_fits(shown: str, printed: str) -> bool:
    """Tell whether a line is that of the page: the same words, and numbers within `TOLERANCE`.

    Parameters
    ----------
    shown, printed : str
        Line of the page, and of the command. Numbers may also differ by one in the last digit shown, and in
        lines that begin with `seconds` by anything.

    Returns
    -------
    bool
        Whether they agree.
    """
    if plain(shown) != plain(printed):
        return False
    pairs = zip(NUMBER.finditer(shown), NUMBER.finditer(printed), strict=True)
    return shown.startswith("seconds") or all(
        abs(float(mine[0]) - float(theirs[0])) <= max(TOLERANCE * float(mine[0]), _last_digit(mine[0]))
        for mine, theirs in pairs
    )


def _last_digit(number: str) -> float:
    """The unit of the last digit: 0.1 of 3.9, 1 of 52."""
    mantissa, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])) * (1 + 1e-9)


def fits(shown: list[str], printed: list[str]) -> bool:
    """Tell whether the lines are those of the page, in order, any where the page leaves some out.

    Parameters
    ----------
    shown, printed : list of str
        Lines of the page, and of the command.

    Returns
    -------
    bool
        Whether they agree.
    """
    if not shown:
        return not printed
    if shown[0] == OMITTED:
        return any(fits(shown[1:], printed[begin:]) for begin in range(len(printed) + 1))
    return bool(printed) and line_fits(shown[0], printed[0]) and fits(shown[1:], printed[1:])


@dataclass
class PageRun:
    """A page as it is run.

    Attributes
    ----------
    page : Path
        Markdown.
    folder : Path
        Where its files are, and where its commands run.
    invoke : callable
        Runs a command.
    seen : list of str
        The languages of the blocks that were run.
    """

    page: Path
    folder: Path
    invoke: Invoke
    seen: list[str] = field(default_factory=list)
    _names: dict[str, Any] = field(default_factory=lambda: {"__name__": "__page__"})

    def run(self) -> None:
        """Run all blocks in order.

        Raises
        ------
        PageError
            A command fails or prints something else, or Python raises; it names page and line.
        """
        with _working_in(self.folder):
            for block in blocks(self.page):
                self._run(block)

    def _run(self, block: Block) -> None:
        if block.file_name:
            Path(block.file_name).write_text(block.text, encoding="utf-8")
        elif block.language == "console":
            for command, shown in commands(block):
                self._command(block, command, shown)
        elif block.language == "python":
            self._python(block)
        else:
            return
        self.seen.append(block.language)

    def _command(self, block: Block, command: str, shown: list[str]) -> None:
        program, *words = shlex.split(command)
        if program != "fpplab":
            raise PageError(f"{self._place(block)}: '{program}' is not run here; use an `sh` block")
        failing = re.fullmatch(r"\[exit code (\d+)\]", shown[-1]) if shown else None
        code, out, err = self.invoke(words)
        expected, printed = (shown[:-1], err) if failing else (shown, out)
        if code != (int(failing[1]) if failing else 0):
            raise PageError(f"{self._place(block)}: `{command}` ends with {code}:\n{out}{err}")
        if expected and not fits(expected, printed.splitlines()):
            page = "\n".join(expected)
            raise PageError(f"{self._place(block)}: `{command}` prints\n{printed}\nnot\n{page}")

    def _python(self, block: Block) -> None:
        try:
            exec(compile("\n" * (block.line - 1) + block.text, str(self.page), "exec"), self._names)
        except Exception as error:
            raise PageError(f"{self._place(block)}: {type(error).__name__}: {error}") from error

    def _place(self, block: Block) -> str:
        return f"{self.page.relative_to(DOCS)}, line {block.line}"


def run_page(page: Path, folders: Path, invoke: Invoke) -> Path:
    """Run a page in a folder of its own, after the page that it begins after.

    Parameters
    ----------
    page : Path
        Markdown.
    folders : Path
        Where the folders of pages are. One of the same state of the sources is not made again; those of other
        states are removed. Another process that runs the same page is waited for.
    invoke : callable
        Runs a command.

    Returns
    -------
    Path
        The folder that the page has left.

    Raises
    ------
    PageError
        A command fails or prints something else, or Python raises.
    """
    name = page.relative_to(DOCS).with_suffix("").as_posix().replace("/", "__")
    chain = chain_of(page)
    with alone(folders / f".{name}.lock"):
        folder = folders / f"{name}.{state_of(*chain)}"
        if not folder.is_dir():
            for old in (*folders.glob(f"{name}.*"), draft := folders / f".{name}.draft"):
                shutil.rmtree(old, ignore_errors=True)
            if len(chain) > 1:
                shutil.copytree(run_page(chain[1], folders, invoke), draft)
            else:
                draft.mkdir()
            PageRun(page, draft, invoke).run()
            draft.rename(folder)
    return folder


def chain_of(page: Path) -> list[Path]:
    """Give a page and those that are run before it.

    Parameters
    ----------
    page : Path
        Markdown.

    Returns
    -------
    list of Path
        The page first.
    """
    before = front_matter(page).get("begins_after")
    return [page, *(chain_of(DOCS / before) if before else ())]


def state_of(*files: Path) -> str:
    """Give a word that changes with these files and with all sources that pages are made by.

    Parameters
    ----------
    *files : Path
        Pages or scripts.

    Returns
    -------
    str
        Hexadecimal digits.
    """
    found = hashlib.sha256(_sources())
    for path in files:
        found.update(path.read_bytes())
    return found.hexdigest()[:12]


@cache
def _sources() -> bytes:
    found = hashlib.sha256()
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".yaml") and "__pycache__" not in path.parts:
                found.update(path.read_bytes())
    return found.digest()


@contextmanager
def alone(lock: Path) -> Iterator[None]:
    """Wait until no other process is in this section.

    Parameters
    ----------
    lock : Path
        File that stands for it; its folder is made.
    """
    lock.parent.mkdir(parents=True, exist_ok=True)
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def _working_in(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
