"""Devices with a fault that a seed draws: the real drivers on emulators, and the bench by formulas."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from drivers.dlp4500.sequence import SIZE
from fpplab.acquisition import acquire
from fpplab.core.errors import DeviceError
from fpplab.core.progress import ignore
from fpplab.devices import DeviceInfo, Frame
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern, uniform_patterns
from fpplab.sessions.session import Session
from fpplab.setup.rig_check.check import RigCheck, check_rig
from fpplab.setup.rig_check.marker import marker
from tests.drivers.emulated_rig import PLAN, burn, rig_file
from tests.support.faulty_bench import healthy
from tests.support.faulty_rig import FormulaCamera, FormulaDevices, FormulaProjector, formula_rig

EMULATED_PLAN = PLAN.model_copy(update={"exposure_s": 0.016})
LONGEST_WAIT_S = 0.1
"""For a frame that does not come; the emulators' time is the computer's only then."""


class LateProjector(FormulaProjector):
    """Shows a pattern some time after it was told to, whatever it is told meanwhile."""

    def _open(self) -> None:
        super()._open()
        self._bench.due = deque()

    def _show(self, i: int) -> None:
        self._bench.due.append((time.monotonic() + float(self._bench.options["late_s"]), self._held[i]))


class LateCamera(FormulaCamera):
    """Sees what a late projector shows by now, and does not know which pattern that is."""

    def _exposed(self) -> Pattern | None:
        while self._bench.due and self._bench.due[0][0] <= time.monotonic():
            self._bench.on_show = self._bench.due.popleft()[1]
        return super()._exposed()

    def _read(self, timeout_s: float) -> Frame:
        return replace(super()._read(timeout_s), pattern_id=None)


class LinkedCamera(FormulaCamera):
    """States the rate of its link."""

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", "formulas", "1", f"Usb, {self._bench.options['mbit_per_s']:g} Mbit/s")


class RefusingCamera(FormulaCamera):
    """Cannot be opened."""

    def _open(self) -> None:
        raise DeviceError("camera", "open", self._bench.options["words"], "see to the camera")


REFUSALS = (
    "[Errno 13] Permission denied",
    "the user may not open 1-2.3",
    "USB: Access denied (insufficient permissions)",
    "Operation not permitted",
)
FAILURES = ("no answer", "the device is in use by another program", "the firmware is of another version")


def _emulated(rig: Rig) -> RigCheck:
    return check_rig(rig, EMULATED_PLAN, "white", ignore)


def _by_formulas(
    seed: int, folder: Path, camera: type, projector: type = FormulaProjector, **more: Any
) -> RigCheck:
    bench = healthy(seed)
    devices = FormulaDevices(*(f"{one.__module__}:{one.__name__}" for one in (camera, projector)))
    rig = formula_rig(None, seed, devices, **more)
    return check_rig(rig, bench.plan, "card", ignore, bench.calibration, folder)


@contextmanager
def _slow_writing(delay_s: float) -> Iterator[None]:
    """A disk that takes so long for each frame."""
    write = Session.write

    def slowly(session: Session, *args: Any, **more: Any) -> Any:
        time.sleep(delay_s)
        return write(session, *args, **more)

    with patch.object(Session, "write", slowly):
        yield


def _cut(folder: Path, random: np.random.Generator) -> RigCheck:
    return _emulated(rig_file(folder, {"faults": {"cut": True}}))


def _edge(folder: Path, random: np.random.Generator) -> RigCheck:
    if random.uniform() < 0.5:
        return _emulated(rig_file(folder, camera={"trigger": {"edge": "falling"}}))
    return _emulated(rig_file(folder, projector={"trigger_out_1": {"inverted": True}}))


def _unready(folder: Path, random: np.random.Generator) -> RigCheck:
    return _emulated(rig_file(folder, {"sensor": {"untold_us": float(random.uniform(300.0, 4000.0))}}))


def _slipping(folder: Path, random: np.random.Generator) -> RigCheck:
    k = int(random.integers(1, 10))
    faults: dict[str, Any] = [{"doubled": [k]}, {"missed": [k]}, {"extra": True}][int(random.integers(3))]
    return _emulated(rig_file(folder, {"faults": faults}))


def _unlit(folder: Path, random: np.random.Generator) -> RigCheck:
    dark = {"led_levels": {"red": 0, "green": 0, "blue": 0}}
    return _emulated(rig_file(folder, projector=dark))


def _late(folder: Path, random: np.random.Generator) -> RigCheck:
    seed, late_s = int(random.integers(1000)), float(random.uniform(0.012, 0.045))
    return _by_formulas(seed, folder, LateCamera, LateProjector, late_s=late_s)


def _linked(folder: Path, random: np.random.Generator) -> RigCheck:
    rate = float(random.uniform(5.0, 30.0))
    return _by_formulas(int(random.integers(1000)), folder, LinkedCamera, mbit_per_s=rate)


def _refusing(said: tuple[str, ...], folder: Path, random: np.random.Generator) -> RigCheck:
    words = str(random.choice(said))
    return _by_formulas(int(random.integers(1000)), folder, RefusingCamera, words=words)


def _filling(folder: Path, random: np.random.Generator) -> RigCheck:
    bench = healthy(int(random.integers(1000)))
    plan = bench.plan.model_copy(update={"trigger": "triggered"})
    with _slow_writing(float(random.uniform(0.05, 0.2))):
        return check_rig(formula_rig(None, bench.seed), plan, "card", ignore, bench.calibration, folder)


DEVICE_FAULTS: dict[str, Callable[[Path, np.random.Generator], RigCheck]] = {
    "no_trigger": _cut,
    "trigger_edge": _edge,
    "camera_not_ready": _unready,
    "out_of_step": _slipping,
    "slow_display": _late,
    "projector_dark": _unlit,
    "slow_link": _linked,
    "no_permission": partial(_refusing, REFUSALS),
    "device": partial(_refusing, FAILURES),
    "slow_disk": _filling,
}


def check_faulty_devices(cause: str, seed: int, folder: Path) -> RigCheck:
    """What `fpplab check` says of devices with one fault; `folder` is for the projector's flash."""
    if not (folder / "patterns.bin").is_file():
        burn(folder, uniform_patterns(marker().tolist(), SIZE))
    with patch.object(acquire, "READ_TIMEOUT_S", LONGEST_WAIT_S):
        return DEVICE_FAULTS[cause](folder, np.random.default_rng([seed, 11]))
