"""The twin's three ways to a picture beside each other, and what the full sensor takes.

Scene: stairs that fill the frame, with the shadows of their risers, seen by the demonstration's bench; 12
steps of 1, 8 and 64 stripes; every image goes through the virtual camera as in a measurement, sensor
included. Nothing is found on disk that an earlier run left.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks import Result, below
from benchmarks.peak import peak_of
from fpplab.artefacts.shapes.steps import Staircase
from fpplab.cli import console
from fpplab.core import config
from fpplab.devices import CameraSettings
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from sim.bench import VirtualBench
from sim.devices import SimCamera, SimProjector
from sim.light import PatternLevels, ShownPattern
from sim.world import World

STRIPES, OTHERS, STEPS = (1, 8, 64), (1, 7, 50), 12
SETTINGS = CameraSettings(0.02)
LINEAR_MAX, TRANSPORT_RMS, TRANSPORT_BEYOND = 0.2, 0.5, 1e-3
"""Greatest differences from reference that are allowed: grey levels of 255, and the share beyond one."""
MEMORY_GIB = 12.0
COARSER = (4, 2, 1)
EVERY = 4
"""Of the images by reference one in so many is rendered. Each is a render of its own, so all take so many
times as long."""


def run(binning: int = 4) -> list[Result]:
    """Measure the twin; at the standard binning it takes some eight minutes on two cores.

    The agreements' baseline is what is allowed, that of time and memory at the full sensor size what they
    are for each sample at a sixteenth of its pixels.
    """
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        return [*_paths(Path(folder), binning), *_full_size(Path(folder))]


class _Rig:
    """Camera and projector of one world, open."""

    def __init__(self, folder: Path, **render: Any) -> None:
        path = folder / f"{'-'.join(map(str, render.values()))}.yaml"
        path.write_text(config.to_yaml(_world(folder, **render)))
        self.bench = VirtualBench({"world": str(path)})
        self.camera = SimCamera("camera", {}, self.bench)
        self.projector = SimProjector("projector", {}, self.bench)

    def __enter__(self) -> _Rig:
        for part in (self.bench, self.camera, self.projector):
            part.open()
        self.camera.configure(SETTINGS)
        self.bench.blender.start()
        return self

    def __exit__(self, *fault: object) -> None:
        for part in (self.projector, self.camera, self.bench):
            part.close()

    def patterns(self, stripes: tuple[int, ...]) -> tuple[Pattern, ...]:
        plan = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=STEPS) for s in stripes))
        caps = self.projector.caps
        return make_patterns(plan, caps.size, caps.lattice)

    def measure(self, stripes: tuple[int, ...], what: str, every: int = 1) -> float:
        """Seconds for the images of a measurement, or for one in `every`."""
        patterns = self.patterns(stripes)
        start = time.perf_counter()
        with console.progress(what) as report:
            self.projector.load(patterns)
            for i in range(0, len(patterns), every):
                self.projector.show(i)
                self.camera.snap()
                report((i + 1) / len(patterns))
        return time.perf_counter() - start

    def pictures(self, stripes: tuple[int, ...]) -> list[PatternLevels]:
        """What reached the sensor in one image of `EVERY`: grey levels of 255, white at full scale."""
        patterns = self.patterns(stripes)
        return [
            255 * self.bench.light.irradiance(self.bench.setup, ShownPattern(patterns, i))
            for i in range(0, len(patterns), EVERY)
        ]


def _world(folder: Path, **render: Any) -> dict[str, Any]:
    data = World.load("world_demo.yaml").model_dump(mode="json")
    data["camera"]["binning"] = render.pop("binning")
    part = folder / "stairs.stl"
    if not part.exists():
        Staircase((210.0, 150.0), (5.0, 10.0, 15.0, 20.0, 25.0)).mesh().export(part)
    pose = {"rotation_deg": [180, 0, 0], "translation_mm": [0, 0, 460]}
    data |= {"items": {"part": {"mesh": str(part), "pose": pose}}, "mounted": "part", "ambient": 0.0}
    data["render"] = render
    return data


def _paths(folder: Path, binning: int) -> list[Result]:
    effort = {"binning": binning, "subpixels": 4, "cache": False}
    with _Rig(folder, path="transport", **effort) as warm:
        warm.measure(STRIPES, "Compiling")  # what is compiled once must not be counted
    times: dict[str, float] = {}
    seen: dict[str, list[PatternLevels]] = {}
    with _Rig(folder, path="transport", **effort) as rig:
        times["transport"] = rig.measure(STRIPES, "Transport")
        seen["transport"] = rig.pictures(STRIPES)
        times["again"] = rig.measure(OTHERS, "Transport, other stripes")
    with _Rig(folder, path="linear", **effort) as rig:
        times["linear"] = rig.measure(STRIPES, "Linear")
        seen["linear"] = rig.pictures(STRIPES)
    with _Rig(folder, path="reference", **effort) as rig:
        times["reference"] = EVERY * rig.measure(STRIPES, f"Reference, 1 image of {EVERY}", EVERY)
        truth = rig.pictures(STRIPES)
    return [*_speeds(times), *_agreements(seen, truth)]


def _speeds(times: dict[str, float]) -> list[Result]:
    slow = times["reference"]
    return [
        Result(f"twin_{way}_vs_reference", times[way], "s", slow, slow / times[way])
        for way in ("linear", "transport", "again")
    ]


def _agreements(seen: dict[str, list[PatternLevels]], truth: list[PatternLevels]) -> list[Result]:
    errors = {way: np.abs(np.stack(pictures) - np.stack(truth)) for way, pictures in seen.items()}
    greatest = float(errors["linear"].max())
    rms = float(np.sqrt(np.mean(errors["transport"] ** 2)))
    beyond = float(np.mean(errors["transport"] > 1))
    return [
        below("twin_linear_error", greatest, "grey level", LINEAR_MAX),
        below("twin_transport_error", rms, "grey level RMS", TRANSPORT_RMS),
        below("twin_transport_beyond_1", beyond, "share", TRANSPORT_BEYOND),
    ]


def _full_size(folder: Path) -> list[Result]:
    """36 images at 4 samples per pixel and rising sizes, each in a process of its own."""
    samples: list[float] = []
    seconds: list[float] = []
    seconds_again = 0.0
    memory: list[float] = []
    for binning in COARSER:
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            pixels, spent, seconds_again, peak = pool.apply(_measured, (folder, binning))
        samples.append(4 * pixels)
        seconds.append(spent)
        memory.append(peak)
        console.log_status(f"{pixels / 1e6:.2f} M pixels x 4 samples: {spent:.1f} s, {peak / 2**30:.2f} GiB")
    per_sample = [s / n for s, n in zip(seconds, samples, strict=True)]
    bytes_per_sample = [m / n for m, n in zip(memory, samples, strict=True)]
    whole = memory[-1] / 2**30  # of this process and Blender together
    return [
        below("twin_full_size_memory", whole, "GiB", MEMORY_GIB),
        Result("twin_full_size_again", seconds_again, "s", seconds[-1], seconds[-1] / seconds_again),
        _growth("twin_full_size_time", per_sample, 1e6, "s / M samples"),
        _growth("twin_full_size_bytes", bytes_per_sample, 1, "bytes / sample"),
    ]


def _growth(name: str, each: list[float], scale: float, unit: str) -> Result:
    """Of the full size beside the smallest: linear growth, or less, has a ratio of one, or more."""
    return Result(name, scale * each[-1], unit, scale * each[0], each[0] / each[-1])


def _measured(folder: Path, binning: int) -> tuple[int, float, float, int]:
    """Pixels, seconds, seconds with the table from disk, and peak bytes of this process and Blender."""
    os.environ["XDG_CACHE_HOME"] = str(folder)
    effort = {"path": "transport", "binning": binning, "subpixels": 2, "cache": True}
    with peak_of(_memory, 0.1) as peak, _Rig(folder, **effort) as rig:
        seconds = rig.measure(STRIPES, f"Transport at binning {binning}")
        width, height = rig.camera.caps.size
    with _Rig(folder, **effort) as rig:
        again = rig.measure(OTHERS, "The same scene from disk, other stripes")
    return width * height, seconds, again, peak[0]


def _memory() -> int:
    """What this process and its children hold, in bytes; shared pages count once."""
    own = psutil.Process()
    try:
        return sum(int(p.memory_full_info().pss) for p in [own, *own.children(recursive=True)])
    except psutil.NoSuchProcess:
        return 0  # one of them has ended since: the next sample tells
