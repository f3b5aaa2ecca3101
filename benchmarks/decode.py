"""Decoding: speed beside plain NumPy and the package `fringes`, bandwidth, peak memory.

36 frames of 5472 x 3648 pixels, 8 bit (12 steps of 1, 8 and 64 stripes along x), in
uncompressed TIFF files, memory-mapped. Product and baseline run in turn on the same
frames, which lie in the page cache; each figure is the median of its repetitions.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from types import TracebackType

import numpy as np
import psutil
import tifffile
from numpy.typing import NDArray

from benchmarks import Result
from benchmarks.machine import read_memory
from benchmarks.peak import peak_of
from fpplab.core.conventions import TWO_PI, Lattice, Map, Mask
from fpplab.core.errors import DataError
from fpplab.core.system import cache_directory
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode

CAMERA = (5472, 3648)
PROJECTOR = (912, 1140)
STRIPES, STEPS = (1, 8, 64), 12
PLAN = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=STEPS) for s in STRIPES))
REPEATS, BASELINE_REPEATS = 9, 3

FrameStack = list[NDArray[np.uint8]]


def run() -> list[Result]:
    """Measure decoding."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        paths = write_benchmark_frames(Path(folder), CAMERA)
        frames = [np.asarray(tifffile.memmap(p, mode="r")) for p in paths]
        _product(frames)  # compile, and map the files
        results = [_versus_numpy(frames), _bandwidth(frames), _memory(paths)]
        return [results[0], _versus_fringes(frames, paths), *results[1:]]


