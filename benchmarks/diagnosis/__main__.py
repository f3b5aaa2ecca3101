"""`python -m benchmarks.diagnosis`, from a checkout: the benchmark or a part of it, with any seeds."""

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.diagnosis import COUNT, JUDGES, JUDGING_SEED, Selection, measure
from fpplab.cli import console
from fpplab.cli.app import Json

program = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@program.command()
def diagnosis_command(
    seed: Annotated[int, typer.Option(help="The first; others are counted from it.", min=0)] = JUDGING_SEED,
    count: Annotated[int, typer.Option(help="Benches of each fault.", min=1)] = COUNT,
    causes: Annotated[
        str, typer.Option(help=f"Only these, with commas between them: {', '.join(JUDGES)}.")
    ] = "",
    record: Annotated[
        Path | None,
        typer.Option(help="Write each outcome here as it comes; the same command goes on from there."),
    ] = None,
    json: Json = False,
) -> None:
    """Judge benches with and without faults, and say which faults were named."""
    results = measure(Selection(seed, count, tuple(causes.split(",")) if causes else (), record))
    rows = [list(asdict(one).values()) for one in results]
    columns = ["name", "value", "unit", "baseline", "ratio"]
    answer = {"results": [asdict(one) for one in results]}
    console.print_result(answer, json, lambda: console.table("Diagnosis", columns, rows))


if __name__ == "__main__":
    console.run_program(program, as_json="--json" in sys.argv)
