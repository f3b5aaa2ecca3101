"""A scan with the viewer beside the same scan without it, and beside one whose viewer is killed on the way.

Whole commands, timed from their start to their end: `fpplab scan` from a recorded session, whose frames come
as fast as they are read. That is the hardest case: with an instrument the same viewer has the time of the
exposures too. Each round runs all kinds in turn, and the fastest of each kind counts, since whatever else the
computer does only adds time. The processor time is that of the measuring process alone.
"""

import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil

from benchmarks import Result, above
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.devices.rig import Rig
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_or_resume_session
from sim.world import World

ROUNDS = 3
MOST = 1.05
"""Greatest time of a scan with its viewer, over that of the same scan without."""
WORLD = "world_demo.yaml"
KINDS = ("plain", "viewer", "killed viewer")

Times = dict[str, float]
"""Seconds by what they are."""


def run() -> list[Result]:
    """Measure; some three minutes on two cores."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        words = _prepared(folder)
        _scanned(words, folder / "first")  # compiles what is compiled once
        rounds = [_round(words, folder / f"round_{k}") for k in range(ROUNDS)]
    found = []
    for what, unit in (("wall time", "s"), ("own processor time", "s")):
        least = {kind: min(one[kind][what] for one in rounds) for kind in KINDS}
        for kind in KINDS[1:]:
            share = least[kind] / least["plain"]
            found.append(Result(f"scan, {kind}, {what}", least[kind], unit, least["plain"], 1.0 / share))
            found.append(above(f"scan, {kind}, {what}: allowed over taken", MOST / share, "", 1.0))
    return found


def _prepared(folder: Path) -> list[str]:
    """Record a session; return the words of a scan that replays it, without `--out`."""
    world = World.load(WORLD)
    truth = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})
    truth.save(folder / "calibration.yaml")
    with Rig.load("rig_demo") as rig:
        take_or_resume_session(rig, Plan.load("plan_paper"), folder / "session", ("pyramid", 0))
    rig_file = {
        "name": "Replay",
        "bench": {"backend": "fpplab.sessions.replay:RecordedSession", "session": str(folder / "session")},
        "camera": {"backend": "fpplab.sessions.replay:ReplayCamera"},
        "projector": {"backend": "fpplab.sessions.replay:ReplayProjector"},
    }
    (folder / "rig.yaml").write_text(config.to_yaml(rig_file))
    command = [sys.executable, "-m", "fpplab", "scan", "--rig", str(folder / "rig.yaml")]
    return [*command, "--calibration", str(folder / "calibration.yaml")]


def _round(words: list[str], folder: Path) -> dict[str, Times]:
    """Seconds of each kind of scan."""
    folder.mkdir()
    return {
        "plain": _scanned(words, folder / "plain"),
        "viewer": _scanned([*words, "--view"], folder / "viewer"),
        "killed viewer": _scanned([*words, "--view"], folder / "killed", kill=True),
    }


def _scanned(words: list[str], out: Path, kill: bool = False) -> Times:
    """Seconds of one scan; its viewer is killed once all frames are taken, if that is wanted."""
    started = time.perf_counter()
    with subprocess.Popen(
        [*words, "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "DISPLAY": "", "WAYLAND_DISPLAY": ""},
    ) as program:
        killed = threading.Event()
        reader = threading.Thread(target=_follow, args=(program, kill, killed))
        reader.start()
        os.waitid(os.P_PID, program.pid, os.WEXITED | os.WNOWAIT)
        seconds = time.perf_counter() - started
        own = psutil.Process(program.pid).cpu_times()  # known until it is waited for
        code = program.wait()
        reader.join()
    if code != 0 or (kill and not killed.is_set()):
        raise RuntimeError(
            f"the scan ended with {code}, its viewer {'' if killed.is_set() else 'not '}killed"
        )
    return {"wall time": seconds, "own processor time": own.user + own.system}


def _follow(program: subprocess.Popen[str], kill: bool, killed: threading.Event) -> None:
    """Read what the scan says; kill what draws once all frames are taken."""
    assert program.stderr is not None
    for line in program.stderr:
        if kill and line.startswith("Reconstructing") and not killed.is_set():
            for child in psutil.Process(program.pid).children():
                child.kill()
                killed.set()
