"""Fragments of Python found in a source by their structure, and replaced where they stand.

A fragment is looked for inside one function, class or constant of a file. Formatting, line breaks, comments
and docstrings make no difference, and no fragment is found in them. It has one of three forms:

- a head, which ends with a colon: `if x is None:`, `except OSError as error:`, `case Alarm(code):`. What
  follows the colon stays as it is.
- an expression, if both the fragment and its replacement are one: `self._loaded[i]`.
- one or more consecutive statements otherwise. `name=value` is found as an assignment or as a keyword
  argument. An empty replacement deletes the statements.

In a fragment that is looked for, `...` stands for any expression, `f(...)` for a call of `f` with any
arguments, and a body of nothing but `...` for any body.
"""

from __future__ import annotations

import ast
import io
import textwrap
import tokenize
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
HEADS: dict[type[ast.AST], tuple[str, ...]] = {
    ast.If: ("test",),
    ast.While: ("test",),
    ast.For: ("target", "iter"),
    ast.With: ("items",),
    ast.ExceptHandler: ("type", "name"),
    ast.match_case: ("pattern", "guard"),
}
"""What the head of a statement holds, by the kind of its node."""
IGNORED = ("ctx", "kind", "type_comment")
"""Fields that follow from a node's place or spelling."""
ATOMS = (
    ast.Name,
    ast.Attribute,
    ast.Call,
    ast.Subscript,
    ast.Constant,
    ast.Tuple,
    ast.List,
    ast.Dict,
    ast.JoinedStr,
)
"""Expressions that can stand anywhere without parentheses; a tuple is written with its own."""


@dataclass(frozen=True)
class Place:
    """Where a fragment stands: character positions in the source, and the node that begins there."""

    start: int
    end: int
    node: ast.AST


def replace(source: str, within: str, old: str, new: str) -> str:
    """The source with a fragment replaced; `LookupError` unless it is found exactly once."""
    found = places(source, within, old, new)
    if len(found) != 1:
        raise LookupError(f"found {len(found)} times, not once, in '{within or 'the module'}': {old.strip()}")
    (place,) = found
    return source[: place.start] + _written(source, place, old, new) + source[place.end :]


def places(source: str, within: str, old: str, new: str) -> list[Place]:
    """Every place of a fragment inside the definitions of a qualified name; empty: in the module."""
    tree, positions = ast.parse(source), _Positions(source)
    scopes: Sequence[ast.AST] = [tree] if not within else list(_defined(tree, within.split(".")))
    if not scopes:
        raise LookupError(f"nothing is called '{within}'")
    if _is_head(old):
        pattern = _head(old)
        return [
            positions.of_head(node) for scope in scopes for node in _nodes(scope) if _same_head(pattern, node)
        ]
    if (wanted := _expression(old)) and _expression(new):
        return [
            positions.of(node, node)
            for scope in scopes
            for node in _nodes(scope)
            if isinstance(node, ast.expr) and same(wanted, node)
        ]
    return [
        place
        for scope in scopes
        for place in _statements(scope, _code(ast.parse(_dedented(old)).body), positions)
    ]


def same(pattern: object, found: object) -> bool:
    """Whether a node, a field of one or a list of such has the pattern's structure."""
    if isinstance(pattern, ast.Constant) and pattern.value is Ellipsis:
        return isinstance(found, ast.expr)
    if isinstance(pattern, ast.Call) and isinstance(found, ast.Call) and _any_arguments(pattern):
        return same(pattern.func, found.func)
    if isinstance(pattern, ast.AST):
        return type(pattern) is type(found) and all(
            same(getattr(pattern, name), getattr(found, name))
            for name in pattern._fields
            if name not in IGNORED
        )
    if isinstance(pattern, list) and isinstance(found, list):
        pattern, found = _code(pattern), _code(found)
        if len(pattern) == 1 and _is_ellipsis(pattern[0]) and isinstance(pattern[0], ast.stmt):
            return bool(found)
        return len(pattern) == len(found) and all(map(same, pattern, found))
    return type(pattern) is type(found) and pattern == found


def _is_ellipsis(node: object) -> bool:
    value = node.value if isinstance(node, ast.Expr) else node
    return isinstance(value, ast.Constant) and value.value is Ellipsis


def _any_arguments(call: ast.Call) -> bool:
    return len(call.args) == 1 and not call.keywords and _is_ellipsis(call.args[0])


def _code(nodes: list[ast.stmt]) -> list[ast.stmt]:
    """Without docstrings and other strings that are statements."""
    return [
        node
        for node in nodes
        if not (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        )
    ]


def _dedented(text: str) -> str:
    return textwrap.dedent(text).strip("\n")


def _is_head(text: str) -> bool:
    return text.rstrip().endswith(":")


def _expression(text: str) -> ast.expr | None:
    try:
        return ast.parse(text.strip(), mode="eval").body
    except SyntaxError:
        return None


