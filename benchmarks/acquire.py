"""Acquisition from pylon's emulator at the full size of the sensor: the driver beside bare pylon.

36 frames of 5472 x 3648 pixels, 8 bit, an emulated exposure of 20 ms, pylon's own test image. What is
measured and its baseline run in turn; each figure is the median of its repetitions. Frames to disk stand
beside the slower of bare pylon and the disk, which is given as many bytes, flushed file by file, without
checksums. Files are removed between the runs, so that the system need not find new memory for each.
"""

import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import Any

import psutil
from pypylon import pylon

from benchmarks import Result
from benchmarks.peak import peak_of
from drivers.basler import BaslerCamera
from drivers.genicam.buffers import MAX_POOL_BYTES
from fpplab.core.progress import ignore
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.sessions.frame_writer import write_frames
from fpplab.sessions.session import Session
from tests.support.pulsed_pylon import PulsedPylon

SIZE = (5472, 3648)
PLAN = Plan(fringes=tuple(Sinusoid(axis="x", stripes=stripes, steps=12) for stripes in (1, 8, 64)))
FRAMES = PLAN.images
SETTINGS = CameraSettings(PLAN.exposure_s)
ALLOWED_PERCENT = 5.0
"""Host time beyond the source's own that is allowed, of the source's."""
REPEATS = 7
PYLONS_BUFFERS = 10
"""As many as pylon takes when it is not told."""
TIMEOUT_S = 10.0
SAMPLE_S = 0.01
SERIAL = "0815-0000"
BYTES = os.urandom(1 << 20) * (SIZE[0] * SIZE[1] >> 20)
"""As many as a frame has, to the last MiB."""


def run() -> list[Result]:
    """Measure acquisition; a lost frame is a `FrameLossError`."""
    with _camera() as (camera, bench):
        memory = _memory(camera, bench)  # first, while none has been fetched yet
        speed = _speed(camera)
        return [*speed, *_disk(camera, bench, FRAMES / speed[0].baseline), memory]


@contextmanager
def _camera() -> Iterator[tuple[BaslerCamera, PulsedPylon]]:
    bench = PulsedPylon(SIZE)
    bench.exposure_s = SETTINGS.exposure_s
    bench.start()
    try:
        with BaslerCamera("camera", {"serial": SERIAL}, SimpleNamespace(pylon=bench)) as camera:
            camera.configure(SETTINGS)
            yield camera, bench
    finally:
        bench.close()


def _speed(camera: BaslerCamera) -> list[Result]:
    instant = camera._camera.instant  # noqa: SLF001 - pylon's own object is the baseline
    driver, bare = [], []
    for _ in range(REPEATS):
        driver.append(_timed(lambda: _drop(_take(camera, FRAMES))))
        bare.append(_timed(lambda: _take_bare(instant)))
    ours, source = median(driver), median(bare)
    beyond = 100.0 * (ours / source - 1.0)
    better = (100.0 + ALLOWED_PERCENT) / (100.0 + beyond)
    return [
        Result("acquire 36 frames", ours, "s", source, source / ours),
        Result("host time beyond the source's", beyond, "%", ALLOWED_PERCENT, better),
    ]


def _take(camera: BaslerCamera, n: int) -> Iterator[Frame]:
    camera.arm(n)
    for _ in range(n):
        yield camera.read(TIMEOUT_S)


def _drop(frames: Iterable[Frame]) -> None:
    for _ in frames:
        pass


def _take_bare(instant: Any) -> None:
    """What pylon takes for it when nothing is checked or kept; the trigger is set already."""
    instant.MaxNumBuffer.SetValue(PYLONS_BUFFERS)
    instant.StartGrabbing(pylon.GrabStrategy_OneByOne)
    for _ in range(FRAMES):
        instant.WaitForFrameTriggerReady(1000, pylon.TimeoutHandling_ThrowException)
        instant.ExecuteSoftwareTrigger()
        instant.RetrieveResult(1000, pylon.TimeoutHandling_ThrowException).Release()
    instant.StopGrabbing()


def _disk(camera: BaslerCamera, bench: PulsedPylon, source: float) -> list[Result]:
    """Frames per second into a session, with checksums, and the rate at which the disk takes bare bytes."""
    ours, bare = [], []
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        path = Path(folder) / "frames"
        for _ in range(REPEATS):
            session = Session.create(path, PLAN)
            ours.append(_timed(lambda session=session: _record(camera, bench, session)))  # type: ignore[misc]
            shutil.rmtree(path)
            path.mkdir()
            bare.append(_timed(lambda: _write_bare(path)))
            shutil.rmtree(path)
    rate, disk = FRAMES / median(ours), FRAMES / median(bare)
    limit = min(source, disk)
    return [
        Result("to disk with checksums", rate, "frames/s", limit, rate / limit),
        Result("the disk alone", disk, "frames/s", source, disk / source),
    ]


def _record(camera: BaslerCamera, bench: PulsedPylon, session: Session) -> None:
    """As a triggered measurement does it: the pulses do not wait for the disk."""
    camera.arm(FRAMES, "hardware")
    wire = threading.Thread(target=bench.pulse, args=(FRAMES,))
    wire.start()
    with write_frames(session, ignore) as record:
        for _, _, name in PLAN.steps():
            frame = camera.read(TIMEOUT_S)
            record(frame.showing(name, frame.index))
    wire.join()


def _write_bare(folder: Path) -> None:
    for i in range(FRAMES):
        with (folder / str(i)).open("wb") as stream:
            stream.write(BYTES)
            stream.flush()
            os.fsync(stream.fileno())


def _memory(camera: BaslerCamera, bench: PulsedPylon) -> Result:
    """Peak of what four times as many frames take, on pulses; beside it all buffers allowed and one frame."""
    process = psutil.Process()
    before = process.memory_info().rss
    with peak_of(lambda: process.memory_info().rss, SAMPLE_S) as peak:
        for _ in range(4):
            camera.arm(FRAMES, "hardware")
            for _ in range(FRAMES):
                bench.pulse()
                camera.read(TIMEOUT_S)
    taken, allowed = (peak[0] - before) / 2**30, (MAX_POOL_BYTES + SIZE[0] * SIZE[1]) / 2**30
    return Result(f"memory for {4 * FRAMES} frames", taken, "GiB", allowed, allowed / taken)


def _timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
