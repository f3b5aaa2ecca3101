"""Imports go one way: the contracts hold, they refuse what they should, and no string goes round them."""

import ast
import os
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("fpplab", "drivers", "sim", "benchmarks")
ABOVE = ("drivers", "sim", "benchmarks")
LOADERS = {
    "fpplab/__init__.py",  # its own public names, when first used
    "fpplab/artefacts/catalogue.py",  # the files of `fpplab.artefacts.shapes`
    "fpplab/cli/__init__.py",
    "fpplab/cli/every.py",  # the files of `fpplab.cli.commands`
    "fpplab/core/system.py",  # modules of Python that not every system has
    "fpplab/core/tagged_union.py",  # the files of a package of kinds
    "fpplab/diagnosis/catalogue.py",  # the files of `fpplab.diagnosis.causes`
    "fpplab/devices/backends.py",  # what a rig file names
}
"""Where a module may be imported by a name that is data."""


def contracts(folder: Path, changed: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """`lint-imports` on a copy of the packages, with lines added at the end of some files."""
    for name in PACKAGES:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    for file, line in (changed or {}).items():
        path = folder / file
        path.parent.mkdir(exist_ok=True)
        before = path.read_text(encoding="utf-8") if path.exists() else ""
        assert line not in before
        path.write_text(f"{before}\n{line}\n", encoding="utf-8")
    program = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    command = [sys.executable, "-c", program, "--no-cache"]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_the_contracts_hold(tmp_path: Path) -> None:
    done = contracts(tmp_path)
    assert done.returncode == 0, done.stdout
    assert "0 broken" in done.stdout


@pytest.mark.whole
@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("fpplab/phase/precision.py", "import drivers.clock"),
        ("fpplab/optimisation/run.py", "import sim.twin"),
        ("fpplab/core/files.py", "import fpplab.patterns.plan"),
        ("fpplab/patterns/plan.py", "import fpplab.devices"),
        ("fpplab/phase/decoding.py", "import fpplab.comparison"),
        ("drivers/clock.py", "import sim.scene"),
        ("sim/sensor.py", "import drivers.clock"),
        ("sim/twin.py", "import sim.matching.loss"),
        ("sim/fluctuation.py", "import bpy"),
        ("sim/build.py", "import sim.blender.nodes"),
        ("fpplab/brand_new/__init__.py", "import fpplab.core"),
    ],
)
def test_an_import_that_goes_the_wrong_way_is_refused(tmp_path: Path, file: str, line: str) -> None:
    done = contracts(tmp_path, {file: line})
    assert done.returncode == 1, done.stdout


def imports_by_string(file: str, text: str) -> Iterator[str]:
    """Imports in a module of fpplab that no contract sees: of a name above it, or by a name that is data."""
    tree = ast.parse(text)
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            if node.value.startswith(tuple(f"{name}." for name in ABOVE)) and " " not in node.value:
                yield f"{file}:{node.lineno}: names '{node.value}'"
        elif isinstance(node, ast.Call) and file not in LOADERS:
            called = ast.unparse(node.func)
            if called.split(".")[-1] in ("import_module", "__import__", "exec", "run_module"):
                yield f"{file}:{node.lineno}: calls {called}"


def test_fpplab_names_nothing_above_it_in_a_string() -> None:
    found = [
        line
        for path in sorted((ROOT / "fpplab").rglob("*.py"))
        for line in imports_by_string(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"))
    ]
    assert found == []


@pytest.mark.parametrize(
    "line",
    [
        'BACKEND = "drivers.basler:BaslerCamera"',
        'import importlib\nimportlib.import_module("drivers" + ".clock")',
        "from importlib import import_module\nimport_module(name)",
        '__import__("sim.twin")',
    ],
)
def test_an_import_by_string_is_noticed(line: str) -> None:
    assert list(imports_by_string("fpplab/phase/precision.py", line))


@cache
def rooms() -> dict[str, frozenset[str]]:
    """What each folder of fpplab, and each package beside it, imports of the others."""
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    arrows: dict[str, set[str]] = defaultdict(set)
    for module in graph.modules:
        for imported in graph.find_modules_directly_imported_by(module):
            if (one := room(module)) != (other := room(imported)):
                arrows[one].add(other)
        arrows[room(module)] |= set()
    return {name: frozenset(to) for name, to in arrows.items()}


APPLICATIONS = {"commands", "dataset", "matching", "prediction", "preview_scan"}
"""Parts of `sim` that use the whole pipeline; the twin itself stands far below it."""


def room(module: str) -> str:
    first, *rest = module.split(".")
    if first == "sim" and rest and rest[0] in APPLICATIONS:
        return "applications of the twin"
    return rest[0] if first == "fpplab" and rest else first


def layer(name: str, above: tuple[str, ...] = ()) -> int:
    """How many rooms stand under one another below this one, itself included. Fails for a circle."""
    assert name not in above, f"a circle: {' -> '.join((*above, name))}"
    return 1 + max((layer(other, (*above, name)) for other in rooms()[name]), default=0)


def test_the_house_is_as_small_as_it_was_drawn() -> None:
    assert len(rooms()) <= 29
    assert max(layer(name) for name in rooms()) <= 14
    assert layer("sim") <= 6
    loose = {path.name for path in (ROOT / "fpplab").iterdir() if path.is_file()}
    assert loose == {"__init__.py", "__main__.py", "py.typed"}
