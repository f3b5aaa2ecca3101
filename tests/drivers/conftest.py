"""An emulated bench with a Basler camera, for the tests that ask for one."""

from collections.abc import Iterator

import pytest

from drivers.basler import BaslerCamera
from tests.drivers.basler_bench import SETTINGS, Counter, driver
from tests.support.pulsed_pylon import PulsedPylon


@pytest.fixture
def scene() -> Counter:
    return Counter()


@pytest.fixture
def bench(scene: Counter) -> Iterator[PulsedPylon]:
    emulation = PulsedPylon(scene=scene)
    emulation.start()
    yield emulation
    emulation.close()


@pytest.fixture
def camera(bench: PulsedPylon) -> Iterator[BaslerCamera]:
    with driver(bench) as camera:
        camera.configure(SETTINGS)
        yield camera
