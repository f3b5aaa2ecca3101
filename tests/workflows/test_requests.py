"""Workflows know no terminal, and take their requests without loading what measures."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path

import pytest

import fpplab.workflows

FOLDER = Path(fpplab.workflows.__path__[0])
LIGHT = (
    "calibrations",
    "check",
    "characterise",
    "compare",
    "demo",
    "gamma",
    "maps",
    "optimise",
    "reconstruct",
    "scan",
    "verify",
)
"""Workflows that refuse wrong input before they load what measures and draws."""


def imported(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_a_workflow_neither_parses_nor_prints(path: Path) -> None:
    assert not {name.partition(".")[0] for name in imported(path)} & {"typer", "click", "rich"}
    calls = [
        node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)
    ]
    assert not [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "print"]


@pytest.mark.parametrize("name", LIGHT)
def test_a_request_is_frozen_and_its_workflow_takes_it(name: str) -> None:
    module = import_module(f"fpplab.workflows.{name}")
    requests = [one for key, one in vars(module).items() if key.endswith("Request") and is_dataclass(one)]
    assert requests
    assert all(one.__dataclass_params__.frozen for one in requests)  # type: ignore[attr-defined]
    assert [key for key in vars(module) if key.startswith("run_")]


def test_requests_are_light_to_import() -> None:
    modules = ", ".join(f"fpplab.workflows.{name}" for name in LIGHT)
    program = (
        f"import sys, {modules}; print(sorted({{'numba', 'cv2', 'scipy', 'matplotlib'}} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "[]\n"
