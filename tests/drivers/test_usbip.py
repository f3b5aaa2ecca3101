"""The emulated device of the kernel's USB/IP hub; the test takes the part of the kernel."""

import errno
import queue
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.clock import RealClock, SteppedClock
from drivers.dlp4500 import Dlp4500
from drivers.dlp4500.framing import READ, REPLY_WANTED, join_reports, make_request
from drivers.dlp4500.protocol import VERSION
from drivers.dlp4500.sequence import SIZE
from drivers.emulators.dlpc350 import Dlpc350, EmulatedHid, usb_service, usbip
from drivers.emulators.dlpc350.descriptors import REPORTS
from drivers.emulators.dlpc350.usb_service import describe_state
from drivers.emulators.dlpc350.usbip import UsbIpAttachment, UsbIpConnection
from fpplab.core.conventions import Lattice
from fpplab.core.errors import DeviceError
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from tests.drivers.projector_bench import Bench, greys
from tests.support.commands import run

OUT, IN = 0, 1
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4


class Kernel:
    """The kernel's end of the cable."""

    def __init__(self) -> None:
        self.hid = EmulatedHid(Dlpc350(SteppedClock(), []))
        near, self._far = socket.socketpair()
        self.near = near
        self.connection = UsbIpConnection(self.hid, near)
        self._number = 0

    def submit(
        self, endpoint: int, direction: int, length: int, data: bytes = b"", setup: bytes = bytes(8)
    ) -> int:
        """Request a transfer; return its number."""
        self._number += 1
        head = struct.pack(">5I", SUBMIT, self._number, 1, direction, endpoint)
        self._far.sendall(head + struct.pack(">Iiiii", 0, length, 0, 0, 0) + setup + data)
        assert self.connection.handle_request()
        self.connection.deliver_reports()
        return self._number

    def unlink(self, unwanted: int) -> int:
        self._number += 1
        self._far.sendall(struct.pack(">6I24x", UNLINK, self._number, 1, 0, 0, unwanted))
        assert self.connection.handle_request()
        return self._number

    def hears(self, direction: int) -> tuple[int, int, int, bytes]:
        """Return the answer: kind, number, status and data."""
        kind, number, _, _, _, status, actual = struct.unpack(">5Iii20x", self._far.recv(48))
        return kind, number, status, self._far.recv(actual) if direction == IN and actual else b""

    def hears_nothing(self) -> bool:
        self._far.setblocking(False)
        try:
            return not self._far.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return True
        finally:
            self._far.setblocking(True)

    def ask(self, kind: int, what: int, value: int, length: int = 255) -> bytes | None:
        """Make a control request that reads; None when it is refused."""
        setup = struct.pack("<BBHHH", kind, what, value, 0, length)
        number = self.submit(0, IN, length, setup=setup)
        answered, about, status, data = self.hears(IN)
        assert (answered, about) == (SUBMITTED, number)
        assert status in (0, -errno.EPIPE)
        return data if status == 0 else None

    def let_go(self) -> None:
        self._far.close()


@pytest.fixture
def kernel() -> Iterator[Kernel]:
    kernel = Kernel()
    yield kernel
    kernel.let_go()
    kernel.near.close()


def test_it_introduces_itself(kernel: Kernel) -> None:
    device = kernel.ask(0x80, 6, 0x0100)
    assert device is not None
    assert struct.unpack_from("<HH", device, 8) == (0x0451, 0x6401)
    configuration = kernel.ask(0x80, 6, 0x0200)
    assert configuration is not None
    total, interfaces = struct.unpack_from("<HB", configuration, 2)
    assert (total, interfaces) == (len(configuration), 2)
    assert kernel.ask(0x80, 6, 0x0200, length=9) == configuration[:9]
    assert kernel.ask(0x81, 6, 0x2200) == REPORTS
    serial = kernel.ask(0x80, 6, 0x0303)
    assert serial is not None
    assert serial[2:].decode("utf-16le") == "LCR3"


def test_the_descriptors_of_the_configuration_fit_into_each_other(kernel: Kernel) -> None:
    rest = kernel.ask(0x80, 6, 0x0200)
    assert rest is not None
    kinds = []
    while rest:
        kinds.append(rest[1])
        rest = rest[rest[0] :]
    assert kinds == [2, 4, 0x21, 5, 5, 4, 0x21, 5, 5]


