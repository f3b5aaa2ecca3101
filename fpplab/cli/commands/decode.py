"""`fpplab decode`: projector coordinates of a session."""

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import AsRecorded, Force, Json, LimitsOption, Out, app
from fpplab.cli.completion import existing_data, option
from fpplab.cli.viewing import ConsoleObserver

KnownCoordinates = Annotated[
    list[str] | None,
    option(
        "--known",
        "Known projector coordinate of a camera pixel, for plans with spatial unwrapping; may be repeated.",
        metavar="COLUMN,ROW,PX",
    ),
]


@app.command("decode", rich_help_panel="data")
def decode_command(
    session: Annotated[Path, typer.Argument(help="Recorded session.", callback=existing_data)],
    out: Out,
    known: KnownCoordinates = None,
    reference: Annotated[
        Path | None,
        option(
            "--reference",
            "Session of a flat reference plane recorded with the same plan; heights are then given above it.",
        ),
    ] = None,
    plane: Annotated[
        Path | None,
        option("--plane", "File with the positions of camera and projector relative to the plane."),
    ] = None,
    as_recorded: AsRecorded = False,
    limits: LimitsOption = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Decode a session to projector coordinates for every camera pixel, as NPZ.

    Arrays `u`, `v` (projector pixels), `modulation` (grey levels of 255) and `sigma` (projector pixels),
    float32, NaN where nothing was measured. A plan that does not describe the frames is refused, with the
    correction. `verdict` says whether the maps can be trusted, `findings` why not; unusable maps are not
    written and the exit code is 4, unless `--as-recorded` is given. With spatial unwrapping, `island`
    numbers the connected regions, negative where the fringe order is unknown. With `--reference` and
    `--plane` the file also has `height_mm` and `sigma_height_mm`, and `--known` takes heights.
    """
    from fpplab.diagnosis import load_limits
    from fpplab.pipeline.decoding import parse_known
    from fpplab.workflows.maps import DecodingRequest, run_decoding

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
