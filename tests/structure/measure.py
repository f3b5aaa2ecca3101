"""The size and shape of the product's sources, as a table: `python -m tests.structure.measure [COMMIT …]`.

Without arguments the working tree is measured; with commits, each of them, side by side.
"""

import ast
import io
import subprocess
import sys
import tokenize
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PRODUCT = ("fpplab", "drivers", "sim")
LONG_FUNCTION = 50

Sources = Mapping[str, str]
Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Measures:
    """What is counted over a set of sources."""

    lines: int
    code: int  # lines with a token that is neither comment nor docstring
    docstrings: int  # lines of docstrings, those of fields included
    comments: int  # lines that hold a comment and nothing else
    constants: int  # numeric constants of modules, class bodies left out
    long_functions: tuple[str, ...]  # those of more than 50 lines, docstring left out
    circles: tuple[tuple[str, ...], ...]  # modules that import each other, imports for type checkers included

    def rows(self) -> Iterator[tuple[str, str]]:
        """Give the rows of the table: what is counted, and how much of it."""
        yield "lines", f"{self.lines:,}"
        yield "lines of code", f"{self.code:,}"
        yield "docstrings, % of lines", f"{100 * self.docstrings / max(self.lines, 1):.1f}"
        yield "lines that are only comment, %", f"{100 * self.comments / max(self.lines, 1):.1f}"
        yield "numeric constants of modules", str(self.constants)
        yield f"functions over {LONG_FUNCTION} lines", str(len(self.long_functions))
        yield "circles of imports", str(len(self.circles))


def working_tree(packages: Iterable[str] = PRODUCT) -> dict[str, str]:
    """Read the sources of packages as they are in the working tree, by path."""
    paths = [path for package in packages for path in sorted((ROOT / package).rglob("*.py"))]
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in paths}


def committed(commit: str, packages: Iterable[str] = PRODUCT) -> dict[str, str]:
    """Read the sources of packages as they are in a commit, by path."""
    listed = _git("ls-tree", "-r", "--name-only", commit, *packages).splitlines()
    return {path: _git("show", f"{commit}:{path}") for path in listed if path.endswith(".py")}


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def measure(sources: Sources) -> Measures:
    """Count over all sources."""
    trees = {path: ast.parse(text) for path, text in sources.items()}
    docstring_lines = {path: set(_docstring_lines(tree)) for path, tree in trees.items()}
    tokens = {path: _token_lines(text) for path, text in sources.items()}
    return Measures(
        lines=sum(text.count("\n") for text in sources.values()),
        code=sum(len(tokens[path][0] - docstring_lines[path]) for path in sources),
        docstrings=sum(map(len, docstring_lines.values())),
        comments=sum(len(with_comment - with_code) for with_code, with_comment in tokens.values()),
        constants=sum(len(numeric_constants(tree)) for tree in trees.values()),
        long_functions=tuple(sorted(_long_functions(trees))),
        circles=import_circles(trees),
    )


def _docstring_lines(tree: ast.Module) -> Iterator[int]:
    """Line numbers of docstrings, and of the strings beneath fields and constants."""
    for node in ast.walk(tree):
        for statement in node.body if isinstance(node, Documented) else ():
            is_text = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            if is_text and isinstance(statement.value.value, str):
                yield from range(statement.lineno, (statement.end_lineno or statement.lineno) + 1)


def _token_lines(text: str) -> tuple[set[int], set[int]]:
    """Numbers of the lines that hold code (or a string), and of those that hold a comment."""
    with_code: set[int] = set()
    with_comment: set[int] = set()
    layout = (tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            with_comment.add(token.start[0])
        elif token.type not in layout:
            with_code.update(range(token.start[0], token.end[0] + 1))
    return with_code, with_comment


def numeric_constants(tree: ast.Module) -> list[str]:
    """List the names in capitals that a module gives a number, or an expression of numbers."""
    names = []
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and _is_number(node.value):
            names += [name.id for name in targets if isinstance(name, ast.Name) and name.id.isupper()]
    return names


def _is_number(node: ast.expr) -> bool:
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
    )


def _long_functions(trees: Mapping[str, ast.Module]) -> Iterator[str]:
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                body = node.body[1:] if ast.get_docstring(node) is not None and node.body[1:] else node.body
                length = (body[-1].end_lineno or 0) - body[0].lineno + 1
                if length > LONG_FUNCTION:
                    yield f"{path}:{node.name} ({length})"


def import_circles(trees: Mapping[str, ast.Module]) -> tuple[tuple[str, ...], ...]:
    """Find sets of modules that import each other, in functions and for type checkers too."""
    modules = {path.removesuffix(".py").removesuffix("/__init__").replace("/", "."): path for path in trees}
    graph = {
        name: {target for target in _imported(trees[path], modules) if target != name}
        for name, path in modules.items()
    }
    return tuple(sorted(tuple(sorted(part)) for part in _strong_components(graph) if len(part) > 1))


def _imported(tree: ast.Module, modules: Mapping[str, str]) -> set[str]:
    targets: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            targets |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            taken = {name for name in inner if name in modules}
            # A package's face hands names on; importing one module of it is no import of its face.
            targets |= taken if len(taken) == len(inner) else taken | {node.module}
    return targets & set(modules)


def _strong_components(graph: Mapping[str, set[str]]) -> list[set[str]]:
    """Tarjan's strongly connected components."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    components: list[set[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for target in graph[node]:
            if target not in index:
                visit(target)
                low[node] = min(low[node], low[target])
            elif target in stack:
                low[node] = min(low[node], index[target])
        if low[node] == index[node]:
            start = stack.index(node)
            components.append(set(stack[start:]))
            del stack[start:]

    for node in graph:
        if node not in index:
            visit(node)
    return components


def main(commits: list[str]) -> None:
    """Print the table."""
    columns = {commit: committed(commit) for commit in commits} or {"working tree": working_tree()}
    measured = {name: measure(sources) for name, sources in columns.items()}
    fpplab_lines = [
        f"{sum(text.count(chr(10)) for path, text in sources.items() if path.startswith('fpplab/')):,}"
        for sources in columns.values()
    ]
    print("| | " + " | ".join(columns) + " |")
    print("|---" * (len(columns) + 1) + "|")
    print("| lines of fpplab | " + " | ".join(fpplab_lines) + " |")
    for rows in zip(*(one.rows() for one in measured.values()), strict=True):
        print(f"| {rows[0][0]} | " + " | ".join(value for _, value in rows) + " |")
    for name, one in measured.items():
        for line in one.long_functions:
            print(f"{name}: long function {line}")
        for circle in one.circles:
            print(f"{name}: circle {' '.join(circle)}")


if __name__ == "__main__":
    sys.setrecursionlimit(10_000)
    main(sys.argv[1:])
