"""`fpplab cluster`: a scheduler and workers, on one or several computers, that measure for searches."""

import os
import sys
import threading
from contextlib import suppress
from typing import Annotated

from fpplab.cli import console
from fpplab.cli.app import CertificateFolder, Json, app
from fpplab.cli.completion import option


@app.command("cluster", rich_help_panel="system")
def cluster_command(
    listen: Annotated[
        str, option("--listen", "Address at which other computers join.")
    ] = "tcp://127.0.0.1:8786",
    join: Annotated[
        str | None, option("--join", "Join this scheduler with workers, instead of starting one.")
    ] = None,
    certificate: CertificateFolder = None,
    workers: Annotated[
        int | None,
        option("--workers", "Number of worker processes on this computer. Default: one per core.", min=0),
    ] = None,
    json: Json = False,
) -> None:
    """Start a scheduler and workers for `fpplab optimise --scheduler`, until Ctrl-C.

    Other computers add workers with --join. Anyone who can reach a scheduler can run code on its computers:
    without a certificate it only accepts connections from this computer, and with one only from clients that
    have its key.

    Example: `fpplab cluster --listen tls://192.168.1.20:8786 --certificate lab`
    """
    from fpplab.optimisation.cluster import run_workers, serve_scheduler

    count = (os.cpu_count() or 1) if workers is None else workers
    with suppress(KeyboardInterrupt):
        if join is not None:
            console.log_status(f"{count} workers for {join}; Ctrl-C ends them.")
            run_workers(join, certificate, max(1, count))
            return
        with serve_scheduler(listen, certificate, count) as address:
            console.print_result({"scheduler": address, "workers": count}, json)
            sys.stdout.flush()  # whoever reads it waits for it
            console.log_status("Ctrl-C ends it.")
            threading.Event().wait()