@pytest.mark.parametrize(("kind", "value"), [(1, 0x0100), (3, 0x0300), (3, 0x0301), (3, 0x0302), (3, 0x0303)])
def test_a_descriptor_begins_with_its_length_and_kind(kernel: Kernel, kind: int, value: int) -> None:
    found = kernel.ask(0x80, 6, value)
    assert found is not None
    assert tuple(found[:2]) == (len(found), kind)


def test_interfaces_and_endpoints_are_those_of_two_human_interface_devices(kernel: Kernel) -> None:
    """By the tables of chapter 9 of the USB specification: class 3, interrupt endpoints of 64 bytes."""
    rest = kernel.ask(0x80, 6, 0x0200)
    interfaces, endpoints = [], []
    while rest:
        if rest[1] == 4:
            interfaces.append(tuple(rest[2:9]))
        elif rest[1] == 5:
            endpoints.append(struct.unpack("<BBHB", rest[2:7]))
        rest = rest[rest[0] :]
    assert interfaces == [(n, 0, 2, 3, 0, 0, 0) for n in (0, 1)], "each with its first setting alone"
    assert endpoints == [(address, 3, 64, 1) for address in (0x81, 0x01, 0x82, 0x02)]


@pytest.mark.parametrize(("kind", "what", "value"), [(0x80, 6, 0x0600), (0x80, 8, 0), (0xA1, 1, 0x0100)])
def test_what_it_does_not_know_is_refused(kernel: Kernel, kind: int, what: int, value: int) -> None:
    assert kernel.ask(kind, what, value) is None


@pytest.mark.parametrize(("kind", "what", "status"), [(0x00, 9, 0), (0x21, 10, 0), (0x21, 11, -errno.EPIPE)])
def test_orders(kernel: Kernel, kind: int, what: int, status: int) -> None:
    number = kernel.submit(0, OUT, 0, setup=struct.pack("<BBHHH", kind, what, 0, 0, 0))
    assert kernel.hears(OUT) == (SUBMITTED, number, status, b"")


def test_a_command_and_its_answer(kernel: Kernel) -> None:
    waiting = kernel.submit(1, IN, 64)
    assert kernel.hears_nothing()
    (report,) = make_request(VERSION.number, b"", 7, READ | REPLY_WANTED).reports()
    sent = kernel.submit(1, OUT, 64, report)
    assert kernel.hears(OUT) == (SUBMITTED, sent, 0, b"")
    kind, number, status, answer = kernel.hears(IN)
    assert (kind, number, status) == (SUBMITTED, waiting, 0)
    reply = join_reports([answer])
    assert (reply.sequence, reply.failed, len(reply.payload)) == (7, False, 16)


def test_the_interface_without_commands_takes_and_says_nothing(kernel: Kernel) -> None:
    kernel.submit(2, IN, 64)
    (report,) = make_request(VERSION.number, b"", 7, READ | REPLY_WANTED).reports()
    sent = kernel.submit(2, OUT, 64, report)
    assert kernel.hears(OUT) == (SUBMITTED, sent, 0, b"")
    assert kernel.hears_nothing()
    assert kernel.hid.requests == 0


def test_a_transfer_is_taken_back(kernel: Kernel) -> None:
    waiting = kernel.submit(1, IN, 64)
    unlinking = kernel.unlink(waiting)
    assert kernel.hears(OUT) == (UNLINKED, unlinking, -errno.ECONNRESET, b"")
    too_late = kernel.unlink(waiting)
    assert kernel.hears(OUT) == (UNLINKED, too_late, 0, b"")


def test_the_kernel_lets_go(kernel: Kernel) -> None:
    kernel.let_go()
    assert not kernel.connection.handle_request()


# --- the hub


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a folder like the kernel's."""
    monkeypatch.setattr(usbip, "HUB", tmp_path)
    (tmp_path / "status").write_text(
        "hub port sta spd dev      sockfd local_busid\n"
        "hs  0000 006 002 00010002 000003 1-1\n"
        "hs  0001 004 000 00000000 000000 0-0\n"
        "ss  0002 004 000 00000000 000000 0-0\n"
    )
    (tmp_path / "attach").touch()
    return tmp_path


def test_a_free_port_of_full_speed_is_taken(hub: Path) -> None:
    near, far = socket.socketpair()
    with near, far:
        usbip.attach(far)
        assert (hub / "attach").read_text() == f"1 {far.fileno()} 65538 2"


