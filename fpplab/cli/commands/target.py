"""`fpplab target`: draw a board for printing."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Force, Json, app
from fpplab.cli.completion import existing_config, names_of, option
from fpplab.core.files import refuse_existing


@app.command("target", rich_help_panel=PREPARE)
def target_command(
    name: Annotated[
        str,
        typer.Argument(
            metavar="TARGET",
            help="Target file, or the name of a target supplied with fpplab.",
            autocompletion=names_of("target"),
            callback=existing_config("target", marks="target_marks"),
        ),
    ],
    out: Annotated[Path, option("--out --make", "Page to write: .pdf or .svg.")],
    paper: Annotated[str, option("--paper", "A4, A3, letter, or width x height in mm like 300x200.")] = "A4",
    force: Force = False,
    json: Json = False,
) -> None:
    """Draw a board or reference marks to print at true scale.

    A ruler on the sheet shows whether the printer kept the scale.

    Examples: `fpplab target target_paper --out board.pdf`; `fpplab target marks --out marks.pdf`
    """
    from fpplab.targets import Target
    from fpplab.targets.printing import print_target

    board = Target.load("target_marks" if name == "marks" else name)
    refuse_existing(out, force)
    sheet = print_target(board, out, paper, Path(name).stem)
    console.print_result(asdict(sheet), json)
