"""Packets of the DLPC350: every row of its tables as bytes, and each command there and back."""

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dlp4500 import protocol
from drivers.dlp4500.framing import (
    ERROR,
    MAX_PAYLOAD_BYTES,
    READ,
    REPLY_WANTED,
    UsbMessage,
    continuation_reports,
    join_reports,
    make_request,
    parse_header,
)
from drivers.dlp4500.layout import Command, RawBytes, RegisterField, RegisterLayout
from drivers.dlp4500.protocol import COMMANDS, ENTRY, VALIDATION

WRITTEN: dict[int, tuple[dict[str, int], str]] = {
    0x0200: ({"standby": 1}, "01"),
    0x0802: ({}, ""),
    0x1A1B: ({"mode": 1}, "01"),
    0x1A00: ({"source": 0, "width": 1}, "08"),
    0x1A02: ({"format": 2}, "02"),
    0x1A03: ({"clock": 2}, "02"),
    0x1A37: ({"swap": 4, "port": 1}, "84"),
    0x1008: ({"on": 1}, "01"),
    0x1009: ({"on": 1}, "01"),
    0x100A: ({"on": 1}, "01"),
    0x1000: (
        {
            "crop_pixel": 1,
            "crop_line": 2,
            "crop_pixels": 912,
            "crop_lines": 1140,
            "display_pixel": 3,
            "display_line": 4,
            "display_pixels": 0x1234,
            "display_lines": 0xFFFF,
        },
        "0100 0200 9003 7404 0300 0400 3412 ffff",
    ),
    0x1203: ({"pattern": 10}, "0a"),
    0x1204: (
        {
            "front_red": 1023,
            "front_green": 1,
            "front_blue": 2,
            "back_red": 3,
            "back_green": 4,
            "back_blue": 512,
        },
        "ff03 0100 0200 0300 0400 0002",
    ),
    0x1A3A: ({"first": 2, "count": 3}, "02 03"),
    0x1A0E: ({"table": 1, "on": 1}, "81"),
    0x1A07: ({"red": 1, "green": 0, "blue": 1, "sequenced": 1}, "0d"),
    0x0B01: ({"red": 0x97, "green": 0x78, "blue": 0x7D}, "97 78 7d"),
    0x1A05: ({"inverted": 1}, "01"),
    0x1A36: ({"inverted": 1}, "01"),
    0x1A1F: ({"rising": 0xBB, "falling": 0}, "bb 00"),
    0x1A20: ({"rising": 1, "falling": 2}, "01 02"),
    0x1A21: ({"rising": 3, "falling": 0xFF}, "03 ff"),
    0x1A1D: ({"inverted": 1, "rising": 0xBB, "falling": 0xD5}, "01 bb d5"),
    0x1A1E: ({"inverted": 0, "rising": 0xBA}, "00 ba"),
    0x1A35: ({"delay": 0x7FFFF}, "ffff0700"),
    0x1A22: ({"source": 3}, "03"),
    0x1A23: ({"mode": 4}, "04"),
    0x1A24: ({"run": 2}, "02"),
    0x1A29: ({"exposure_us": 8333, "period_us": 500_000}, "8d200000 20a10700"),
    0x1A30: ({"on": 1}, "01"),
    0x1A31: ({"entries": 36, "repeat": 1, "patterns": 256, "images": 12}, "23 01 ff 0b"),
    0x1A40: ({"entries": 1824, "patterns": 300, "images": 256, "repeat": 1}, "1f07 2b01 ff 01"),
    0x1A32: ({"address": 127}, "7f"),
    0x1A33: ({"table": 2}, "02"),
    0x1A3F: ({"address": 1823}, "1f07"),
    0x1A3E: (
        {
            "trigger": 1,
            "pattern": 0,
            "depth": 7,
            "red": 1,
            "green": 1,
            "blue": 1,
            "invert": 0,
            "black_after": 0,
            "swap": 0,
            "share_trigger": 0,
            "exposure_us": 4500,
            "period_us": 4731,
        },
        "01770000 94110000 7b120000",
    ),
    0x1A1A: ({}, "00"),
}
"""By number: fields, and the bytes of data that they are on the wire."""

