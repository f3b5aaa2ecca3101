"""`fpplab serve`: keep a rig open for scans that other programs order."""

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from fpplab.cli import console
from fpplab.cli.app import Json, RigName, app
from fpplab.cli.completion import option
from fpplab.core.extras import need_extra


@app.command("serve", rich_help_panel="system")
def serve_command(
    rig: RigName,
    calibration: Annotated[
        Path | None,
        option("--calibration", "Calibration for requests that name none. Default: calibration.yaml in OUT."),
    ] = None,
    out: Annotated[Path, option("--out", "Folder for the sessions and the record of each request.")] = Path(
        "scans"
    ),
    listen: Annotated[
        str,
        option(
            "--listen",
            "Address and port; port 0 selects a free one. Other computers need an encrypted connection.",
        ),
    ] = "127.0.0.1:0",
    certificate: Annotated[
        Path | None,
        option(
            "--certificate",
            "Folder with certificate.pem and key.pem, for encrypted connections.",
            metavar="FOLDER",
        ),
    ] = None,
    client: Annotated[
        list[str] | None,
        option("--client", "Address or network of other computers that may connect.", metavar="NETWORK"),
    ] = None,
    host: Annotated[
        list[str] | None, option("--host", "Name by which other computers address this one.", metavar="NAME")
    ] = None,
    token_file: Annotated[
        Path | None,
        option(
            "--token-file", "File with the token that clients must send. Default: a new token is created."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Keep a rig open and measure on request of other programs, until Ctrl-C.

    Devices stay open and everything is loaded, so that a scan takes only its exposures and its computation.
    `fpplab scan` with the same rig uses the service automatically. Other programs send requests over HTTP,
    or in Python with `fpplab.ServiceClient`: they are informed when the last exposure is over, then of the
    verdict, then of the report. The page /docs of the address describes the interface. Requests and results
    survive a restart of the service.

    Example: `fpplab serve --rig rig_demo --calibration calibration.yaml`
    """
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
