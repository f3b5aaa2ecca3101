"""The projector on an emulated wire: a command there and back, and a sequence from nothing to running."""

import tempfile
import time
from pathlib import Path
from statistics import median
from types import SimpleNamespace

import numpy as np

from benchmarks import Result, below
from drivers.clock import RealClock
from drivers.dlp4500 import Dlp4500
from drivers.dlp4500.index import FlashIndex, FlashPattern
from drivers.dlp4500.sequence import SIZE
from drivers.emulators.dlpc350 import Dlpc350, Dlpc350Policy, EmulatedHid
from fpplab.core import config
from fpplab.patterns.fringes import uniform_patterns

PATTERNS, PER_IMAGE = 36, 3
EXPOSURE_S = 0.02
ROUND_TRIPS = 2000
MOST_MS, MOST_COMMANDS = 1.0, 60


def run() -> list[Result]:
    """Measure the median of the round trips, and how many commands 36 patterns take."""
    clock = RealClock()
    patterns = uniform_patterns(list(range(PATTERNS)), SIZE)
    dark = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    hid = EmulatedHid(Dlpc350(clock, [dark] * (PATTERNS // PER_IMAGE), Dlpc350Policy(mode_change_s=0.0)))
    listed = [FlashPattern.of(p, *divmod(i, PER_IMAGE)) for i, p in enumerate(patterns)]
    with tempfile.TemporaryDirectory() as folder:
        flash = Path(folder) / "flash.yaml"
        flash.write_text(config.dump(FlashIndex(patterns=tuple(listed))), encoding="utf-8")
        bench = SimpleNamespace(hid=hid, clock=clock)
        projector = Dlp4500("projector", {"flash": str(flash)}, bench)
    with projector:
        before = hid.requests
        projector.load(patterns)
        projector.play(EXPOSURE_S)
        commands = hid.requests - before
        trips = [_round_trip(projector, hid) for _ in range(ROUND_TRIPS)]
    return [
        below("HID command there and back", 1e3 * median(trips), "ms", MOST_MS),
        below(f"{PATTERNS} patterns prepared and started", commands, "commands", MOST_COMMANDS),
    ]


def _round_trip(projector: Dlp4500, hid: EmulatedHid) -> float:
    """Seconds of one command, of those that `info` sends."""
    before, begin = hid.requests, time.perf_counter()
    projector.info()
    return (time.perf_counter() - begin) / (hid.requests - before)
