"""`python -m benchmarks [NAME] [--json]`, from a checkout."""

import sys
from dataclasses import asdict
from typing import Annotated

import typer

from benchmarks import LONG, SPEEDS, benchmark, benchmark_names
from benchmarks.machine import machine_figures
from fpplab.cli import console
from fpplab.cli.app import Json

program = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@program.command()
def benchmarks_command(
    name: Annotated[
        str | None, typer.Argument(help=f"{', '.join(benchmark_names())}; all without a name.")
    ] = None,
    json: Json = False,
) -> None:
    """Run benchmarks, each figure beside its baseline in the same run; the ratio is what counts."""
    results = []
    for one in [name] if name else [one for one in benchmark_names() if one not in LONG]:
        console.log_status(f"Running {one} …")
        results += [asdict(result) for result in benchmark(one)()]
        if one in SPEEDS:
            results += [asdict(result) for result in machine_figures()]
    rows = [list(result.values()) for result in results]
    columns = ["name", "value", "unit", "baseline", "ratio"]
    console.print_result({"results": results}, json, lambda: console.table("Benchmarks", columns, rows))


if __name__ == "__main__":
    console.run_program(program, as_json="--json" in sys.argv)
