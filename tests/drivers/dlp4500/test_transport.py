"""Questions and their own answers on a wire whose every report the test decides."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.clock import SteppedClock
from drivers.dlp4500 import protocol
from drivers.dlp4500.flash.loader import READ_STATUS
from drivers.dlp4500.framing import READ, UsbMessage
from drivers.dlp4500.transport import MAX_STALE_REPORTS, Link, connect
from fpplab.core.errors import (
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    ProtocolError,
    SettingError,
)

Far = Callable[[UsbMessage], list[UsbMessage]]
"""What the far end sends after a request."""


def request_in(report: bytes) -> UsbMessage:
    flags, sequence, length = report[0], report[1], int.from_bytes(report[2:4], "little")
    return UsbMessage(flags, sequence, report[4 : 4 + min(length, 60)])


class ScriptedWire:
    """Answers as told; hidapi's behaviour on silence and on a missing device."""

    def __init__(self, far: Far, clock: SteppedClock) -> None:
        self.far, self.clock = far, clock
        self.sent: list[bytes] = []
        self.waiting: list[bytes] = []
        self.gone = self.closed = False

    def write(self, buff: bytes) -> int:
        if self.gone:
            return -1
        assert len(buff) == 65
        assert buff[0] == 0
        self.sent.append(bytes(buff[1:]))
        for message in self.far(request_in(self.sent[-1])):
            self.waiting += message.reports()
        return 65

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        if self.gone:
            raise OSError("read error")
        assert timeout_ms > 0, "hidapi would wait for ever"
        if not self.waiting:
            self.clock.sleep(timeout_ms / 1000)
            return []
        return list(self.waiting.pop(0))[:max_length]

    def close(self) -> None:
        self.closed = True


def echo(request: UsbMessage, data: bytes = b"") -> UsbMessage:
    return UsbMessage(request.flags, request.sequence, data)


def link_to(far: Far, **options: Any) -> tuple[Link, ScriptedWire]:
    clock = SteppedClock()
    wire = ScriptedWire(far, clock)
    return Link(wire, clock, "projector", **options), wire


def test_a_write_waits_for_its_acknowledgement() -> None:
    link, wire = link_to(lambda r: [echo(r)])
    link.write(protocol.SEQUENCE, run=2)
    assert wire.sent == [bytes.fromhex("4000 0300 241a 02").ljust(64, b"\0")]
    link.write(protocol.SOFTWARE_RESET)
    assert wire.sent[1] == bytes.fromhex("0001 0200 0208").ljust(64, b"\0")
    assert link.requests == 2
    link.close()
    assert wire.closed


def test_a_read_gives_the_fields() -> None:
    link, wire = link_to(lambda r: [echo(r, b"\x02")])
    assert link.read(protocol.MAIN_STATUS)["running"] == 1
    assert wire.sent == [bytes.fromhex("c000 0200 0c1a").ljust(64, b"\0")]


def test_a_selector_travels_with_the_request() -> None:
    link, wire = link_to(lambda r: [echo(r, bytes(16))])
    link.read_bytes(READ_STATUS, what=0x0C)
    assert wire.sent == [bytes.fromhex("c000 0300 1500 0c").ljust(64, b"\0")]


@pytest.mark.parametrize("size", [1, 60, 61, 124, 125, 384])
def test_long_answers_are_put_together(size: int) -> None:
    data = bytes(i % 251 for i in range(size))
    link, _ = link_to(lambda r: [echo(r, data)])
    for _ in range(3):
        assert link.read_bytes(protocol.MAILBOX_DATA) == data


def test_every_request_has_another_number_and_they_come_round() -> None:
    link, wire = link_to(lambda r: [echo(r)])
    for _ in range(257):
        link.write(protocol.FREEZE, on=0)
    assert [report[1] for report in wire.sent] == [*range(256), 0]


def test_silence_is_no_success() -> None:
    link, wire = link_to(lambda r: [])
    with pytest.raises(DeviceTimeoutError, match="projector: sequence: no complete reply within 2 s"):
        link.write(protocol.SEQUENCE, run=2)
    assert wire.clock.now() == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("reply", "found"),
    [
        (UsbMessage(0xC0, 77, b"\x02"), "number 77 and flags 0xc0 instead of 0 and 0xc0"),
        (UsbMessage(0x00, 0, b"\x02"), "number 0 and flags 0x00 instead of 0 and 0xc0"),
    ],
)
def test_a_reply_that_does_not_return_the_requests_number_is_told(reply: UsbMessage, found: str) -> None:
    """And not as silence: the cable is all right."""
    link, wire = link_to(lambda r: [reply])
    with pytest.raises(ProtocolError, match=f"main status: .*{found}.*checks_echo: false.*--no-echo"):
        link.read(protocol.MAIN_STATUS)
    assert wire.clock.now() == pytest.approx(2.0)


