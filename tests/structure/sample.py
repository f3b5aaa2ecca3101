"""Functions drawn at random, to judge whether name and signature alone say what they do.

`python -m tests.structure.sample --seed 1` prints places and signatures; with `--bodies` the whole functions.
"""

import argparse
import ast
import random
from collections.abc import Iterator

from tests.structure.measure import Sources, working_tree

Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions(sources: Sources) -> Iterator[tuple[str, Function]]:
    """Give all functions of at least three statements that override nothing, with their places."""
    for path, text in sorted(sources.items()):
        for place, node in _functions_of(ast.parse(text).body, ""):
            decorators = {ast.unparse(decorator) for decorator in node.decorator_list}
            if len(node.body) >= 3 and "override" not in decorators:
                yield f"{path}:{node.lineno}: {place}", node


def _functions_of(body: list[ast.stmt], prefix: str) -> Iterator[tuple[str, Function]]:
    for node in body:
        if isinstance(node, ast.ClassDef):
            yield from _functions_of(node.body, f"{prefix}{node.name}.")
        elif isinstance(node, Function):
            yield f"{prefix}{node.name}", node


def drawn(seed: int, count: int) -> list[tuple[str, Function]]:
    """Draw functions without replacement; the same for a seed as long as the sources are the same."""
    return random.Random(seed).sample(list(functions(working_tree())), count)


def signature(node: Function) -> str:
    """Write a function's name, parameters and result in one line."""
    result = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"def {node.name}({ast.unparse(node.args)}){result}"


def main() -> None:
    """Print what was drawn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--bodies", action="store_true", help="the whole functions")
    options = parser.parse_args()
    for place, node in drawn(options.seed, options.count):
        print(f"{place}\n    {ast.unparse(node) if options.bodies else signature(node)}\n")


if __name__ == "__main__":
    main()
