"""`fpplab serve`: keep a rig open for scans that other programs order."""

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from fpplab.cli import console
from fpplab.cli.app import MEASURE, Json, RigName, app
from fpplab.cli.completion import option


@app.command("serve", rich_help_panel=MEASURE)
def serve_command(
    rig: RigName,
    calibration: Annotated[
        Path | None, option("--calibration", "For orders that name none; by default calibration.yaml in OUT.")
    ] = None,
    out: Annotated[Path, option("--out", "Folder of the sessions, and of what became of each order.")] = Path(
        "scans"
    ),
    listen: Annotated[
        str, option("--listen", "Address; port 0 is any that is free. Beyond this computer it is encrypted.")
    ] = "127.0.0.1:0",
    certificate: Annotated[
        Path | None,
        option("--certificate", "Of certificate.pem and key.pem, to be reached encrypted.", metavar="FOLDER"),
    ] = None,
    client: Annotated[
        list[str] | None,
        option("--client", "Address or network of other computers that may ask.", metavar="NETWORK"),
    ] = None,
    host: Annotated[
        list[str] | None, option("--host", "Name by which other computers call this one.", metavar="NAME")
    ] = None,
    token_file: Annotated[
        Path | None, option("--token-file", "Of the token that clients send; by default a new one is made.")
    ] = None,
    json: Json = False,
) -> None:
    """Keep a rig open, and measure what other programs order, until Ctrl-C.

    Devices stay open and all is loaded: a scan takes its exposures and the time of its points. `fpplab scan`
    with the same rig uses the service by itself. Other programs order over HTTP, or in Python by
    `fpplab.ServiceClient`: they are told when the last exposure is over, then the verdict, then the report.
    The address's page /docs describes it. Orders and results outlive the service.

    Example: `fpplab serve --rig rig_demo --calibration calibration.yaml`
    """
    from fpplab.core.extras import need_extra

    for module in ("uvicorn", "fastapi", "fastapi_offline"):
        need_extra(module)
    from fpplab.service.queue import ScanQueue
    from fpplab.service.serving import ServiceAddress, make_token, serving
    from fpplab.workflows.instrument import Instrument

    address = ServiceAddress.parse(listen, certificate, host or [], client or [])
    token = make_token(token_file)
    out = out.resolve()
    bench = Instrument.open(rig, calibration.resolve() if calibration else None, out)
    queue = ScanQueue(bench, out)
    sys.stdin = open(os.devnull)  # noqa: SIM115 - nobody is asked at a terminal: an order agrees in advance
    with suppress(KeyboardInterrupt), bench, serving(queue, bench.rig, address, token) as where:
        console.print_result(where, json)
        sys.stdout.flush()  # whoever reads it waits for it
        console.log_status("Ctrl-C ends it.")
        queue.work()
