"""An emulated bench with a Basler camera, for the tests that ask for one."""

from collections.abc import Iterator

import pytest

from drivers.basler import BaslerCamera
from drivers.emulators.pylon import EmulatedPylon
from tests.drivers.basler_bench import SETTINGS, Counter, driver


@pytest.fixture
def scene() -> Counter:
    return Counter()


@pytest.fixture
def bench(scene: Counter) -> Iterator[EmulatedPylon]:
    emulation = EmulatedPylon(scene=scene)
    emulation.start()
    yield emulation
    emulation.close()


@pytest.fixture
def camera(bench: EmulatedPylon) -> Iterator[BaslerCamera]:
    with driver(bench) as camera:
        camera.configure(SETTINGS)
        yield camera
