"""Faults that are listed one by one in `faults.yaml`.

Most are mistakes that are made when devices are driven, which show what the conformance suite and the
drivers' own tests are worth; the others are faults that an earlier suite let live.

A fault is a fragment of the source in the canonical form of `ast.unparse`, so formatting and comments do not
matter: one statement per line, single quotes, only necessary parentheses. `...` is anything on a line.
What is empty afterwards becomes `pass`. The fragment has to stand exactly once in the function, class or
constant that `within` names, or else in the module.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

from fpplab.core.strict_yaml import load_yaml

LIST = Path(__file__).with_name("faults.yaml")
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


@dataclass(frozen=True)
class ListedFault:
    """A fragment of a source, what it becomes, and the test that is to notice it.

    `line` is one that runs whenever the place of the fault does.
    """

    name: str
    file: str
    line: int
    within: str
    old: str
    new: str
    killed_by: str

    def seeded(self, source: bytes) -> bytes:
        """The source, in canonical form, with the fault; `LookupError` unless its place is found once."""
        text = canonical(source)
        pattern = _pattern(self.old)
        spans = [_span(text, node) for node in definitions(ast.parse(text), self.within)]
        matches = [match for start, end in spans for match in pattern.finditer(text, start, end)]
        if len(matches) != 1:
            raise LookupError(
                f"'{self.name}' of {LIST.name}: {self.file} has {len(matches)} places like "
                f"{self.old!r} in '{self.within or 'the module'}'"
            )
        (match,) = matches
        line = text[text.rfind("\n", 0, match.start()) + 1 :]
        margin = line[: len(line) - len(line.lstrip(" "))]
        new = (self.new or "pass").replace("\n", f"\n{margin}")
        start = match.start() if text[match.start()] != " " else match.start() + len(margin)
        return (text[:start] + new + text[match.end() :]).encode()


@cache
def listed(root: Path) -> tuple[ListedFault, ...]:
    """All faults of the list."""
    faults: list[ListedFault] = []
    for file, of_file in load_yaml(LIST.read_text(encoding="utf-8")).items():
        tree = ast.parse((root / file).read_bytes())
        for fields in of_file:
            nodes = list(definitions(tree, fields["within"]))
            faults.append(ListedFault(**fields, file=file, line=_first_line(nodes[0]) if nodes else 1))
    return tuple(faults)


@lru_cache(maxsize=8)
def canonical(source: bytes) -> str:
    """A source without comments, as `ast.unparse` writes it."""
    return ast.unparse(ast.parse(source)) + "\n"


def definitions(tree: ast.AST, within: str) -> Iterator[ast.AST]:
    """Functions, classes and constants of a qualified name; a property with a setter has two."""
    if not within:
        yield tree
        return
    first, _, rest = within.partition(".")
    for node in ast.iter_child_nodes(tree):
        if first in _names(node):
            yield from definitions(node, rest)
        elif not isinstance(node, Definition):
            yield from definitions(node, within)


def _names(node: ast.AST) -> list[str]:
    if isinstance(node, Definition):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    return [target.id for target in targets if isinstance(target, ast.Name) and isinstance(node, ast.stmt)]


def _span(text: str, node: ast.AST) -> tuple[int, int]:
    """Where a definition begins and ends, with its decorators."""
    if isinstance(node, ast.Module):
        return 0, len(text)
    lines = text.splitlines(keepends=True)
    decorators = node.decorator_list if isinstance(node, Definition) else []
    first = min(part.lineno for part in (node, *decorators))  # type: ignore[attr-defined]
    return len("".join(lines[: first - 1])), len("".join(lines[: node.end_lineno]))  # type: ignore[attr-defined]


def _pattern(old: str) -> re.Pattern[str]:
    """What a fragment looks like: lines at any margin, or a part of a line that ends no name."""
    lines = [re.escape(line).replace(r"\.\.\.", ".*") for line in old.split("\n")]
    if len(lines) > 1:
        return re.compile("^( *)" + r"\n\1".join(lines) + "$", re.MULTILINE)
    before = r"(?<!\w)" if re.match(r"\w", old) else ""
    after = r"(?!\w)" if re.search(r"\w$", old) else ""
    return re.compile(before + lines[0] + after)


def _first_line(node: ast.AST) -> int:
    """The line of a definition that runs first whenever it is called."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        body = node.body[1:] if ast.get_docstring(node) and node.body[1:] else node.body
        return body[0].lineno
    return getattr(node, "lineno", 1)
