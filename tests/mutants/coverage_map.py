"""Which tests execute which lines of the sources: made once by the whole quick suite, then read."""

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

from fpplab.core.files import write_text
from tests.mutants.recording import CONTEXT, KNOWN, RESULTS
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


def collected(tests: list[str], root: Path = ROOT) -> set[str]:
    """The quick tests that there are."""
    command = [sys.executable, "-m", "pytest", *tests, "-m", "not slow", "--collect-only", "-q"]
    command += ["-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"the tests cannot be collected:\n{done.stdout}")
    return set(done.stdout.splitlines())


def without_gone(known: CoverageMap, there: set[str]) -> CoverageMap:
    """Leave out tests that are no longer there, which would end a run as a failure does."""
    return CoverageMap(
        {
            f: {n: [t for t in of if t in there] for n, of in lines.items()}
            for f, lines in known.lines.items()
        },
        {test: seconds for test, seconds in known.seconds.items() if test in there},
    )


def make(folder: Path, tests: list[str], workers: int) -> None:
    """Run the tests that the map in a folder lacks, with recording, and add what they execute.

    A run that was interrupted is not lost: what it recorded is added by the next one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tree = folder / "tree"
    _gather(folder, tree)
    known = load(folder)
    shutil.rmtree(tree, ignore_errors=True)
    copy_tree(tree)
    _save(folder, known)
    (folder / "known").write_text("\n".join(known.seconds), encoding="utf-8")
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
        KNOWN: str(folder / "known"),
    }
    subprocess.run(command, cwd=tree, env=environment, check=False)
    _gather(folder, tree)


def _gather(folder: Path, tree: Path) -> None:
    """Add to the map what processes have recorded."""
    parts, results = sorted(folder.glob("lines.*")), folder / "results.jsonl"
    if not parts or not results.exists():
        return
    known = load(folder, tree)
    found = [json.loads(line) for line in results.read_text("utf-8").splitlines()]
    seconds = known.seconds | {one["test"]: one["seconds"] for one in found if one["passed"]}
    lines = {file: {n: set(tests) for n, tests in of.items()} for file, of in known.lines.items()}
    for part in parts:
        data = coverage.CoverageData(str(part))
        data.read()
        for file in data.measured_files():
            of = lines.setdefault(str(Path(file).relative_to(tree)), {})
            for line, tests in data.contexts_by_lineno(file).items():
                of.setdefault(line, set()).update(test for test in tests if test in seconds)
    _save(folder, CoverageMap({f: {n: sorted(t) for n, t in of.items()} for f, of in lines.items()}, seconds))
    for part in (*parts, results):
        part.unlink()


def _save(folder: Path, known: CoverageMap) -> None:
    number = {test: k for k, test in enumerate(known.seconds)}
    lines = {
        file: {line: [number[test] for test in tests] for line, tests in of.items() if tests}
        for file, of in known.lines.items()
    }
    text = json.dumps({"tests": list(known.seconds.items()), "lines": lines})
    write_text(folder / "map.json", text)


def _lines_now(then: Path, now: Path) -> dict[int, int] | None:
    """The lines of a file as it was by those that it has; None where it is gone."""
    if not now.exists():
        return None
    old, new = (path.read_text(encoding="utf-8").splitlines() for path in (then, now))
    if old == new:
        return {line: line for line in range(1, len(new) + 1)}
    blocks = SequenceMatcher(None, old, new, autojunk=False).get_matching_blocks()
    return {block.a + k + 1: block.b + k + 1 for block in blocks for k in range(block.size)}


def load(folder: Path, root: Path = ROOT) -> CoverageMap:
    """Read the map; of files that changed since it was made, what is the same is found at its new place.

    Empty where there is none.
    """
    if not (folder / "map.json").exists():
        return CoverageMap({}, {})
    data = json.loads((folder / "map.json").read_text(encoding="utf-8"))
    names = [name for name, _ in data["tests"]]
    lines = {}
    for file, found in data["lines"].items():
        if (now := _lines_now(folder / "tree" / file, root / file)) is not None:
            lines[file] = {
                now[int(line)]: [names[k] for k in tests] for line, tests in found.items() if int(line) in now
            }
    return CoverageMap(lines, dict(data["tests"]))
