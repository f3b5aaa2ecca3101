"""These tests need the virtual machine's kernel: `make test-usb` runs them there."""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import hid
import pytest

from drivers.dlp4500 import Dlp4500
from drivers.dlp4500.transport import PRODUCT, VENDOR
from fpplab.patterns.fringes import Pattern
from tests.conformance.dlp4500 import planned
from tests.vm.projector import Projector, connected
from tests.vm.uvc_bench import PATIENCE_S

collect_ignore_glob = [] if os.environ.get("FPPLAB_VM") else ["test_*.py"]


def wait_until(true: Callable[[], bool]) -> None:
    """Return once a condition holds."""
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < deadline, "the kernel never got there"
        time.sleep(0.05)


def is_on_usb() -> bool:
    """Whether libusb and the kernel's own driver both know both its interfaces."""
    import hidraw  # which only Linux has

    return all(
        {one["interface_number"] for one in library.enumerate(VENDOR, PRODUCT)} == {0, 1}
        for library in (hid, hidraw)
    )


def is_gone() -> bool:
    """Whether hidapi has noticed that it is absent."""
    return not hid.enumerate(VENDOR, PRODUCT)


@pytest.fixture
def emulated() -> Iterator[Projector]:
    """The projector on USB, in its initial state."""
    projector = connected()
    projector.plug()
    projector.fail({})
    wait_until(is_on_usb)
    yield projector
    projector.fail({})


@pytest.fixture(scope="session")
def patterns() -> list[Pattern]:
    """Twelve patterns that the projector has in flash."""
    return planned()


@pytest.fixture
def driver(emulated: Projector, tmp_path: Path) -> Dlp4500:
    """The driver, through hidapi, not open yet."""
    index = tmp_path / "flash.yaml"
    index.write_text(emulated.index(), encoding="utf-8")
    return Dlp4500("projector", {"flash": str(index)}, None)
