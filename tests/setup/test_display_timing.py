"""Latency and refresh of a display whose true times are known, in time that passes only when it is waited."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.core.conventions import Lattice
from fpplab.core.errors import DeviceError
from fpplab.core.progress import no_progress
from fpplab.devices import (
    Camera,
    CameraCaps,
    CameraSettings,
    DeviceInfo,
    FlashingProjector,
    Frame,
    ProjectorCaps,
    Trigger,
)
from fpplab.devices.rig import Rig, RigFile
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern
from fpplab.patterns.plan import Plan
from fpplab.setup import display_timing
from fpplab.setup.display_timing import measure_display

PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=4),), exposure_s=0.02)
SIZE = (24, 16)


class Screen:
    """Light over time; stands in for the module `time` too."""

    def __init__(self, options: dict[str, Any]) -> None:
        self.latency_s, self.period_s = options.pop("latency_s", 0.0), options.pop("period_s", 1 / 60)
        self.told_s, self.gain = options.pop("told_s", 1 / 60), options.pop("gain", 1.0)
        self.longest_s = options.pop("longest_s", 2.0)
        self.fall_s = options.pop("fall_s", self.latency_s)
        self.changes = [(-1.0, 0.0)]
        self.now_s, self.begin_s = 0.0, None
        BENCHES.append(self)

    def open(self) -> None:
        """Nothing to open."""

    def close(self) -> None:
        """Nothing to close."""

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def put_up(self, level: float, at_s: float) -> None:
        self.changes.append((at_s + (self.latency_s if level else self.fall_s), level))

    def collected(self, begin_s: float, end_s: float) -> float:
        total = 0.0
        for (since_s, level), (until_s, _) in zip(self.changes, [*self.changes[1:], (1e9, 0.0)], strict=True):
            total += level * max(0.0, min(until_s, end_s) - max(since_s, begin_s))
        return total


BENCHES: list[Screen] = []


class Deferred:
    """In place of a thread: the camera begins when it is told to, and the frame is made when it is taken."""

    def __init__(self, max_workers: int) -> None:
        """One is enough."""

    def __enter__(self) -> Deferred:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to end."""

    def submit(self, work: Callable[[], float]) -> Any:
        bench, begin_s = BENCHES[-1], BENCHES[-1].now_s

        class Later:
            def result(self) -> float:
                bench.begin_s = begin_s
                return work()

        return Later()


class ScreenCamera(Camera):
    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._bench: Screen = bench

    def _open(self) -> None:
        self._random = np.random.default_rng(3)

    def _close(self) -> None: ...

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", "", "", "")

    def _caps(self) -> CameraCaps:
        return CameraCaps(SIZE, (8,), (1e-4, self._bench.longest_s), (0.0, 0.0), ("software",))

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def _arm(self, n: int, trigger: Trigger) -> None: ...

    def _read(self, timeout_s: float) -> Frame:
        bench, settings = self._bench, self._configured("read")
        begin_s, bench.begin_s = bench.begin_s if bench.begin_s is not None else bench.now_s, None
        bench.now_s = max(bench.now_s, begin_s + settings.exposure_s)
        level = 8.0 + bench.gain * 180.0 * bench.collected(begin_s, begin_s + settings.exposure_s) / 0.02
        image = level + self._random.normal(0.0, 1.0, SIZE[::-1])
        return Frame(np.clip(np.rint(image), 0, 255).astype(np.uint8), 0, settings, 0.0)

    def _stop(self) -> None: ...


class ScreenProjector(FlashingProjector):
    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._bench: Screen = bench

    def _open(self) -> None: ...

    def _close(self) -> None: ...

    def _info(self) -> DeviceInfo:
        return DeviceInfo("projector", "", "", "")

    def _caps(self) -> ProjectorCaps:
        return ProjectorCaps(SIZE, Lattice.SQUARE, {8: 0.016}, 0, 100)

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        self._levels = [float(p.image.mean()) / 255.0 for p in patterns]
        return patterns

    def _show(self, i: int) -> None:
        self._bench.put_up(self._levels[i], self._bench.now_s)

    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None: ...

    def _blank(self) -> None:
        self._bench.put_up(0.0, self._bench.now_s)

    def _refresh_period_s(self) -> float:
        return self._bench.told_s

    def _flash(self, i: int, refreshes: int) -> None:
        bench = self._bench
        bench.put_up(self._levels[i], bench.now_s)
        bench.sleep(refreshes * bench.period_s)
        bench.put_up(0.0, bench.now_s)


@pytest.fixture(autouse=True)
def _own_time(monkeypatch: pytest.MonkeyPatch) -> None:
    class Clock:
        @staticmethod
        def sleep(seconds: float) -> None:
            BENCHES[-1].sleep(seconds)

    monkeypatch.setattr(display_timing, "time", Clock)
    monkeypatch.setattr(display_timing, "ThreadPoolExecutor", Deferred)


def rig(**options: Any) -> Rig:
    here = __name__ + ":"
    sections = {
        "name": "Screen",
        "bench": {"backend": here + "Screen", **options},
        "camera": {"backend": here + "ScreenCamera"},
        "projector": {"backend": here + "ScreenProjector"},
    }
    return Rig(RigFile.model_validate(sections), Path(), "rig")


@pytest.mark.parametrize("latency_s", [0.0, 0.003, 0.021, 0.075, 0.31])
def test_the_latency_is_found_to_two_milliseconds_or_a_twentieth(latency_s: float) -> None:
    with rig(latency_s=latency_s) as opened:
        found = measure_display(opened, PLAN, no_progress)
    assert latency_s - 0.05 * 0.02 - 1e-9 <= found.settle_s <= latency_s + max(0.004, 0.06 * latency_s)


def test_a_display_that_darkens_more_slowly_is_waited_for() -> None:
    with rig(latency_s=0.01, fall_s=0.06) as opened:
        assert measure_display(opened, PLAN, no_progress).settle_s >= 0.058


@pytest.mark.parametrize("latency_s", [0.0, 0.075])
@pytest.mark.parametrize("period_s", [1 / 60, 1 / 50, 1 / 30, 1 / 120])
def test_the_refresh_is_measured_and_compared(period_s: float, latency_s: float) -> None:
    with rig(latency_s=latency_s, period_s=period_s) as opened:
        found = measure_display(opened, PLAN, no_progress)
    assert found.refresh_s == pytest.approx(period_s, rel=0.02)
    assert found.reported_s == pytest.approx(1 / 60)
    assert found.agrees is (period_s == 1 / 60)
    assert found.summary()["agrees"] is found.agrees


def test_a_camera_with_short_exposures_leaves_the_refresh_open() -> None:
    with rig(longest_s=0.2) as opened:
        found = measure_display(opened, PLAN, no_progress)
    assert found.refresh_s is None
    assert found.agrees


def test_a_display_that_does_not_change_in_a_second_is_an_error() -> None:
    with rig(latency_s=3.0) as opened, pytest.raises(DeviceError, match="brighter than black"):
        measure_display(opened, PLAN, no_progress)


def test_without_light_it_is_an_error() -> None:
    with rig(gain=0.02) as opened, pytest.raises(DeviceError, match="check lens caps"):
        measure_display(opened, PLAN, no_progress)