RETURNED: dict[int, tuple[dict[str, int], str]] = {
    0x1A0A: (
        {
            "initialised": 1,
            "reset_controller_error": 0,
            "forced_swap_error": 0,
            "sequencer_aborted": 1,
            "sequencer_error": 0,
        },
        "41",
    ),
    0x1A0B: ({"memory_test_passed": 1}, "01"),
    0x1A0C: ({"parked": 0, "running": 0, "frozen": 1, "gamma": 1}, "0c"),
    0x0205: (
        {
            f"{part}_{field}": value
            for part, version in zip(
                protocol.PARTS, ((4, 4, 0), (1, 2, 3), (5, 6, 0x0107), (255, 254, 0xFFFF)), strict=True
            )
            for field, value in zip(("major", "minor", "patch"), version, strict=True)
        },
        "00000404 03000201 07010605 fffffeff",
    ),
    0x1A42: ({"count": 12}, "0c"),
    0x0200: ({"standby": 2}, "02"),
    0x1A3A: ({"ticks": 373_340}, "5cb20500"),
    0x071C: (
        {
            "lock": 2,
            "horizontal_resolution": 912,
            "vertical_resolution": 1140,
            "horizontal_sync_polarity": 1,
            "vertical_sync_polarity": 0,
            "pixel_clock": 0x11223344,
            "horizontal_frequency": 5,
            "vertical_frequency": 60,
            "total_pixels": 1000,
            "total_lines": 1200,
            "active_pixels": 912,
            "active_lines": 1140,
            "first_pixel": 7,
            "first_line": 8,
        },
        "02 9003 7404 00 01 00 44332211 0500 3c00 e803 b004 9003 7404 0700 0800",
    ),
    0x1A1A: (
        {
            "exposure_invalid": 1,
            "pattern_invalid": 0,
            "trigger_overlap": 1,
            "black_missing": 0,
            "gap_too_short": 1,
            "busy": 1,
        },
        "95",
    ),
}
"""The same for what only a reply holds, or holds otherwise than a write."""

RAW = {0x1AFF, 0x1A34}


def record(layout: object) -> RegisterLayout:
    assert isinstance(layout, RegisterLayout)
    return layout


def test_every_command_has_a_row() -> None:
    for number, command in COMMANDS.items():
        assert number in RAW or command.written is None or number in WRITTEN, command.name
        told = command.returned is not None and command.returned != command.written
        assert number in RAW or not told or number in RETURNED, command.name
    assert set(WRITTEN) | set(RETURNED) | RAW == set(COMMANDS)


@pytest.mark.parametrize("number", WRITTEN, ids=hex)
def test_a_command_is_written_as_its_row_says(number: int) -> None:
    values, data = WRITTEN[number]
    layout = record(COMMANDS[number].written)
    assert layout.pack(values) == bytes.fromhex(data)
    assert layout.unpack(bytes.fromhex(data)) == values


@pytest.mark.parametrize("number", RETURNED, ids=hex)
def test_a_reply_is_read_as_its_row_says(number: int) -> None:
    values, data = RETURNED[number]
    layout = record(COMMANDS[number].returned)
    assert layout.unpack(bytes.fromhex(data)) == values
    assert layout.pack(values) == bytes.fromhex(data)


def test_reserved_bits_are_not_read() -> None:
    assert record(protocol.MAIN_STATUS.returned).unpack(b"\xf2") == {
        "parked": 0, "running": 1, "frozen": 0, "gamma": 0,
    }  # fmt: skip
    assert protocol.SOFTWARE_RESET.acknowledged is False
    assert all(c.acknowledged for c in COMMANDS.values() if c is not protocol.SOFTWARE_RESET)


@pytest.mark.parametrize(
    ("changes", "data"),
    [
        ({"pattern": 0, "depth": 8, "black_after": 1, "swap": 1}, "007806"),
        ({"pattern": 1, "depth": 8, "black_after": 1}, "047802"),
        ({"trigger": 1, "pattern": 0, "depth": 7}, "017700"),
        ({"pattern": 0, "depth": 8, "black_after": 1, "swap": 1, "green": 0, "blue": 0}, "001806"),
        ({"pattern": 1, "depth": 8, "black_after": 1, "red": 0, "blue": 0}, "042802"),
        ({"pattern": 2, "depth": 8, "black_after": 1, "red": 0, "green": 0}, "084802"),
        ({"pattern": 24, "depth": 1, "invert": 1, "share_trigger": 1, "trigger": 3}, "637109"),
    ],
)
def test_entries_that_the_makers_client_sends(changes: dict[str, int], data: str) -> None:
    plain = dict.fromkeys((f.name for f in ENTRY.named), 0) | dict.fromkeys(protocol.COLOURS, 1)
    assert ENTRY.pack(plain | changes) == bytes.fromhex(data)
    assert ENTRY.unpack(bytes.fromhex(data)) == plain | changes


RECORDS = [
    (f"{command.name} {kind}", layout)
    for command in COMMANDS.values()
    for kind, layout in (
        ("written", command.written),
        ("returned", command.returned),
        ("selector", command.selector),
    )
    if isinstance(layout, RegisterLayout) and layout.fields
] + [("entry", ENTRY), ("validation", VALIDATION)]


def values_of(layout: RegisterLayout) -> st.SearchStrategy[dict[str, int]]:
    return st.fixed_dictionaries({f.name: one_of(f.values()) for f in layout.named})


def one_of(values: Sequence[int]) -> st.SearchStrategy[int]:
    return st.integers(values[0], values[-1]) if isinstance(values, range) else st.sampled_from(values)


@pytest.mark.whole_after(7)
@pytest.mark.parametrize("layout", [r[1] for r in RECORDS], ids=[r[0] for r in RECORDS])
def test_there_and_back_is_an_identity(layout: RegisterLayout) -> None:
    @given(values_of(layout), st.binary(min_size=layout.size, max_size=layout.size))
    def check(values: dict[str, int], data: bytes) -> None:
        packed = layout.pack(values)
        assert len(packed) == layout.size
        assert layout.unpack(packed) == values
        try:
            found = layout.unpack(data)
        except ValueError:
            return
        assert layout.unpack(layout.pack(found)) == found

    check()