def test_no_port_is_free(hub: Path) -> None:
    status = (hub / "status").read_text().replace("hs  0001 004", "hs  0001 006")
    (hub / "status").write_text(status)
    with pytest.raises(DeviceError, match="every port of the kernel's USB/IP hub is taken"):
        usbip.free_port()


def test_a_kernel_without_hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usbip, "HUB", tmp_path / "nowhere")
    with (
        pytest.raises(DeviceError, match=r"no USB/IP hub .* on Linux: sudo modprobe vhci-hcd"),
        UsbIpAttachment(EmulatedHid(Dlpc350(SteppedClock(), []))),
    ):
        pass


@pytest.mark.parametrize(
    ("error", "words"),
    [(PermissionError(13, "Permission denied"), "start it with sudo"), (OSError(22, "Invalid"), "Invalid")],
)
def test_the_kernel_does_not_take_the_cable(
    hub: Path, monkeypatch: pytest.MonkeyPatch, error: OSError, words: str
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(usbip, "open", refused, raising=False)
    near, far = socket.socketpair()
    with near, far, pytest.raises(DeviceError, match=words):
        usbip.attach(far)


def product_asked_by(cable: socket.socket) -> int:
    """The product number in the device descriptor, over the kernel's end of a cable."""
    cable.settimeout(20.0)
    setup = struct.pack("<BBHHH", 0x80, 6, 0x0100, 0, 18)
    cable.sendall(struct.pack(">5I", SUBMIT, 1, 1, IN, 0) + struct.pack(">Iiiii", 0, 18, 0, 0, 0) + setup)
    answer = cable.recv(48 + 18, socket.MSG_WAITALL)
    return int(struct.unpack_from("<H", answer, 48 + 10)[0])


def test_a_device_that_left_the_bus_comes_back_over_another_cable(monkeypatch: pytest.MonkeyPatch) -> None:
    cables: queue.Queue[socket.socket] = queue.Queue()
    monkeypatch.setattr(usbip, "attach", lambda cable: cables.put(cable.dup()))
    hid = EmulatedHid(Dlpc350(RealClock(), []))
    with UsbIpAttachment(hid) as attached:
        with cables.get(timeout=20.0) as first:
            assert product_asked_by(first) == 0x6401
            with attached.lock:
                hid.unplug()
            assert first.recv(1) == b""
        assert cables.empty()
        with attached.lock:
            hid.plug()
        second = cables.get(timeout=20.0)
        assert product_asked_by(second) == 0x6401
    with second:
        assert second.recv(1) == b""


@pytest.mark.whole
def test_firmware_is_for_the_projector_alone() -> None:
    done = run("emulate", "stage", "--firmware", "x.bin")
    assert done.code == 2
    assert "the emulator 'stage' has no flash" in done.err


# --- what people get


def test_it_holds_the_default_plan(tmp_path: Path) -> None:
    controller, index = usb_service._from_default_plan(tmp_path)
    patterns = make_patterns(Plan.load(usb_service.DEFAULT_PLAN), SIZE, Lattice.DIAMOND)
    wire = SimpleNamespace(hid=EmulatedHid(controller), clock=controller.clock)
    with Dlp4500("projector", {"flash": str(index)}, wire) as projector:
        projector.load(patterns)
        for i in (0, 17, 35):
            projector.show(i)
            light = controller.light()
            assert light is not None
            assert np.array_equal(light.grey, patterns[i].image)


def test_it_says_what_it_does(tmp_path: Path) -> None:
    bench = Bench(greys(9), tmp_path)
    assert describe_state(bench.controller) == "video mode: red 41%, green 53%, blue 51%"
    with bench.projector() as projector:
        assert describe_state(bench.controller) == "pattern mode, stopped: dark"
        projector.load(bench.patterns)
        projector.show(4)
        lit = "red 41%, green 53%, blue 51%"
        assert describe_state(bench.controller) == f"pattern mode, pattern 1 of image 1, 8 bits: {lit}"
        projector.play(0.02)
        assert describe_state(bench.controller) == f"pattern mode, 9 patterns of 20 ms once: {lit}"
        projector.blank()
        projector._board.enter_standby()
        assert describe_state(bench.controller) == "standby"
        projector._board.wake()
