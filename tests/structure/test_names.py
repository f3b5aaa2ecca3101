"""A public name means one thing: no two modules define a class, function or type alias of the same name."""

import ast
import re
from collections import defaultdict
from pathlib import Path

from fpplab.core.tagged_union import registered_types
from fpplab.patterns.fringe_sets import PatternSet

ROOT = Path(__file__).parents[2]
PACKAGES = ("fpplab", "drivers", "sim", "benchmarks")
PLUG_INS = {"main": "", "run": "benchmarks/"}
"""Names that many modules may define, each of them what runs it, and below which folder."""


def public_names(tree: ast.Module) -> set[str]:
    """Public classes, functions and CamelCase aliases that a module defines; imports are not definitions."""
    names = set()
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found = {target.id for target in targets if isinstance(target, ast.Name)}
            names |= {one for one in found if re.fullmatch(r"[A-Z][A-Za-z0-9]*[a-z][A-Za-z0-9]*", one)}
    return {one for one in names if not one.startswith("_")}


def definitions() -> dict[str, list[str]]:
    """The modules that define each public name."""
    found: dict[str, list[str]] = defaultdict(list)
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            place = path.relative_to(ROOT).as_posix()
            for name in public_names(ast.parse(path.read_text(encoding="utf-8"))):
                if not (name in PLUG_INS and place.startswith(PLUG_INS[name])):
                    found[name].append(place)
    return found


def test_every_public_name_is_defined_in_one_module() -> None:
    doubled = {name: places for name, places in definitions().items() if len(places) > 1}
    assert not doubled, "\n" + "\n".join(f"{name}: {', '.join(p)}" for name, p in sorted(doubled.items()))


def test_what_counts_as_a_public_name() -> None:
    source = (
        "from a import B\nLens = float\nLENS = 1\nlens = 2\nT = TypeVar('T')\ndef f(): ...\ndef _g(): ...\n"
    )
    assert public_names(ast.parse(source + "class C:\n    def m(self): ...\n")) == {"Lens", "f", "C"}


def test_no_module_outside_their_package_names_a_kind_of_pattern_sets() -> None:
    """Adding a kind is one file."""
    kinds = registered_types(PatternSet).values()
    names = {kind.__name__ for kind in kinds} | {kind.__module__.rpartition(".")[2] for kind in kinds}
    naming = [
        f"{path.relative_to(ROOT)}: {alias.name}"
        for package in ("fpplab", "drivers", "sim")
        for path in sorted((ROOT / package).rglob("*.py"))
        if "fringe_sets" not in path.parts
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fpplab.patterns.fringe_sets")
        for alias in node.names
        if alias.name in names or (node.module or "").rpartition(".")[2] in names
    ]
    assert not naming, naming
