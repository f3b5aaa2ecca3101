"""Commands and sequences through hidapi and the kernel, and their results when the connection fails."""

import time
from collections.abc import Callable
from contextlib import closing
from statistics import median

import hid
import pytest

from drivers.dlp4500 import Dlp4500
from drivers.dlp4500.framing import READ, REPLY_WANTED, make_request
from drivers.dlp4500.protocol import VERSION
from drivers.dlp4500.transport import REPLY_TIMEOUT_S, HidDevice, connect
from drivers.emulators.dlpc350 import UsbFault
from fpplab.core.errors import DeviceError, DeviceTimeoutError, DisconnectedError, ProtocolError
from fpplab.devices import State
from fpplab.patterns.fringes import Pattern
from tests.vm.conftest import is_gone, is_on_usb, wait_until
from tests.vm.projector import Projector

ROUND_TRIPS = 300
MOST_COMMANDS = 40
EXPOSURE_S = 0.02
AT_MOST_S = 4 * REPLY_TIMEOUT_S
"""One command that is not answered, and more time than switching the LEDs off takes."""


def timed(action: Callable[[], object]) -> float:
    """Measure how long it takes, in s."""
    begin = time.perf_counter()
    action()
    return time.perf_counter() - begin


def raw_round_trip(wire: HidDevice) -> None:
    """The reports of a command and of its answer, with no driver."""
    for report in make_request(VERSION.number, b"", 0, READ | REPLY_WANTED).reports():
        wire.write(b"\0" + report)
    assert wire.read(64, round(1e3 * REPLY_TIMEOUT_S))


def test_round_trips(driver: Dlp4500, emulated: Projector, capsys: pytest.CaptureFixture[str]) -> None:
    with closing(connect(hid, "projector", None)[0]) as wire:
        raw = [timed(lambda: raw_round_trip(wire)) for _ in range(ROUND_TRIPS)]
    with driver:
        link = driver._board.link
        driven = [timed(lambda: link.read(VERSION)) for _ in range(ROUND_TRIPS)]
    medians = f"{1e3 * median(driven):.2f} ms by the driver, {1e3 * median(raw):.2f} ms without it"
    with capsys.disabled():
        print(f"\n    a command there and back, on an emulated processor: median {medians}")


def test_36_patterns_are_prepared_and_run(
    driver: Dlp4500, emulated: Projector, patterns: list[Pattern], capsys: pytest.CaptureFixture[str]
) -> None:
    sequence = [patterns[i % len(patterns)] for i in range(36)]
    with driver:
        before, begin = emulated.commands(), time.perf_counter()
        driver.load(sequence)
        emulated.forget()
        driver.play(EXPOSURE_S)
        commands, seconds = emulated.commands() - before, time.perf_counter() - begin
        caught: list[str] = []

        def has_all() -> bool:
            while one := emulated.caught():
                assert one[0] is not None
                caught.append(one[0].id)
            return len(caught) >= len(sequence)

        wait_until(has_all)
        driver.blank()
    assert caught == [pattern.id for pattern in sequence]
    assert commands < MOST_COMMANDS
    with capsys.disabled():
        print(f"\n    36 patterns: {commands} commands, {seconds:.2f} s, on an emulated processor")


def works_again(driver: Dlp4500, emulated: Projector, patterns: list[Pattern]) -> None:
    """Check that it shows patterns after it is opened again."""
    wait_until(is_on_usb)
    with driver:
        driver.load(patterns)
        driver.show(5)
        shown = emulated.lit()
        assert shown is not None
        assert shown.id == patterns[5].id
    assert emulated.lit() is None


def play_and_blank(driver: Dlp4500) -> None:
    """Some forty requests."""
    for _ in range(2):
        driver.play(EXPOSURE_S)
        driver.blank()


@pytest.mark.parametrize("fault", [UsbFault.UNPLUG_BEFORE, UsbFault.UNPLUG_AFTER])
@pytest.mark.parametrize("step", [0, 3, 9, 16, 24])
def test_the_cable_is_pulled_at_a_step_of_a_sequence(
    driver: Dlp4500, emulated: Projector, patterns: list[Pattern], step: int, fault: UsbFault
) -> None:
    driver.open()
    driver.load(patterns[:3])
    emulated.fail({step: fault})
    begin = time.monotonic()
    with pytest.raises(DisconnectedError, match="the USB device was unplugged"):
        play_and_blank(driver)
    assert time.monotonic() - begin < AT_MOST_S
    assert driver.state is State.FAULT
    with pytest.raises(DisconnectedError):
        driver.close()
    wait_until(is_gone)
    emulated.plug()
    works_again(driver, emulated, patterns)


def test_the_cable_is_pulled_between_commands(
    driver: Dlp4500, emulated: Projector, patterns: list[Pattern]
) -> None:
    driver.open()
    driver.load(patterns)
    emulated.unplug()
    wait_until(is_gone)
    with pytest.raises(DisconnectedError, match="the USB device was unplugged"):
        driver.show(0)
    with pytest.raises(DisconnectedError):
        driver.close()
    with pytest.raises(DisconnectedError, match="no LightCrafter 4500 is connected"):
        driver.open()
    emulated.plug()
    works_again(driver, emulated, patterns)


def test_a_reset_takes_it_off_the_bus_and_back(
    driver: Dlp4500, emulated: Projector, patterns: list[Pattern]
) -> None:
    driver.open()
    driver._board.reset()
    with pytest.raises(DeviceError):
        driver.info()
    with pytest.raises(DeviceError):
        driver.close()
    works_again(driver, emulated, patterns)


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        (UsbFault.DROP, DeviceTimeoutError),
        (UsbFault.LATE, DeviceTimeoutError),
        (UsbFault.NACK, ProtocolError),
        (UsbFault.SHORT, ProtocolError),
    ],
)
def test_a_bad_answer_is_an_error_and_the_projector_dark(
    driver: Dlp4500, emulated: Projector, patterns: list[Pattern], fault: UsbFault, error: type[DeviceError]
) -> None:
    with driver:
        driver.load(patterns)
        driver.show(0)
        emulated.fail({4: fault})
        begin = time.monotonic()
        with pytest.raises(error):
            driver.show(1)
        assert time.monotonic() - begin < AT_MOST_S
        assert emulated.lit() is None
    works_again(driver, emulated, patterns)


def test_an_answer_that_comes_twice_is_no_fault(
    driver: Dlp4500, emulated: Projector, patterns: list[Pattern]
) -> None:
    with driver:
        driver.load(patterns)
        emulated.fail(dict.fromkeys(range(100), UsbFault.DUPLICATE))
        for i in (0, 4, 8):
            driver.show(i)
            shown = emulated.lit()
            assert shown is not None
            assert shown.id == patterns[i].id
