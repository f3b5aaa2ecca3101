"""Scans ended at many moments and resumed, beside the same scan undisturbed.

A scan of the twin is ended by SIGINT, SIGTERM and SIGKILL in turn, at moments spread evenly over its whole
life, and then run again to its end. Frames, decoded maps, cloud and calibration of the resumed session must
be those of the undisturbed one, byte for byte; the journal but for its time stamps. A signal must end the
scan with exit code 130 and no traceback, or come before the program's first line, where Python answers
itself.
"""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks import Result, below
from fpplab.calibration.model import Calibration
from fpplab.core.session_names import CALIBRATION, CLOUD, DECODED, FRAMES, JOURNAL, PLAN, REPORT, RIG
from sim.world import World

MOMENTS = 200
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
FAULTS = ("wrong exit codes", "tracebacks", "sessions not resumed", "sessions that differ")
LOADED_S = 0.15
"""Until when Python may not have come to the program's first line."""
RIG_TEXT = """name: twin
bench: {backend: "sim.devices:VirtualBench", world: world_demo.yaml, binning: 8, analytic: true}
camera: {backend: "sim.devices:SimCamera", bits: 8}
projector: {backend: "sim.devices:SimProjector"}
fixture: {backend: "sim.devices:SimFixture"}
"""


def run() -> list[Result]:
    """End and resume 200 scans; half an hour on two cores.

    Returns
    -------
    list of Result
        Numbers of failures, each beside 0.
    """
    return crash_figures(MOMENTS)


def crash_figures(moments: int) -> list[Result]:
    """End and resume some scans.

    Parameters
    ----------
    moments : int
        How many.

    Returns
    -------
    list of Result
        As `run` gives them.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "rig.yaml").write_text(RIG_TEXT, encoding="utf-8")
        _calibration(World.load("world_demo.yaml").binned(8)).save(folder / CALIBRATION)
        _scan(folder, folder / "warm").communicate()
        start = time.perf_counter()
        _scan(folder, folder / "whole").communicate()
        seconds, expected = time.perf_counter() - start, _content(folder / "whole")
        counts = dict.fromkeys(FAULTS, 0)
        for n in range(moments):
            out = folder / f"ended_{n}"
            fault = _end_and_resume(folder, out, seconds * (n + 0.5) / moments, SIGNALS[n % 3], expected)
            for name in fault:
                counts[name] += 1
    return [below(f"{name} of {moments}", count, "", 0) for name, count in counts.items()]


def _calibration(world: World) -> Calibration:
    return Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})


def _scan(folder: Path, out: Path) -> subprocess.Popen[str]:
    words = ["scan", "--rig", "rig.yaml", "--calibration", CALIBRATION, "--item", "board", "--out", str(out)]
    return subprocess.Popen(
        [sys.executable, "-m", "fpplab", *words, "--json"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _end_and_resume(
    folder: Path, out: Path, moment_s: float, number: signal.Signals, expected: dict[str, str]
) -> list[str]:
    """Names of what went wrong."""
    faults = []
    process = _scan(folder, out)
    time.sleep(moment_s)
    process.send_signal(number)
    _, err = process.communicate()
    early = moment_s < LOADED_S
    if process.returncode not in ((-number,) if number is signal.SIGKILL else (130,)):
        ended = process.returncode == 0 and (out / REPORT).is_file()  # it was faster than the signal
        faults += [] if ended or (early and process.returncode in (-number, 1)) else ["wrong exit codes"]
    faults += ["tracebacks"] if "Traceback" in err and not early else []
    if not (out / REPORT).is_file():
        resumed = _scan(folder, out)
        _, err = resumed.communicate()
        faults += ["sessions not resumed"] if resumed.returncode else []
    if faults:
        sys.stderr.write(f"{number.name} at {moment_s:.3f} s: {', '.join(faults)}\n{err[-2000:]}\n")
    return faults if _content(out) == expected else [*faults, "sessions that differ"]


def _content(session: Path) -> dict[str, str]:
    """Checksums of all that a scan leaves but its report, without time stamps."""
    if not (session / JOURNAL).is_file():
        return {}
    names = [CALIBRATION, CLOUD, DECODED, PLAN, RIG, *sorted(p.name for p in session.glob(".*"))]
    files = [session / name for name in names] + sorted((session / FRAMES).iterdir())
    sums = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files if path.is_file()}
    lines = [json.loads(line) for line in (session / JOURNAL).read_text(encoding="utf-8").splitlines()]
    for line in lines:
        line["host_time_s"] = line["device_time_s"] = None
    return {**sums, JOURNAL: json.dumps(sorted(lines, key=lambda line: int(line["index"])))}
