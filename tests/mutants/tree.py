"""Copies of the sources."""

import shutil
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("fpplab", "drivers", "sim")
COPIED = (*PACKAGES, "benchmarks", "configs", "docs", "examples", "tests")


def copy_tree(copy: Path) -> Path:
    """Copy what the tests need to a folder that does not exist yet."""
    for name in COPIED:
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("*.pyc"))
    for file in ROOT.iterdir():
        if file.is_file() and file.name != ".git":
            shutil.copy2(file, copy / file.name)
    return copy
