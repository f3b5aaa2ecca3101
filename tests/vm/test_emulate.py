"""`fpplab emulate dlp4500` as an operator uses it: on USB, with a writable flash, reporting its state."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import hid
import pytest

from drivers.clock import RealClock
from drivers.dlp4500 import Dlp4500
from drivers.dlp4500.flash.firmware import Firmware, arrange_patterns
from drivers.dlp4500.flash.loader import boot_loader_session
from drivers.dlp4500.flash.upload import perform_upload, plan_upload, verify_image_count
from drivers.dlp4500.index import FlashIndex
from drivers.dlp4500.transport import Link, connect
from fpplab.core import config
from tests.drivers.flash_files import maker_firmware
from tests.drivers.projector_bench import greys
from tests.support.commands import ROOT
from tests.vm.conftest import is_gone, is_on_usb, wait_until
from tests.vm.projector import Projector

PATTERNS = greys(6)


@pytest.fixture
def base(tmp_path: Path) -> Firmware:
    """A firmware that holds the first three patterns, and its index beside it."""
    maker = Firmware(maker_firmware(), Path("maker.bin"))
    built = maker.with_patterns(PATTERNS[:3], tmp_path / "base.bin")
    built.source.write_bytes(built.content)
    index = FlashIndex.of(PATTERNS[:3], arrange_patterns(PATTERNS[:3]))
    built.source.with_suffix(".yaml").write_text(config.dump(index), encoding="utf-8")
    return built


@pytest.fixture
def served(emulated: Projector, base: Firmware) -> Iterator[subprocess.Popen[bytes]]:
    """Run the command, as the only device on the bus."""
    emulated.unplug()
    wait_until(is_gone)
    command = [sys.executable, "-m", "fpplab", "emulate", "dlp4500", "--json", "--firmware", str(base.source)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        yield process
        process.kill()
    emulated.plug()


def link() -> Link:
    return Link(connect(hid, "projector", None)[0], RealClock(), "projector")


def test_it_is_a_projector_until_it_is_ended(
    served: subprocess.Popen[bytes], base: Firmware, tmp_path: Path
) -> None:
    assert served.stdout is not None
    told = json.loads(served.stdout.readline())
    index = base.source.with_suffix(".yaml")
    assert told["projector"] == f"{{backend: dlp4500, flash: {index}}}"
    wait_until(is_on_usb)
    with Dlp4500("projector", {"flash": str(index)}, None) as projector:
        projector.load(PATTERNS[:3])
        projector.show(1)
        time.sleep(1.0)  # or nobody could have seen it

    more = base.with_patterns(PATTERNS, tmp_path / "more.bin")
    with boot_loader_session(link, RealClock(), "projector") as loader:
        perform_upload(more, loader, plan_upload(more, loader), lambda share: None)
    with closing(link()) as checked:
        verify_image_count(more, checked)

    served.send_signal(signal.SIGINT)
    _, said = served.communicate(timeout=60)
    lines = said.decode().splitlines()
    assert served.returncode == 0, lines
    assert "pattern mode, pattern 1 of image 0, 8 bits: red 41%, green 53%, blue 51%" in lines
    assert "boot loader: its flash can be written, it shows nothing" in lines
    wait_until(is_gone)