def _head(text: str) -> ast.AST:
    """The node of a head, with an empty body."""
    text = text.strip()
    if text.startswith("case "):
        match = ast.parse(f"match _:\n    {text} pass").body[0]
        assert isinstance(match, ast.Match)
        return match.cases[0]
    if text.startswith("except"):
        attempt = ast.parse(f"try:\n    pass\n{text}\n    pass").body[0]
        assert isinstance(attempt, ast.Try)
        return attempt.handlers[0]
    return ast.parse(f"{text} pass").body[0]


def _same_head(pattern: ast.AST, node: ast.AST) -> bool:
    return type(pattern) is type(node) and all(
        same(getattr(pattern, name), getattr(node, name)) for name in HEADS[type(pattern)]
    )


def _defined(node: ast.AST, names: list[str]) -> Iterator[ast.AST]:
    """Functions, classes and constants of a qualified name; there are two of a property with a setter."""
    for child in _nodes(node, into_definitions=False):
        if isinstance(child, Definition):
            own = [child.name]
        elif isinstance(child, ast.Assign | ast.AnnAssign):
            targets = child.targets if isinstance(child, ast.Assign) else [child.target]
            own = [target.id for target in targets if isinstance(target, ast.Name)]
        else:
            continue
        if names[0] in own:
            if names[1:]:
                yield from _defined(child, names[1:])
            else:
                yield child


def _nodes(node: ast.AST, into_definitions: bool = True) -> Iterator[ast.AST]:
    """All nodes below one, but for those in f-strings, whose positions Python 3.11 does not know."""
    for child in ast.iter_child_nodes(node):
        yield child
        if not isinstance(child, ast.JoinedStr) and (into_definitions or not isinstance(child, Definition)):
            yield from _nodes(child, into_definitions)


def _statements(scope: ast.AST, pattern: list[ast.stmt], positions: _Positions) -> Iterator[Place]:
    """Every run of statements, and every keyword argument if the pattern is written like one."""
    for node in (scope, *_nodes(scope)):
        for field in ("body", "orelse", "finalbody"):
            block = getattr(node, field, None)
            code = _code(block) if isinstance(block, list) else []
            for first in range(len(code) - len(pattern) + 1):
                run = code[first : first + len(pattern)]
                if all(map(same, pattern, run)):
                    yield positions.of(run[0], run[-1])
        if isinstance(node, ast.keyword) and len(pattern) == 1 and _same_keyword(pattern[0], node):
            yield positions.of(node, node)


def _same_keyword(pattern: ast.stmt, node: ast.keyword) -> bool:
    if not (isinstance(pattern, ast.Assign) and len(pattern.targets) == 1):
        return False
    (target,) = pattern.targets
    return isinstance(target, ast.Name) and target.id == node.arg and same(pattern.value, node.value)


def _written(source: str, place: Place, old: str, new: str) -> str:
    """A replacement as it has to be written at its place."""
    new = _dedented(new)
    if _is_head(old):
        return "el" + new if source.startswith("elif", place.start) else new
    if isinstance(place.node, ast.expr) and (value := _expression(new)):
        return (
            new if isinstance(value, ATOMS) and not isinstance(place.node, ast.GeneratorExp) else f"({new})"
        )
    if isinstance(place.node, ast.keyword):
        return new
    margin = source[source.rfind("\n", 0, place.start) + 1 : place.start]
    return textwrap.indent(new or "pass", margin).removeprefix(margin)


class _Positions:
    """Character positions of nodes, whose columns count bytes."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._lines = io.StringIO(source).readlines()
        self._starts = [0]
        for line in self._lines:
            self._starts.append(self._starts[-1] + len(line))

    def of(self, first: ast.AST, last: ast.AST) -> Place:
        """From the beginning of one node to the end of another."""
        return Place(self._start(first), self._position(last.end_lineno, last.end_col_offset), first)  # type: ignore[attr-defined]

    def of_head(self, node: ast.AST) -> Place:
        """From the keyword to the colon."""
        start = self._start(node)
        lines = io.StringIO(self._source[start:])
        depth, column = 0, start - self._starts[self._line_of(start)]
        for token in tokenize.generate_tokens(lines.readline):
            depth += token.string in ("(", "[", "{")
            depth -= token.string in (")", "]", "}")
            if token.type == tokenize.OP and token.string == ":" and not depth:
                row, end = token.end
                line = self._line_of(start) + row - 1
                return Place(start, self._starts[line] + end + (column if row == 1 else 0), node)
        raise LookupError("a head without a colon")

    def _start(self, node: ast.AST) -> int:
        if isinstance(node, ast.match_case):  # which has no position of its own
            inside = self._start(node.pattern)
            return self._source.rindex("case", 0, inside)
        if isinstance(node, Definition) and node.decorator_list:
            first = node.decorator_list[0]
            return self._source.rindex("@", 0, self._position(first.lineno, first.col_offset))
        return self._position(node.lineno, node.col_offset)  # type: ignore[attr-defined]

    def _position(self, line: int, column: int) -> int:
        text = self._lines[line - 1].encode()[:column].decode()
        return self._starts[line - 1] + len(text)

    def _line_of(self, position: int) -> int:
        return self._source.count("\n", 0, position)
