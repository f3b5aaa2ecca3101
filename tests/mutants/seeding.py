"""Faults seeded on the syntax of a source: every place where one expression or statement may be another.

Left out are what no test of behaviour should pin down: annotations, decorators, docstrings, the words of
messages, what is logged, assertions, and constants of modules and floating-point numbers, which are mostly
thresholds that the benchmarks judge.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==",
    ast.In: "not in", ast.NotIn: "in", ast.Is: "is not", ast.IsNot: "is",
}  # fmt: skip
ARITHMETIC: dict[type[ast.operator], str] = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "/", ast.Mod: "*",
    ast.Pow: "*", ast.LShift: ">>", ast.RShift: "<<", ast.BitAnd: "|", ast.BitOr: "&", ast.BitXor: "&",
    ast.MatMult: "*",
}  # fmt: skip
SWAPPED = {"min": "max", "max": "min", "any": "all", "all": "any", "minimum": "maximum", "maximum": "minimum"}
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
LOGS = ("_log", "log", "logging", "warnings")


@dataclass(frozen=True)
class Mutant:
    """A source with one fault.

    `line` counts from 1, `start` and `end` are bytes of the file; `within` is the qualified name of the
    function, and `number` tells apart equal changes in it.
    """

    file: str
    line: int
    start: int
    end: int
    old: str
    new: str
    within: str
    number: int = 0

    @property
    def name(self) -> str:
        """What identifies it while other code changes."""
        again = f" #{self.number + 1}" if self.number else ""
        return f"{self.file} {self.within}: {_flat(self.old)} => {_flat(self.new)}{again}"

    def seeded(self, source: bytes) -> bytes:
        """The source with the fault in it."""
        return source[: self.start] + self.new.encode() + source[self.end :]


def _flat(code: str) -> str:
    return " ".join(code.split())


def mutants(root: Path, file: str) -> list[Mutant]:
    """Every fault that can be seeded in the functions of a file."""
    source = (root / file).read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: list[Mutant] = []
    counted: dict[tuple[str, str, str], int] = {}
    for within, node, new in _changes(ast.parse(source), ""):
        start = starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        end = starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        old = source[start:end].decode()
        number = counted.get((within, old, new), 0)
        counted[within, old, new] = number + 1
        found.append(Mutant(file, node.lineno, start, end, old, new, within, number))  # type: ignore[attr-defined]
    return found


def _changes(node: ast.AST, within: str) -> Iterator[tuple[str, ast.AST, str]]:
    """(qualified name, node, replacement) of everything inside functions."""
    for child in _judged(node):
        inside = f"{within}.{child.name}".lstrip(".") if isinstance(child, Definition) else within
        if within or not isinstance(child, ast.expr | ast.stmt) or isinstance(child, Definition):
            if within and not isinstance(child, Definition):
                yield from ((within, child, new) for new in _replacements(child))
            yield from _changes(child, inside)


def _judged(node: ast.AST) -> Iterator[ast.AST]:
    """Children of a node that a fault may be seeded in."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        yield from node.body
        yield from node.args.defaults
    elif isinstance(node, ast.ClassDef):
        yield from (child for child in node.body if isinstance(child, Definition))
    elif isinstance(node, ast.AnnAssign):
        yield from [node.value] if node.value else []
    elif isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert) or _is_log(node):
        return
    else:
        yield from ast.iter_child_nodes(node)


def _is_log(node: ast.AST) -> bool:
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
        return False
    return isinstance(node.func.value, ast.Name) and node.func.value.id in LOGS


def _replacements(node: ast.AST) -> Iterator[str]:
    """What a node may be instead, as source."""
    match node:
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            yield f"({_code(left)} {COMPARISONS[type(op)]} {_code(right)})"
        case ast.BinOp(left=left, op=op, right=right) if not _is_text(left) and not _is_text(right):
            yield f"({_code(left)} {ARITHMETIC[type(op)]} {_code(right)})"
        case ast.BoolOp(op=op, values=values):
            word = " or " if isinstance(op, ast.And) else " and "
            yield f"({word.join(_code(value) for value in values)})"
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield f"({_code(operand)})"
        case ast.IfExp(test=test, body=body, orelse=orelse) if not _is_text(body) and not _is_text(orelse):
            yield f"({_code(orelse)} if {_code(test)} else {_code(body)})"
        case ast.Constant(value=bool() as value):
            yield str(not value)
        case ast.Constant(value=int() as value):
            yield f"{value + 1}"
        case ast.Name(id=name) if name in SWAPPED:
            yield SWAPPED[name]
        case ast.Attribute(value=value, attr=name) if name in SWAPPED:
            yield f"{_code(value)}.{SWAPPED[name]}"
        case ast.Expr(value=ast.Call() as call) if not _is_log(call):
            yield "pass"
        case ast.Raise() | ast.AugAssign() | ast.Continue() | ast.Break():
            yield "pass"


def _code(node: ast.expr) -> str:
    return f"({ast.unparse(node)})"


def _is_text(node: ast.AST) -> bool:
    """Whether it is a word or a part of a message."""
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
