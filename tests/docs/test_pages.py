"""Every page of the documentation does what it shows."""

import re
import shlex
from functools import cache
from pathlib import Path

import pytest
import typer

from docs.generate.pages import (
    DOCS,
    OMITTED,
    READ_ONLY,
    ROOT,
    PageError,
    PageRun,
    blocks,
    commands,
    fits,
)
from docs.generate.reference import every_command
from docs.generate.running import invoke, run_once
from fpplab.cli.every import app

pytestmark = pytest.mark.timeout(1800)  # pages are run as they stand, some for minutes
PAGES = sorted(page for page in DOCS.rglob("*.md") if "decisions" not in page.parts)
TESTED_BY_THEMSELVES = {"first-day.md": "test_first_day.py", "write-a-driver.md": "test_write_a_driver.py"}
"""Pages of instruments that have to be emulated."""
RUN = [page for page in PAGES if page.name not in TESTED_BY_THEMSELVES]
ELSEWHERE = {
    "hardware.md",
    "set-up-live.md",
    "scan-with-a-screen.md",
    "images-from-elsewhere.md",
    "several-computers.md",
    "serve-a-rig.md",
}
"""Pages whose commands need instruments, other computers or recordings of others; that these have such
options is tested."""
NOT_OURS = (
    *("sudo", "python3", "make", "git", "pip", ".venv/bin/pip", ".venv/bin/python"),
    *("cd", "export", "mkdir", "chmod", "openssl"),
)
"""What the lines of `sh` blocks may begin with."""


def has_code(page: Path) -> bool:
    return any(block.language not in READ_ONLY for block in blocks(page))


@pytest.mark.nightly
@pytest.mark.parametrize("page", [*filter(has_code, RUN)], ids=lambda page: page.relative_to(DOCS).as_posix())
def test_each_page_does_what_it_shows(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    run_once(page)


@pytest.mark.nightly
def test_the_start_of_the_readme_runs_on_the_simulated_rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its five commands, and its Python on what they leave."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    parts = [block.text for block in blocks(ROOT / "README.md")]
    commands = [line.partition("  #")[0] for part in parts for line in part.splitlines()]
    run = [line.replace("rig.yaml", "rig_demo_quick") for line in commands if line.startswith("fpplab ")]
    assert len(run) == 5
    for line in run:
        code, _, err = invoke(shlex.split(line)[1:])
        assert code == 0, (line, err)
    (example,) = [part for part in parts if "import Calibration" in part]
    exec(example, {})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_all_commands_of_a_page_are_run(page: Path) -> None:
    """Blocks that are only read hold no command of fpplab but where it needs instruments."""
    for block in blocks(page):
        where = f"{page.name}, line {block.line}"
        assert block.language in (*READ_ONLY, "console", "python", "yaml"), where
        for line in block.text.splitlines() if block.language in READ_ONLY else ():
            if line.startswith("fpplab "):
                assert page.name in ELSEWHERE, f"{where}: {line}"
            if block.language == "sh":
                assert line.startswith((*NOT_OURS, "#", " ")), f"{where}: {line}"


@cache
def known_commands() -> dict[str, set[str]]:
    """By command, its options."""
    commands = {name: {o for p in one.params for o in p.opts} for name, one in every_command()}
    general = {o for p in typer.main.get_command(app).params for o in p.opts} | {"--help", "-h"}
    return {name: options | general for name, options in commands.items()} | {"": general}


def unknown_words(command: str) -> list[str]:
    """What of a command line there is not."""
    words = shlex.split(command.partition("  #")[0])[1:]
    first = [word for word in words if not word.startswith("-")]
    names = [name for name in known_commands() if name and first[: len(name.split())] == name.split()]
    if not names:
        groups = {name.split()[0] for name in known_commands() if " " in name}
        return [] if not first or first[0] in groups else [first[0]]
    options = known_commands()[max(names, key=len)]
    return [w for w in words if w.startswith("-") and w.partition("=")[0] not in options and len(w) > 1]


@pytest.mark.parametrize(
    "page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_commands_and_options_that_are_named_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = [" ".join(found.split()) for found in re.findall(r"`(fpplab [^`]+)`", text)]
    named += [
        line for block in blocks(page) for line in block.text.splitlines() if line.startswith("fpplab ")
    ]
    assert {command: unknown_words(command) for command in named if unknown_words(command)} == {}


def test_options_that_do_not_exist_are_noticed() -> None:
    assert unknown_words("fpplab scan --rig R --plann P") == ["--plann"]
    assert unknown_words("fpplab calibrate --rig R") == ["calibrate"]
    assert unknown_words("fpplab session info S") == []
    assert unknown_words("fpplab cache") == []


def test_a_page_that_is_wrong_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    monkeypatch.setattr("docs.generate.pages.DOCS", tmp_path)

    def outcome(text: str, answer: tuple[int, str, str] = (0, "a 1\n", "")) -> str:
        page.write_text(text, encoding="utf-8")
        try:
            PageRun(page, tmp_path, lambda words: answer).run()
        except PageError as error:
            return str(error)
        return ""

    console = "```console\n$ fpplab x  # why\n{}\n```\n"
    assert outcome(console.format("a 1")) == ""
    assert "prints\na 1\n\nnot\na 5" in outcome(console.format("a 5"))
    assert outcome(console.format(OMITTED)) == ""
    assert "prints\na 1\n\nnot\nb 2" in outcome(console.format("b 2"))
    assert "ends with 4" in outcome(console.format("a 2"), (4, "", "fpplab: no"))
    assert outcome(console.format("fpplab: no\n[exit code 4]"), (4, "", "fpplab: no\n")) == ""
    assert "ends with 0" in outcome(console.format("fpplab: no\n[exit code 4]"))
    assert "line 2: ZeroDivisionError" in outcome("```python\n1 / 0\n```\n")
    assert "use an `sh` block" in outcome("```console\n$ rm x\n```\n")
    assert outcome("```python\nx = 1\n```\ntext\n```python\nassert x == 1\n```\n") == ""
    assert outcome("1. item\n\n   ```yaml\n   # a.yaml\n   b: 1\n   ```\n") == ""
    assert (tmp_path / "a.yaml").read_text() == "# a.yaml\nb: 1\n"


def test_lines_are_compared() -> None:
    """Numbers may differ by a tenth, words may not, and lines are left out only where the page says so."""
    assert fits(["a 1.5 ms", "b"], ["a 1.62 ms", "b"])
    assert not fits(["a 1.5 ms"], ["a 1.8 ms"])
    assert not fits(["multiply by 0.7"], ["multiply by 0.12"])
    assert fits(["outliers: 0"], ["outliers: 1"]), "one in the last digit"
    assert not fits(["outliers: 0"], ["outliers: 2"])
    assert fits(["3e-05 mm"], ["3.9e-05 mm"])
    assert fits(["seconds: 12.1"], ["seconds: 40.7"])
    assert not fits(["a 1.5 ms"], ["a 1.5 s"])
    assert not fits(["a"], ["a", "b"])
    assert fits(["a", OMITTED], ["a", "b", "c"])
    assert fits([OMITTED, "c", OMITTED, "e 1"], ["a", "c", "c", "e 1"])


def test_a_command_may_stand_in_several_lines(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```console\n$ fpplab a \\\n    --b\nprinted\n$ fpplab c\n```\n", encoding="utf-8")
    assert list(commands(blocks(page)[0])) == [("fpplab a --b", ["printed"]), ("fpplab c", [])]
