"""A service over a thousand scans, and one that is killed fifty times: nothing grows, and nothing is lost."""

import random
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks import Result, below
from benchmarks.service import SMALL, replayed, served_rig
from fpplab.service.client import ServiceClient, ServiceError
from fpplab.sessions.session import Session

SCANS, SETTLED = 1000, 50
"""Scans of one service, and those after which nothing may grow."""
REPORT_EVERY = 10  # scans: a report takes twice the time of a scan
KILLS = 50
MOST_GROWTH = 1.01
LONGEST_S = 6.0
"""When at the latest a service is killed: a scan with its report takes three seconds."""


def run() -> list[Result]:
    """Measure; ten minutes of processor time, and more on a disk that is slow to flush."""
    return [*growth_figures(SCANS, SETTLED), below("lost_in_50_kills", lost_in_kills(KILLS), "", 1.0)]


def growth_figures(scans: int, settled: int) -> list[Result]:
    """Compare memory and handles of a service after its last scan with those once it has settled."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as place:
        rig = replayed(Path(place), SMALL)
        with served_rig(rig) as (process, client):
            held = psutil.Process(process.pid)
            for number in range(1, scans + 1):
                has_report = number % REPORT_EVERY == 0
                client.wait(client.order(str(rig.with_name("plan.yaml")), report=has_report))
                if number == settled:
                    before = _held_by(held)
            after = _held_by(held)
    return [
        below(f"memory_after_{scans}_scans", after[0] / before[0], "", MOST_GROWTH),
        below(f"more_handles_after_{scans}_scans", float(after[1] - before[1]), "", 1.0),
    ]


def _held_by(process: psutil.Process) -> tuple[int, int]:
    """Memory in bytes, and handles."""
    return process.memory_info().rss, process.num_fds()


def lost_in_kills(kills: int) -> float:
    """Count orders that nobody knows of after a kill, and sessions that cannot be read."""
    lost, accepted, draw = 0, set[int](), random.Random(1)
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as place:
        rig = replayed(Path(place), SMALL)
        for _ in range(kills):
            with served_rig(rig) as (process, client):
                lost += _unknown(client, accepted)
                accepted |= {client.order(str(rig.with_name("plan.yaml"))) for _ in range(2)}
                time.sleep(draw.uniform(0.0, LONGEST_S))
                process.kill()
        with served_rig(rig) as (_, client):
            lost += _unknown(client, accepted)
            for session in (Path(place) / "out").glob("scan_*"):
                Session.open(session).missing()
    return float(lost)


def _unknown(client: ServiceClient, accepted: set[int]) -> int:
    """Count the orders that a service does not know, or whose finished result it has lost."""
    lost = 0
    for number in accepted:
        try:
            status = client.show(number)
        except ServiceError:
            lost += 1
        else:
            lost += status["state"] == "finished" and status["result"] is None
    return lost
