"""One scan after the other on one open rig, and devices that are opened, unplugged and opened again."""

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from fpplab.acquisition.acquire import acquire
from fpplab.core.errors import DeviceError, DisconnectedError
from fpplab.phase import decode
from fpplab.sessions.session import Session
from tests.drivers.basler_bench import Counter, driver, unplug_once
from tests.drivers.dlp4500.test_faults import Trial
from tests.drivers.emulated_rig import PLAN, burn, rig_file
from tests.drivers.grbl_stage import Bench
from tests.drivers.projector_bench import Bench as ProjectorBench
from tests.drivers.projector_bench import greys
from tests.support.pulsed_pylon import PulsedPylon

SEEN_S = 0.02
"""After so long an unplugged serial line is seen to be gone."""


def scans(folder: Path, count: int) -> Iterator[None]:
    """Acquire, write, read with checksums, and decode, so many times on one open rig."""
    burn(folder)
    with rig_file(folder) as rig:
        for number in range(count):
            place = folder / f"scan_{number}"
            session = Session.create(place, PLAN, rig.described())
            acquire(rig, PLAN, session)
            assert not session.missing()
            decode(Session.open(place).recording())
            shutil.rmtree(place)
            yield


def plug_cycles(folder: Path, count: int) -> Iterator[None]:
    """Projector, stage and camera used, pulled out while open, and found again, so many times."""
    bench = PulsedPylon(scene=Counter())
    bench.start()
    camera = driver(bench)
    try:
        for number in range(count):
            _unplug_projector(folder / f"projector_{number}")
            _unplug_stage()
            unplug_once(camera, bench)
            yield
    finally:
        bench.close()


def _unplug_projector(place: Path) -> None:
    place.mkdir()
    trial = Trial(ProjectorBench(greys(4), place))
    trial.measure()
    trial.projector.open()
    trial.hid.unplug()
    with pytest.raises(DeviceError):
        trial.projector.show(0)
    with pytest.raises(DeviceError):  # it could not be told to go dark
        trial.projector.close()
    shutil.rmtree(place)


def _unplug_stage() -> None:
    with Bench() as bench:
        stage = bench.homed()
        stage.move_to(5.0, 30.0)
        bench.terminal.unplug()
        time.sleep(SEEN_S)
        with pytest.raises(DisconnectedError):
            stage.move_to(6.0, 30.0)
