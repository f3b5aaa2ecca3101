"""What CONTRIBUTING.md says a newcomer opens and changes is so, and each promise names what shows it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PROMISES = yaml.safe_load((ROOT / "tests" / "docs" / "promises.yaml").read_text(encoding="utf-8"))
COMMAND = '''
"""`fpplab hello`: greets."""

from fpplab.cli import console
from fpplab.cli.app import START, Json, app


@app.command("hello", rich_help_panel=START)
def hello_command(json: Json = False) -> None:
    """Greet the operator."""
    console.print_result({"greeting": "good morning"}, json)
'''
CHALK = '''
"""Chalk: matt, and rough."""

from typing import Literal

from sim.scene import Paint, matt
from sim.world.materials.base import Material


class Chalk(Material):
    """Chalk."""

    kind: Literal["chalk"] = "chalk"
    """Name of the kind of material."""

    def paint(self) -> Paint:
        return Paint(0.8, matt(0.5))
'''
ASK = """
import pickle
from fpplab.core import config
from sim.world import World
data = World.load("world_demo.yaml").model_dump(mode="json")
data["materials"] = {"board": {"kind": "chalk"}}
world = config.validate(data, World, "world")
assert world.materials["board"].paint().reflectance == 0.8
assert pickle.loads(pickle.dumps(world)) == world
"""


def rows(heading: str) -> list[list[str]]:
    """The rows of the table below a heading, without its head."""
    section = re.split(r"^#", TEXT.partition(f"{heading}\n")[2], flags=re.MULTILINE)[0]
    table = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table[2:]]


@pytest.mark.parametrize("row", rows("### Files to open and to change"), ids=lambda row: row[0])
def test_files_that_a_newcomer_opens_exist_and_a_test_adds_one(row: list[str]) -> None:
    _, opened, _, proof = row
    for path in re.findall(r"`([\w/.-]+\.(?:py|md))`", opened):
        assert (ROOT / path).is_file(), path
    (test,) = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", proof)
    assert f"def {test[1] or 'test_'}" in (ROOT / test[0]).read_text(encoding="utf-8")


def in_a_copy(folder: Path, package: str, path: str, added: str, words: list[str]) -> str:
    """What Python prints where a package has one more file."""
    shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / package / path).write_text(added, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(folder), str(ROOT)))}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_command_is_added_by_one_file(tmp_path: Path) -> None:
    words = ["-m", "fpplab", "hello", "--json"]
    said = in_a_copy(tmp_path, "fpplab", "cli/commands/hello.py", COMMAND, words)
    assert said.strip() == '{"greeting": "good morning"}'


@pytest.mark.parametrize(("place", "shown"), [("", "fpplab"), (', rich_help_panel="data"', "fpplab data")])
def test_a_command_needs_no_heading_and_may_name_a_group(tmp_path: Path, place: str, shown: str) -> None:
    command = COMMAND.replace(", rich_help_panel=START", place).replace("START, ", "")
    words = ["-m", *shown.split(), "--help"]
    assert "hello" in in_a_copy(tmp_path, "fpplab", "cli/commands/hello.py", command, words)
    top = subprocess.run(
        [sys.executable, "-m", "fpplab", "--help"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert ("hello" in top.stdout) == (shown == "fpplab")


def test_a_material_is_added_by_one_file(tmp_path: Path) -> None:
    in_a_copy(tmp_path, "sim", "world/materials/chalk.py", CHALK, ["-c", ASK])


@pytest.mark.parametrize("row", rows("### Walk it as a newcomer"), ids=lambda row: row[0])
def test_what_a_newcomer_reads_exists(row: list[str]) -> None:
    pages = re.findall(r"`(docs/[\w/-]+\.md)`", row[1])
    assert len(pages) == 2
    assert all((ROOT / page).is_file() for page in pages)


@pytest.mark.parametrize("row", PROMISES, ids=lambda row: row["promise"][:40])
def test_what_shows_a_promise_exists(row: dict[str, str]) -> None:
    pages = re.findall(r"[\w/-]+\.md", row["where"])
    assert pages
    assert all((ROOT / page).is_file() for page in pages)
    program, _, words = row["shown_by"].partition(" ")
    assert program in ("pytest", "python")
    for file, name in re.findall(r"^(tests/[\w/]+\.py)(?:::(\w+))?", words):
        assert f"def {name or 'test_'}" in (ROOT / file).read_text(encoding="utf-8")
    for name in re.findall(r"^-m benchmarks (\w+)", words):
        assert (ROOT / "benchmarks" / f"{name}.py").exists() or (ROOT / "benchmarks" / name).is_dir()
