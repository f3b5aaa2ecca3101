"""`fpplab decode`: projector coordinates of a session."""

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import MEASURE, AsRecorded, Force, Json, LimitsOption, Out, app
from fpplab.cli.viewing import ConsoleObserver

KnownCoordinates = Annotated[
    list[str] | None,
    typer.Option(
        "--known",
        metavar="COLUMN,ROW,PX",
        help="A camera pixel and its projector coordinate, for fringes that neighbours unwrap; repeatable.",
    ),
]


@app.command("decode", rich_help_panel=MEASURE)
def decode_command(
    session: Annotated[Path, typer.Argument(help="A recorded session.")],
    out: Out,
    known: KnownCoordinates = None,
    reference: Annotated[
        Path | None,
        typer.Option("--reference", help="Session of a plane by the same plan, to give heights over it."),
    ] = None,
    plane: Annotated[
        Path | None, typer.Option("--plane", help="File that says how the devices stand over the plane.")
    ] = None,
    as_recorded: AsRecorded = False,
    limits: LimitsOption = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Projector coordinates of every camera pixel, as NPZ.

    Arrays `u`, `v` (projector pixels), `modulation` (grey levels of 255) and `sigma` (projector
    pixels), float32, NaN where not measured. A plan that does not describe the frames is refused,
    with what to write instead. `verdict` says whether to believe the maps, `findings` why not;
    useless ones are not written, and the exit code is 4, but with `--as-recorded`. Where neighbours unwrap
    the fringes, `island` numbers what they connect, negative where the fringe order is unknown. With
    `--reference` and `--plane` there are `height_mm` and `sigma_height_mm`, and `--known` takes heights.
    """
    from fpplab.diagnosis import load_limits
    from fpplab.pipeline import parse_known
    from fpplab.workflows.decode import DecodingRequest, run_decoding

    request = DecodingRequest(
        session,
        out,
        as_recorded,
        force,
        load_limits(limits) if limits else None,
        parse_known(known or ()),
        reference,
        plane,
    )
    result = run_decoding(request, ConsoleObserver())
    result.require_usable()
    console.log_status(result.diagnosis.sentence)
    console.print_result(result.summary(), json)
