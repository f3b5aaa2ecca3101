"""How fast it is."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import Json, app


@app.command()
def bench(
    name: Annotated[str | None, typer.Argument(help="One benchmark; all without a name.")] = None,
    json: Json = False,
) -> None:
    """Benchmarks, each figure beside its baseline in the same run; the ratio is what counts."""
    from benchmarks import REGISTRY, benchmark

    results = []
    for one in [name] if name else list(REGISTRY):
        console.say(f"Running {one} …")
        results += [asdict(r) for r in benchmark(one)()]
    rows = [list(r.values()) for r in results]
    columns = ["name", "value", "unit", "baseline", "ratio"]
    console.answer({"results": results}, json, lambda: console.table("Benchmarks", columns, rows))
