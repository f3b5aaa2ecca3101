"""Which tests judge a fault: those that execute its line, the nearest and quickest first."""

import ast
import re
from collections.abc import Mapping
from pathlib import Path

from tests.mutants.coverage_map import CoverageMap
from tests.mutants.fault import Fault

MAX_TESTS_S = 30.0
"""Longest time of all tests of a fault together."""
INDIRECT_FACTOR = 4
"""How many times longer where it is not recorded which tests execute the fault, as with machine code."""
UNKNOWN_S = 1.0
"""Assumed time of a test of which nothing is recorded."""
MAX_IMPORTS = 3
"""How many modules of machine code may call each other in turn."""


class Chooser:
    """Chooses tests by what they execute."""

    def __init__(
        self,
        root: Path,
        known: CoverageMap,
        seconds: float = MAX_TESTS_S,
        first: Mapping[str, list[str]] | None = None,
    ) -> None:
        """`first` names tests that come before all others, by the name of a fault."""
        self._root, self._known, self._seconds, self._first = root, known, seconds, first or {}

    def tests_for(self, fault: Fault) -> list[str]:
        """Tests in the order in which they are to run; empty where none executes the fault."""
        recorded = self._known.tests_of(fault.file, self._lines(fault))
        direct = recorded or self._indirect(fault)
        files = {test.partition("::")[0] for test in direct}
        # What a fixture of a module executes is recorded for the first test that asks for it alone.
        same_files = {t for t in self._known.seconds if t.partition("::")[0] in files} - direct
        chosen = list(self._first.get(fault.name, ()))
        same_files -= set(chosen)
        direct -= set(chosen)
        remaining_s = self._seconds if recorded else INDIRECT_FACTOR * self._seconds
        for tests in (direct, same_files):
            for test in sorted(tests, key=lambda test: (self._distance(test, fault), self._time(test))):
                if not chosen or self._time(test) <= remaining_s:
                    chosen.append(test)
                    remaining_s -= self._time(test)
        return chosen

    def seconds_of(self, tests: list[str]) -> float:
        """How long tests took when the map was made."""
        return sum(map(self._time, tests))

    def _time(self, test: str) -> float:
        return self._known.seconds.get(test, UNKNOWN_S)

    def _distance(self, test: str, fault: Fault) -> int:
        """0 for a test of the fault's own module, 1 for one of its package, 2 for any other."""
        package = next(part for part in Path(fault.file).parts if part != "fpplab")
        if not test.startswith(f"tests/{package}/"):
            return 2
        return 0 if Path(test.partition("::")[0]).name == f"test_{Path(fault.file).name}" else 1

    def _lines(self, fault: Fault) -> list[int]:
        """Lines that tell a test: of a default argument, which runs at import, those of its function."""
        lines = [fault.line]
        for node in ast.walk(ast.parse((self._root / fault.file).read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.lineno <= fault.line < node.body[0].lineno:
                lines += range(node.body[0].lineno, (node.end_lineno or 0) + 1)
        return lines

    def _indirect(self, fault: Fault) -> set[str]:
        """Tests of a line that none is known to execute; of machine code what calls it is recorded alone."""
        files = {fault.file}
        for _ in range(MAX_IMPORTS):
            files |= {importer for file in files for importer in importers(self._root, file)}
            if tests := {test for file in files for test in self._callers(file)}:
                return tests
        return set()

    def _callers(self, file: str) -> set[str]:
        """Tests that execute functions of a file, not only import it."""
        tree = ast.parse((self._root / file).read_text(encoding="utf-8"))
        lines = {
            line
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef) and node.body
            for line in range(node.body[0].lineno, (node.end_lineno or 0) + 1)
        }
        return self._known.tests_of(file, lines)


def importers(root: Path, file: str) -> list[str]:
    """Files of the packages that import a module."""
    package, _, module = Path(file).with_suffix("").as_posix().replace("/", ".").rpartition(".")
    whole = re.escape(f"{package}.{module}")
    pattern = re.compile(
        rf"^\s*(?:(?:from|import) {whole}\b|from {re.escape(package)} import .*\b{module}\b)", re.MULTILINE
    )
    return [
        path.relative_to(root).as_posix()
        for path in sorted((root / file.partition("/")[0]).rglob("*.py"))
        if pattern.search(path.read_text(encoding="utf-8"))
    ]
