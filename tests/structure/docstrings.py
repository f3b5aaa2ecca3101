"""What public docstrings leave out by numpydoc: `python -m tests.structure.docstrings [PATH …]`.

Public is what is named without an underscore in a module, or in a public class of it. Commands of the command
line are left out: their docstring is what `--help` prints, and each option has its own words.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("fpplab", "drivers", "sim", "benchmarks")
NOTHING = ("None", "NoReturn", "Never")
DOCUMENTS = ("Document", "BaseModel")

Function = ast.FunctionDef | ast.AsyncFunctionDef


def sections(doc: str) -> dict[str, str]:
    """The text under every underlined heading."""
    parts = re.split(r"^(\w[\w ]*)\n-{3,}\n", doc, flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def described(section: str) -> set[str]:
    """The names that a section of `name : type` entries describes."""
    names: set[str] = set()
    for entry in re.findall(r"^(\*{0,2}\w[\w*, ]*?)(?: : .*)?$", section, re.M):
        names |= {name.strip().lstrip("*") for name in entry.split(",")}
    return names


def decorators(node: Function | ast.ClassDef) -> list[str]:
    """The decorators as they are written."""
    return [ast.unparse(decorator) for decorator in node.decorator_list]


def lacks_of_function(node: Function) -> Iterator[str]:
    """What the docstring of a public function or method leaves out."""
    written = decorators(node)
    if any(".command(" in one or one == "overload" for one in written):
        return
    doc = ast.get_docstring(node)
    if doc is None:
        yield "no docstring"
        return
    if "override" in written or any(one.endswith(".setter") for one in written):
        return
    parts = sections(doc)
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    wanted = {a.arg for a in arguments if a.arg not in ("self", "cls") and a.arg[0] != "_"}
    missing = wanted - described(parts.get("Parameters", ""))
    if missing:
        yield f"Parameters: {', '.join(sorted(missing))}"
    if unknown := described(parts.get("Parameters", "")) - {a.arg for a in _all_arguments(node)}:
        yield f"Parameters that it has not: {', '.join(sorted(unknown))}"
    returns = ast.unparse(node.returns) if node.returns else "None"
    is_property = any("property" in one for one in written)
    if returns not in NOTHING and not is_property and not {"Returns", "Yields"} & set(parts):
        yield "Returns or Yields"
    if raised := _raised(node) - _named(parts.get("Raises", "")):
        yield f"Raises: {', '.join(sorted(raised))}"


def _all_arguments(node: Function) -> list[ast.arg]:
    own = node.args
    stars = [a for a in (own.vararg, own.kwarg) if a]
    return [*own.posonlyargs, *own.args, *own.kwonlyargs, *stars]


def _raised(node: Function) -> set[str]:
    """Classes that the function's own body raises by name, but for those that it also catches."""
    found = set()
    for inner in _own(node):
        if isinstance(inner, ast.Raise) and isinstance(inner.exc, ast.Call):
            name = ast.unparse(inner.exc.func).split(".")[-1]
            if name[0].isupper():
                found.add(name)
    return found - {"AssertionError"}


def _own(node: ast.AST) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.Lambda | ast.ClassDef):
            yield child
            yield from _own(child)


def _named(section: str) -> set[str]:
    return set(re.findall(r"\w+", section))


def lacks_of_class(node: ast.ClassDef, is_document: bool) -> Iterator[str]:
    """What the docstrings of a public class and of its fields leave out."""
    doc = ast.get_docstring(node)
    if doc is None:
        yield "no docstring"
        return
    fields = {
        statement.target.id: following
        for statement, following in zip(node.body, [*node.body[1:], None], strict=True)
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)
        if statement.target.id[0] != "_" and "ClassVar" not in ast.unparse(statement.annotation)
    }
    if is_document:
        bare = [name for name, following in fields.items() if not _is_string(following)]
        if bare:
            yield f"fields without a docstring of their own: {', '.join(bare)}"
    elif any("dataclass" in one for one in decorators(node)) or "NamedTuple" in map(ast.unparse, node.bases):
        parts = sections(doc)
        told = described(parts.get("Attributes", "") + "\n" + parts.get("Parameters", ""))
        told |= {name for name, following in fields.items() if _is_string(following)}
        if missing := set(fields) - told:
            yield f"Attributes: {', '.join(sorted(missing))}"


def _is_string(node: ast.stmt | None) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def lacks(path: Path, documents: set[str]) -> Iterator[str]:
    """Everything that a module's public docstrings leave out, a line each."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    place = path.relative_to(ROOT)
    if ast.get_docstring(tree) is None and path.stat().st_size:
        yield f"{place}:1: no docstring"
    for node, owner in _public(tree, ""):
        if isinstance(node, ast.ClassDef):
            found = lacks_of_class(node, node.name in documents)
        else:
            found = lacks_of_function(node)
        for one in found:
            yield f"{place}:{node.lineno}: {owner}{node.name}: {one}"


def _public(node: ast.Module | ast.ClassDef, owner: str) -> Iterator[tuple[Function | ast.ClassDef, str]]:
    for child in node.body:
        if isinstance(child, ast.ClassDef | Function) and child.name[0] != "_":
            yield child, owner
            if isinstance(child, ast.ClassDef):
                yield from _public(child, f"{owner}{child.name}.")


def document_names() -> set[str]:
    """Names of all pydantic models of the packages."""
    bases: dict[str, set[str]] = {}
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                names = {ast.unparse(base).split(".")[-1].split("[")[0] for base in node.bases}
                bases.setdefault(node.name, set()).update(names)
    found = set(DOCUMENTS)
    while more := {name for name, of in bases.items() if of & found} - found:
        found |= more
    return found


def sources() -> list[Path]:
    """Every module of the packages."""
    return sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def main(words: list[str]) -> int:
    """Print what is left out below the paths named, or everywhere."""
    places = [(ROOT / word).resolve() for word in words] or [ROOT]
    documents, count = document_names(), 0
    for path in sources():
        if any(path.resolve().is_relative_to(place) for place in places):
            for line in lacks(path, documents):
                print(line)
                count += 1
    print(f"{count} left out")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
