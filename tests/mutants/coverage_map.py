"""Which tests execute which lines of the sources: made once by the whole quick suite, then read."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import SequenceMatcher
from pathlib import Path

import coverage

from tests.mutants.recording import CONTEXT, RESULTS
from tests.mutants.tree import PACKAGES, ROOT, copy_tree

STARTUP = Path(__file__).with_name("startup")
SETTINGS = """\
[run]
parallel = true
data_file = {folder}/lines
context = ${{{context}-}}
source =
    {sources}
core = ctrace
"""


@dataclass(frozen=True)
class CoverageMap:
    """What the suite executes.

    `lines` has, by file and line, the tests that execute it; `seconds` how long each test takes. Only tests
    that passed are in it.
    """

    lines: dict[str, dict[int, list[str]]]
    seconds: dict[str, float]

    def tests_of(self, file: str, lines: Iterable[int]) -> set[str]:
        """Tests that execute one of the lines of a file."""
        known = self.lines.get(file, {})
        return {test for line in lines for test in known.get(line, ())}


def make(folder: Path, tests: list[str], workers: int) -> None:
    """Run tests with recording, and write the map to a folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    tree = copy_tree(folder / "tree")
    sources = "\n    ".join(str(tree / package) for package in PACKAGES)
    settings = folder / "settings"
    settings.write_text(SETTINGS.format(folder=folder, context=CONTEXT, sources=sources), encoding="utf-8")
    command = [sys.executable, "-m", "pytest", *tests, "-m", "not slow", "-q", "--no-header", "--tb=line"]
    command += ["-p", "tests.mutants.recording", "-p", "no:cacheprovider", "-n", str(workers)]
    command += ["--dist", "worksteal"]
    environment = {
        **os.environ,
        "PYTHONPATH": f"{STARTUP}{os.pathsep}{tree}",
        "COVERAGE_PROCESS_START": str(settings),
        RESULTS: str(folder / "results.jsonl"),
    }
    subprocess.run(command, cwd=tree, env=environment, check=False)
    _write(folder, tree)


def _write(folder: Path, tree: Path) -> None:
    """Put together what the processes have recorded."""
    whole = coverage.CoverageData(str(folder / "whole"))
    for part in sorted(folder.glob("lines.*")):
        one = coverage.CoverageData(str(part))
        one.read()
        whole.update(one)
        part.unlink()
    results = [json.loads(line) for line in (folder / "results.jsonl").read_text("utf-8").splitlines()]
    seconds = {found["test"]: found["seconds"] for found in results if found["passed"]}
    number = {test: k for k, test in enumerate(seconds)}
    lines = {
        str(Path(file).relative_to(tree)): {
            line: found
            for line, tests in whole.contexts_by_lineno(file).items()
            if (found := [number[test] for test in tests if test in number])
        }
        for file in whole.measured_files()
    }
    text = json.dumps({"tests": list(seconds.items()), "lines": lines})
    (folder / "map.json").write_text(text, encoding="utf-8")


def _lines_now(then: Path, now: Path) -> dict[int, int] | None:
    """The lines of a file as it was by those that it has; None where it is gone."""
    if not now.exists():
        return None
    old, new = (path.read_text(encoding="utf-8").splitlines() for path in (then, now))
    if old == new:
        return {line: line for line in range(1, len(new) + 1)}
    blocks = SequenceMatcher(None, old, new, autojunk=False).get_matching_blocks()
    return {block.a + k + 1: block.b + k + 1 for block in blocks for k in range(block.size)}


def load(folder: Path) -> CoverageMap:
    """Read the map; of files that changed since it was made, what is the same is found at its new place."""
    data = json.loads((folder / "map.json").read_text(encoding="utf-8"))
    names = [name for name, _ in data["tests"]]
    lines = {}
    for file, found in data["lines"].items():
        if (now := _lines_now(folder / "tree" / file, ROOT / file)) is not None:
            lines[file] = {
                now[int(line)]: [names[k] for k in tests] for line, tests in found.items() if int(line) in now
            }
    return CoverageMap(lines, dict(data["tests"]))
