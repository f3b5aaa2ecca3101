"""`fpplab sample`: a small data set with its truth."""

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import START, Force, Json, app
from fpplab.cli.viewing import ConsoleObserver


@app.command("sample", rich_help_panel=START)
def sample_command(
    folder: Annotated[Path, typer.Argument(help="Folder to write the data set to.")],
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a small data set with its truth, for teaching.

    FOLDER gets a board in 8 poses, the calibration from them, a pyramid under phase-shifted fringes and under
    Gray code, and what no bench can know: the true calibration, surface and depth. All is recorded on the
    virtual bench in about a minute; `README.md` in FOLDER says what each file is.
    Other programs can be tried on it. An interrupted run is completed by the same command.

    Example: `fpplab sample lesson`
    """
    from fpplab.workflows.sample import SampleRequest, make_sample

    console.print_result(make_sample(SampleRequest(folder, force), ConsoleObserver()), json)