def test_without_echo_a_reply_may_have_any_flags() -> None:
    for flags in (0x00, 0x40, 0x80, 0xC0):
        far = lambda r, f=flags: [UsbMessage(f, 0, bytes(range(100)))]  # noqa: E731
        link, _ = link_to(far, checks_echo=False)
        assert link.read_bytes(protocol.MAILBOX_DATA) == bytes(range(100))
        link.write(protocol.SEQUENCE, run=2)


def test_a_missing_continuation_is_silence() -> None:
    link, wire = link_to(lambda r: [echo(r, bytes(100))])
    really_read = wire.read
    wire.read = lambda n, t=0: really_read(n, t) if len(wire.waiting) != 1 else wire.waiting.clear() or []
    with pytest.raises(DeviceTimeoutError):
        link.read_bytes(protocol.MAILBOX_DATA)


def test_a_refusal_is_an_error_whatever_else_it_says() -> None:
    for length in (0, 1, 300):
        link, _ = link_to(lambda r, n=length: [UsbMessage(r.flags | 0x20, r.sequence, bytes(n))])
        with pytest.raises(ProtocolError, match="projector: exposure: the projector refused the command"):
            link.write(protocol.EXPOSURE, exposure_us=1, period_us=1)
        with pytest.raises(ProtocolError, match="main status: the projector refused the command"):
            link_to(lambda r: [UsbMessage(r.flags | 0x20, r.sequence)])[0].read(protocol.MAIN_STATUS)


def test_late_and_doubled_answers_are_not_taken_for_another() -> None:
    """Without numbers each answer would be the one before it."""
    late: list[UsbMessage] = []

    def far(request: UsbMessage) -> list[UsbMessage]:
        value = request.payload[0]  # the command's low byte tells the questions apart
        answers = [*late, echo(request, bytes([value & 1]))]
        late[:] = [echo(request, bytes([value & 1]))]
        return answers

    link, _ = link_to(far)
    for _ in range(3):
        assert link.read(protocol.SYSTEM_STATUS) == {"memory_test_passed": 1}
        assert link.read(protocol.IMAGES_IN_FLASH) == {"count": 0}


def test_a_late_long_answer_is_skipped_whole() -> None:
    late: list[UsbMessage] = []

    def far(request: UsbMessage) -> list[UsbMessage]:
        long = int.from_bytes(request.payload[:2], "little") == protocol.MAILBOX_DATA.number
        reply = echo(request, bytes([0xC0, 1]) * 100 if long else b"\x01")
        answers = [*late, reply]
        late[:] = [reply] if long else []
        return answers

    link, _ = link_to(far)
    link.read_bytes(protocol.MAILBOX_DATA)
    assert link.read(protocol.SYSTEM_STATUS) == {"memory_test_passed": 1}


def test_an_acknowledgement_may_say_anything_after_its_header() -> None:
    link, _ = link_to(lambda r: [UsbMessage(r.flags, r.sequence, b"?" * 56)])
    link.write(protocol.FREEZE, on=1)


@pytest.mark.parametrize("data", [b"", b"\x01\x02", b"\x01" * 60])
def test_an_answer_of_another_length_is_refused(data: bytes) -> None:
    link, _ = link_to(lambda r: [echo(r, data)])
    with pytest.raises(ProtocolError, match=r"main status: (an empty reply|. bytes of data: 1|60 bytes)"):
        link.read(protocol.MAIN_STATUS)


def test_an_answer_that_cannot_be_is_refused() -> None:
    link, _ = link_to(lambda r: [echo(r, b"\x09")])
    with pytest.raises(ProtocolError, match="display mode: mode is 9: 0 to 1"):
        link.read(protocol.DISPLAY_MODE)


@pytest.mark.parametrize("report", [b"\x40\0\0", bytes.fromhex("c000ffff").ljust(64, b"\0")])
def test_reports_that_are_none(report: bytes) -> None:
    link, wire = link_to(lambda r: [])
    wire.waiting.append(report)
    with pytest.raises(ProtocolError, match=r"a (report of 3|payload of 65535) bytes"):
        link.read(protocol.MAIN_STATUS)


def test_an_endless_flood_ends() -> None:
    link, wire = link_to(lambda r: [])
    wire.read = lambda n, t=0: list(UsbMessage(READ | 0x40, 99, b"\1").reports()[0])
    with pytest.raises(ProtocolError, match="only replies to other requests arrived"):
        link.read(protocol.MAIN_STATUS)
    with pytest.raises(ProtocolError, match="unexpected reports keep arriving"):
        link.drain()


