"""An emulated LightCrafter with two images in flash, for the tests that ask for one."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.dlp4500 import Dlp4500
from drivers.emulators.dlpc350 import STRICT
from tests.drivers.projector_bench import Bench, greys


@pytest.fixture
def bench(tmp_path: Path, request: pytest.FixtureRequest) -> Bench:
    """Two images of flash: six patterns."""
    return Bench(greys(6), tmp_path, getattr(request, "param", STRICT))


@pytest.fixture
def projector(bench: Bench) -> Iterator[Dlp4500]:
    with bench.projector() as opened:
        yield opened
