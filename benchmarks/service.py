"""A rig that stays open: processor time from the last exposure to the verdict, and how soon its end is told.

A session of 12 frames is replayed, so that the devices take next to no time. Baselines are what is
wanted.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from benchmarks import Result, below
from benchmarks.crash.programs import ROOT
from benchmarks.last_frame_to_cloud import recorded, rig_of
from fpplab.core import config
from fpplab.patterns.plan import Plan
from fpplab.results.observer import Observer
from fpplab.service.client import ServiceClient
from fpplab.sessions.session import Session
from fpplab.workflows.instrument import Instrument

SIZES = {"2.3mp": (1920, 1200), "5mp": (2592, 1944)}
SMALL = (160, 120)
MOST_CPU_S = {"2.3mp": 0.5, "5mp": 1.1}
"""What is wanted at 2.3 megapixels, and the same per pixel at 5."""
MOST_DELAY_MS = 5.0
ROUNDS = 3
SETS = [{"axis": "x", "stripes": stripes, "steps": 4} for stripes in (1, 8, 64)]
PLAN = config.validate({"fringes": SETS, "exposure_s": 0.02}, Plan, "plan")


class CpuWatch(Observer):
    """Processor time between the last exposure and the verdict."""

    def __init__(self) -> None:
        self.exposed_s = self.judged_s = 0.0

    def exposed(self) -> None:
        self.exposed_s = time.process_time()

    def result(self, result: object) -> None:
        self.judged_s = time.process_time()


def run() -> list[Result]:
    """Measure both sizes, and the delay; two minutes on two cores."""
    return [*map(cpu_figure, SIZES), delay_figure()]


def replayed(folder: Path, size: tuple[int, int]) -> Path:
    """Record a session, and leave a rig that replays it, beside plan and calibration."""
    calibration = rig_of(size)
    recorded(folder / "session", calibration, PLAN)
    calibration.save(folder / "calibration.yaml")
    (folder / "plan.yaml").write_text(config.dump(PLAN))
    rig = {
        "name": "replay",
        "bench": {"backend": "recorded_session", "session": str(folder / "session")},
        "camera": {"backend": "replay_camera"},
        "projector": {"backend": "replay_projector"},
    }
    (folder / "rig.yaml").write_text(config.to_yaml(rig))
    return folder / "rig.yaml"


def cpu_figure(name: str) -> Result:
    """Measure one size."""
    used_s = []
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as place:
        rig = replayed(Path(place), SIZES[name])
        with Instrument.open(rig, rig.with_name("calibration.yaml"), rig.with_name("out")) as bench:
            for _ in range(1 + ROUNDS):  # the first compiles
                watch = CpuWatch()
                bench.scan(PLAN, report=False, observer=watch)
                used_s.append(watch.judged_s - watch.exposed_s)
    return below(f"exposed_to_verdict_cpu_{name}", median(used_s[1:]), "s", MOST_CPU_S[name])


@contextmanager
def served_rig(rig: Path) -> Iterator[tuple[subprocess.Popen[str], ServiceClient]]:
    """Run `fpplab serve`; gives it ready, and its client."""
    words = ["serve", "--rig", rig, "--calibration", rig.with_name("calibration.yaml")]
    command = [sys.executable, "-m", "fpplab", *map(str, words), "--out", str(rig.with_name("out")), "--json"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            where = json.loads(process.stdout.readline())
            token = json.loads(Path(where["token_file"]).read_text())["token"]
            yield process, ServiceClient(where["url"], token)
        finally:
            process.kill()


def delay_figure() -> Result:
    """Measure when a client is told that the last exposure is over; the worst of several scans counts."""
    delays_ms = []
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as place:
        rig = replayed(Path(place), SIZES["2.3mp"])
        with served_rig(rig) as (_, client):
            for _ in range(2 + ROUNDS):
                scan = client.order(str(rig.with_name("plan.yaml")))
                out = client.wait(scan, "exposed")["out"]
                told_s = time.time()
                client.wait(scan)
                delays_ms.append(1e3 * (told_s - Session.open(Path(out)).records[-1].host_time_s))
    return below("exposed_told_2.3mp", max(delays_ms[1:]), "ms", MOST_DELAY_MS)