def test_a_number_out_of_range_is_not_sent() -> None:
    link, wire = link_to(lambda r: [echo(r)])
    with pytest.raises(SettingError, match="projector: pattern configuration: entries is 129: 1 to 128"):
        link.write(protocol.PATTERN_CONFIG, entries=129, repeat=0, patterns=1, images=1)
    with pytest.raises(SettingError, match="mailbox data: 385 bytes of data: 1 to 384"):
        link.write_bytes(protocol.MAILBOX_DATA, bytes(385))
    assert wire.sent == []


def test_a_device_that_is_gone() -> None:
    link, wire = link_to(lambda r: [])
    wire.gone = True
    with pytest.raises(DisconnectedError, match="projector: sequence: the USB device was unplugged"):
        link.write(protocol.SEQUENCE, run=0)
    link, wire = link_to(lambda r: setattr(wire, "gone", True) or [])
    with pytest.raises(DisconnectedError, match="the USB device was unplugged"):
        link.write(protocol.SEQUENCE, run=0)


def test_a_report_that_cannot_be_sent_is_not_waited_for() -> None:
    link, wire = link_to(lambda r: [])
    wire.write = lambda buff: -1
    for command in (protocol.FREEZE, protocol.SOFTWARE_RESET):
        with pytest.raises(DisconnectedError, match="the USB device was unplugged"):
            link.write(command, **{field.name: 0 for field in command.written.named})
    assert wire.clock.now() == 0.0


def test_without_echo_what_waits_is_thrown_away_first() -> None:
    link, wire = link_to(lambda r: [UsbMessage(r.flags, 0, b"\x01")], checks_echo=False)
    wire.waiting += UsbMessage(READ | 0x40, 0, b"\x00").reports() * 5
    for _ in range(3):
        assert link.read(protocol.SYSTEM_STATUS) == {"memory_test_passed": 1}
    link, wire = link_to(lambda r: [UsbMessage(r.flags | 0x20, 0)], checks_echo=False)
    with pytest.raises(ProtocolError, match="refused"):
        link.read(protocol.SYSTEM_STATUS)


def test_draining_takes_a_bounded_number() -> None:
    link, wire = link_to(lambda r: [])
    wire.waiting += [bytes(64)] * (MAX_STALE_REPORTS - 1)
    link.drain()
    assert wire.waiting == []


# --- opening


class FakeHid:
    def __init__(self, *found: tuple[int, str], refuses: bool = False) -> None:
        self.found, self.refuses = found, refuses
        self.opened: bytes | None = None

    def enumerate(self, vendor_id: int, product_id: int) -> list[dict[str, Any]]:
        assert (vendor_id, product_id) == (0x0451, 0x6401)
        return [
            {"interface_number": n, "serial_number": s, "path": f"{s}:{n}".encode()} for n, s in self.found
        ]

    def device(self) -> FakeHid:
        return self

    def open_path(self, path: bytes) -> None:
        if self.refuses:
            raise OSError("open failed")
        self.opened = path


def test_the_interface_that_takes_commands_is_opened() -> None:
    hid = FakeHid((1, "A"), (0, "A"))
    assert connect(hid, "projector", None) == (hid, "A")
    assert hid.opened == b"A:0"
    hid = FakeHid((0, "A"), (0, "B"))
    assert connect(hid, "projector", "B")[1] == "B"
    assert hid.opened == b"B:0"


def test_two_interfaces_without_a_number_are_one_board() -> None:
    """As macOS lists them."""
    hid = FakeHid((-1, "A"), (-1, "A"))
    assert connect(hid, "projector", None) == (hid, "A")
    with pytest.raises(DeviceError, match=r"2 LightCrafters 4500 .* one of \['A', 'B'\]"):
        connect(FakeHid((-1, "A"), (-1, "B"), (-1, "A"), (-1, "B")), "projector", None)


@pytest.mark.parametrize(
    ("hid", "serial", "error", "words"),
    [
        (
            FakeHid(),
            None,
            DisconnectedError,
            "no LightCrafter 4500 is connected; check its power",
        ),
        (FakeHid((1, "A")), None, DisconnectedError, "no LightCrafter 4500 is connected"),
        (FakeHid((0, "A")), "B", DisconnectedError, "no LightCrafter 4500 with serial number B"),
        (FakeHid((0, "A"), (0, "B")), None, DeviceError, r"2 LightCrafters 4500 .* one of \['A', 'B'\]"),
        (FakeHid((0, "A"), refuses=True), None, DeviceError, r"cannot be opened \(open failed\)"),
    ],
)
def test_what_cannot_be_opened(
    hid: FakeHid, serial: str | None, error: type[DeviceError], words: str
) -> None:
    with pytest.raises(error, match=words):
        connect(hid, "projector", serial)