def beyond(field: RegisterField) -> list[int]:
    allowed = field.values()
    return [value for value in (allowed[0] - 1, allowed[-1] + 1) if value not in allowed]


@pytest.mark.parametrize("layout", [r[1] for r in RECORDS], ids=[r[0] for r in RECORDS])
def test_what_is_out_of_range_is_refused_with_its_name(layout: RegisterLayout) -> None:
    good = {field.name: field.values()[0] for field in layout.named}
    for field in layout.named:
        for value in beyond(field):
            with pytest.raises(ValueError, match=f"{field.name} is {value}"):
                layout.pack(good | {field.name: value})
    with pytest.raises(ValueError, match="the fields are"):
        layout.pack(good | {"speed": 1})
    for size in (layout.size - 1, layout.size + 1):
        with pytest.raises(ValueError, match=f"{size} bytes of data: {layout.size}"):
            layout.unpack(bytes(size))


@pytest.mark.parametrize(
    ("command", "data"),
    [
        (protocol.DISPLAY_MODE, "02"),
        (protocol.INPUT_SOURCE, "30"),
        (protocol.PATTERN_SOURCE, "01"),
        (protocol.TRIGGER_MODE, "05"),
        (protocol.SEQUENCE, "03"),
        (protocol.TRIGGER_OUT_1, "00d600"),
        (protocol.TRIGGER_IN_1, "00000800"),
        (protocol.PATTERN_CONFIG, "80000000"),
        (protocol.PATTERN_CONFIG, "00000040"),
        (protocol.VARIABLE_CONFIG, "200700000000"),
    ],
)
def test_an_answer_that_cannot_be_is_refused(command: Command, data: str) -> None:
    with pytest.raises(ValueError, match=" is "):
        record(command.returned).unpack(bytes.fromhex(data))


def test_bytes_are_counted() -> None:
    table = protocol.MAILBOX_DATA.written
    assert isinstance(table, RawBytes)
    table.check(bytes(384))
    for size in (0, 385):
        with pytest.raises(ValueError, match=f"{size} bytes of data: 1 to 384"):
            table.check(bytes(size))


# --- reports


def test_a_read_on_the_wire() -> None:
    (report,) = make_request(0x1A0C, b"", 0, READ | REPLY_WANTED).reports()
    assert report == bytes.fromhex("c000 0200 0c1a").ljust(64, b"\0")


def test_a_write_on_the_wire() -> None:
    (report,) = make_request(0x1A24, b"\x02", 5, REPLY_WANTED).reports()
    assert report == bytes.fromhex("4005 0300 241a 02").ljust(64, b"\0")


@pytest.mark.parametrize(("data", "reports"), [(0, 1), (58, 1), (59, 2), (122, 2), (123, 3), (384, 7)])
def test_how_many_reports_a_request_takes(data: int, reports: int) -> None:
    assert len(make_request(0x1A34, bytes(data), 0, REPLY_WANTED).reports()) == reports
    assert 1 + continuation_reports(data + 2) == reports


def test_what_follows_the_first_report_has_no_header() -> None:
    data = bytes(range(1, 124))
    first, second, third = make_request(0x1A34, data, 9, REPLY_WANTED).reports()
    assert first == bytes.fromhex("4009 7d00 341a") + data[:58]
    assert second == data[58:122]
    assert third == data[122:].ljust(64, b"\0")


messages = st.builds(
    UsbMessage, st.integers(0, 255), st.integers(0, 255), st.binary(max_size=MAX_PAYLOAD_BYTES)
)


@given(messages, st.binary(min_size=64, max_size=64))
def test_a_message_survives_its_reports_and_any_padding(message: UsbMessage, rubbish: bytes) -> None:
    reports = message.reports()
    used = (4 + len(message.payload)) % 64 or 64
    padded = [*reports[:-1], reports[-1][:used] + rubbish[used:]]
    assert join_reports(reports) == join_reports(padded) == message
    assert parse_header(reports[0]) == (message.flags, message.sequence, len(message.payload))


@given(messages, st.integers(0, 70))
def test_reports_that_do_not_fit_their_header_are_refused(message: UsbMessage, size: int) -> None:
    reports = message.reports()
    with pytest.raises(ValueError, match="reports for a payload"):
        join_reports([*reports, bytes(64)])
    if size != 64:
        with pytest.raises(ValueError, match="report"):
            join_reports([*reports[:-1], reports[-1][:1] * size])


def test_what_no_buffer_holds_is_refused() -> None:
    with pytest.raises(ValueError, match="509 bytes: at most 508"):
        UsbMessage(0, 0, bytes(509)).reports()
    with pytest.raises(ValueError, match="509 bytes: at most 508"):
        parse_header(bytes.fromhex("4000fd01").ljust(64, b"\0"))


def test_the_error_bit() -> None:
    assert UsbMessage(0x60, 0).failed
    assert UsbMessage(0xE0, 0).failed
    assert not UsbMessage(0xC0 & ~ERROR, 0).failed