def write_benchmark_frames(folder: Path, size: tuple[int, int]) -> list[Path]:
    """Write a camera's view of the projector filling its width, with shading and noise, as TIFF files."""
    # size (width, height) px
    width, height = size
    columns = np.minimum(np.arange(width) * PROJECTOR[0] // width, PROJECTOR[0] - 1)
    shading = np.linspace(0.6, 1.0, height)[:, None]
    generator = np.random.default_rng(1)
    noise = generator.normal(0.5, 1.5, size=(height, 2 * width)).astype(np.float32)
    paths = []
    for index, step, name in PLAN.steps():
        row = PLAN.fringes[index].level(step, (PROJECTOR[0], 1), Lattice.SQUARE)[0, columns]
        start = generator.integers(width)
        image = (20 + 200 * shading * row + noise[:, start : start + width]).astype(np.uint8)
        paths.append(folder / f"{name}.tif")
        tifffile.imwrite(paths[-1], image)
    return paths


def _product(frames: Sequence[NDArray[np.uint8]]) -> None:
    decode(Recording(frames, PLAN, PROJECTOR))


def plain_numpy(frames: FrameStack) -> tuple[Map, Map, Mask]:
    """Decode as one writes it down in vectorised NumPy: the baseline."""
    # returns coordinate, modulation (height, width), mask (height, width)
    stack = np.stack(frames).astype(np.float32)
    shift = (TWO_PI * np.arange(STEPS) / STEPS).astype(np.float32)
    saturated = (stack >= 255).any(axis=0)
    phases, modulations = [], []
    for k in range(len(STRIPES)):
        images = stack[k * STEPS : (k + 1) * STEPS]
        s = np.tensordot(np.sin(shift), images, axes=1)
        c = np.tensordot(np.cos(shift), images, axes=1)
        phases.append(np.mod(np.arctan2(s, c), np.float32(TWO_PI)))
        modulations.append(np.float32(2 / STEPS) * np.sqrt(s**2 + c**2))
    absolute = phases[0]
    for k in range(1, len(STRIPES)):
        expected = absolute * np.float32(STRIPES[k] / STRIPES[k - 1])
        order = np.round((expected - phases[k]) / np.float32(TWO_PI))
        absolute = phases[k] + np.float32(TWO_PI) * order
    u = absolute * np.float32(PROJECTOR[0] / (TWO_PI * STRIPES[-1])) - np.float32(0.5)
    valid = ~saturated & (np.min(modulations, axis=0) >= PLAN.masks.modulation_min)
    u[~valid] = np.nan
    return u, modulations[-1], valid


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _in_turn(
    product: Callable[[], object], baseline: Callable[[], float], name: str, rounds: int = BASELINE_REPEATS
) -> Result:
    """Median seconds of both; the baseline reports its own time, the product runs between."""
    own: list[float] = []
    other: list[float] = []
    for _ in range(rounds):
        own += [_seconds(product) for _ in range(REPEATS // rounds)]
        other.append(baseline())
    return Result(name, median(own), "s", median(other), median(other) / median(own))


def _versus_numpy(frames: FrameStack) -> Result:
    return _in_turn(
        lambda: _product(frames), lambda: _seconds(lambda: plain_numpy(frames)), "decode_vs_numpy"
    )


def _versus_fringes(frames: FrameStack, paths: list[Path]) -> Result:
    with _FringesProcess(paths) as baseline:
        return _in_turn(lambda: _product(frames), baseline.seconds, "decode_vs_fringes")


def _bandwidth(frames: FrameStack) -> Result:
    """GB of frames per second while decoding, beside plain reading of the same frames."""
    size = sum(f.nbytes for f in frames)
    result = _in_turn(
        lambda: _product(frames),
        lambda: _seconds(lambda: read_memory(frames, os.cpu_count() or 1)),
        "",
        REPEATS,
    )
    value, machine = size / result.value / 1e9, size / result.baseline / 1e9
    return Result("decode_bandwidth", value, "GB/s", machine, value / machine)


def _memory(paths: list[Path]) -> Result:
    """Growth of a fresh process while decoding, in units of the frames and five float32 maps."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        peak = pool.apply(_peak_growth, (paths,))
    pixels = CAMERA[0] * CAMERA[1]
    allowed = pixels * (PLAN.images + 5 * 4)
    return Result("decode_peak_memory", peak / allowed, "frames + 5 maps", 1.0, allowed / peak)


def _peak_growth(paths: list[Path]) -> int:
    """Bytes that mapping and decoding the frames add to this process at most."""
    _product([np.zeros((64, 64), np.uint8) for _ in range(PLAN.images)])
    process = psutil.Process()
    before = process.memory_info().rss
    with peak_of(lambda: process.memory_info().rss, 0.001) as peak:
        frames = [np.asarray(tifffile.memmap(p, mode="r")) for p in paths]
        decoded = decode(Recording(frames, PLAN, PROJECTOR))
    assert decoded.valid.any()
    return peak[0] - before


_FRINGES_SCRIPT = """
import json, sys, time
import numpy as np, tifffile
from fringes import Fringes

task = json.loads(sys.argv[1])
f = Fringes()
f.X, f.Y, f.D = task["projector"][0], task["projector"][1], 1
f.K = len(task["stripes"])
f.v = task["stripes"]
f.N = task["steps"]
f.p0 = 0.0
stack = np.stack([tifffile.imread(p) for p in task["paths"]])
f.decode(stack[:, :64, :64].copy())
print("ready", flush=True)
for _ in sys.stdin:
    start = time.perf_counter()
    f.decode(stack, bmin=task["modulation_min"])
    print(time.perf_counter() - start, flush=True)
"""


class _FringesProcess:
    """The package `fringes` in an environment of its own, compiled and warm, frames in memory."""

    def __init__(self, paths: list[Path]) -> None:
        task = {
            "projector": PROJECTOR,
            "stripes": STRIPES,
            "steps": STEPS,
            "modulation_min": PLAN.masks.modulation_min,
            "paths": [str(p) for p in paths],
        }
        command = [str(_fringes_python()), "-c", _FRINGES_SCRIPT, json.dumps(task)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

    def __enter__(self) -> _FringesProcess:
        self._answer()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.communicate()

    def seconds(self) -> float:
        """One decoding, without compilation."""
        assert self._process.stdin is not None
        self._process.stdin.write("go\n")
        self._process.stdin.flush()
        return float(self._answer())

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise DataError(
                f"decode_vs_fringes: the package 'fringes' in {_environment()} does not run; "
                "remove that directory, and it is installed anew"
            )
        return line.strip()


def _environment() -> Path:
    """Where the baseline is installed."""
    return cache_directory() / "bench-fringes"


def _fringes_python() -> Path:
    """The interpreter of the baseline's environment, which is made if it is not there."""
    folder = _environment()
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if _succeeds([str(python), "-c", "import fringes, tifffile"]):
        return python
    print("making an environment for the package 'fringes' …", file=sys.stderr)
    make = [sys.executable, "-m", "venv", "--clear", str(folder)]
    install = [str(python), "-m", "pip", "install", "--quiet", "fringes", "tifffile"]
    if not (_succeeds(make) and _succeeds(install)):
        raise DataError(
            "decode_vs_fringes: the package 'fringes' could not be installed; "
            "connect to the network, or run without this comparison"
        )
    return python


def _succeeds(command: list[str]) -> bool:
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False
