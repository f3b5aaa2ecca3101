"""The emulated controller, driven with raw bytes: messages, tables, validation, sequences."""

from typing import Any

import pytest

from drivers.emulators.dlpc350 import STRICT, Dlpc350Policy
from tests.drivers.dlpc350_host import ERROR, OK, Host


@pytest.fixture
def host() -> Host:
    return Host(Dlpc350Policy())


# --- messages


def test_healthy_after_switching_on(host: Host) -> None:
    assert host.read("1a0a") == b"\x01"
    assert host.read("1a0b") == b"\x01"
    assert host.read("1a0c") == b"\x00"
    assert host.read("0205") == bytes.fromhex("00000404") * 4
    assert host.read("1a42") == b"\x04"
    assert host.read("1aff") == b"LCr4500 emulator"
    assert host.read("1a1b") == b"\x00"
    assert host.read("0b01") == bytes.fromhex("97787d")
    assert host.read("1a29") == (500_000).to_bytes(4, "little") * 2
    assert host.read("1a37") == b"\x04"
    assert host.read("1a1d") == bytes.fromhex("00bbbb")


@pytest.mark.parametrize(
    "words",
    [
        "1008 01",
        "1a3f 1f07",
        "1a35 ffff0700",
        "1a0e 81",
        "1204" + "ff03" * 6,
    ],
)
def test_registers_are_read_back_as_written(host: Host, words: str) -> None:
    assert host.write(words) == OK
    assert host.read(words[:4]) == bytes.fromhex(words[4:])


def test_one_reply_if_asked_for_and_none_else(host: Host) -> None:
    assert host.send("1008 01", 0x40) == bytes.fromhex("40070200 0810")
    assert host.send("1008 00", 0x00) == b""
    assert host.read("1008") == b"\x00", "and yet it was done"
    assert host.device.read(64, 1) == []


@pytest.mark.parametrize(
    "words",
    ["0300 01", "1a24", "1a24 0000", "1a24 03", "1a1b 02", "1a22 01", "1a0a 01", "3001", "1a1d 00d600"],
)
def test_a_wrong_write_is_refused_and_changes_nothing(host: Host, words: str) -> None:
    known = ("1a24", "1a1b", "1a22", "1a1d")
    before = [host.read(number) for number in known]
    assert host.write(words) == ERROR
    assert [host.read(number) for number in known] == before


def test_an_acknowledgement_carries_the_command() -> None:
    """Bytes 4 and 5, low byte first, whether it is carried out or refused; clients check them."""
    for words, flags in (("1a24 00", OK), ("1a24 03", ERROR)):
        assert Host(Dlpc350Policy()).send(words)[:6] == bytes([flags, 7, 2, 0, 0x24, 0x1A])
        assert Host(Dlpc350Policy(acknowledges_with_command=False)).send(words) == bytes([flags, 7, 0, 0])


def test_a_client_that_checks_every_acknowledgement_runs_its_sequence() -> None:
    """That bytes 4 and 5 are those of its request."""

    class Checking(Host):
        def write(self, words: str) -> int:
            reply = self.send(words)
            assert reply[4:6] == bytes.fromhex(words)[1::-1]
            return reply[0]

    host = Checking(Dlpc350Policy())
    host.run()
    assert host.greys(3) == [1, 2, 3]


@pytest.mark.parametrize("words", ["0300", "0802", "1a0a 00", "1a16 003409f9"])
def test_a_wrong_read_is_refused(host: Host, words: str) -> None:
    assert host.send(words, 0xC0)[0] == 0xE0


def test_what_is_too_long_for_the_buffer_is_not_answered(host: Host) -> None:
    assert host.device.write(b"\0" + bytes.fromhex("4000 ffff 241a").ljust(64, b"\0")) == 65
    assert host.device.read(64, 50) == []
    assert host.write("1008 01") == OK


@pytest.mark.parametrize("count", [19, 20, 128])
def test_a_long_table_in_one_message(host: Host, count: int) -> None:
    entry = "007804"
    host.sequence(entries=entry + "047800" * (count - 1), images="00")
    assert host.write("1a33 02") == OK
    assert host.read("1a34") == bytes.fromhex(entry + "047800" * (count - 1))


def test_other_destinations() -> None:
    assert Host(Dlpc350Policy()).send("1008 01", 0x41) == b""
    assert Host(Dlpc350Policy(answers_other_destinations=True)).send("1008 01", 0x41)[0] == 0x61


def test_the_number_in_a_reply() -> None:
    assert Host(Dlpc350Policy()).send("1a0a", 0xC0, 200)[1] == 200
    assert Host(Dlpc350Policy(echoes_sequence=False)).send("1a0a", 0xC0, 200)[1] == 0


# --- tables


@pytest.mark.parametrize(
    ("mailbox", "words"),
    [
        ("00", "1a34 007804"),
        ("02", "1a34 00780400"),
        ("02", "1a34" + "00" * 387),
        ("01", "1a34" + "00" * 65),
        ("01", "1a3e" + "00" * 12),
        ("03", "1a34 007804"),
    ],
)
def test_data_that_do_not_fit_the_open_table(host: Host, mailbox: str, words: str) -> None:
    assert host.write(f"1a33 {mailbox}") == OK
    assert host.write(words) == ERROR


def test_an_open_mailbox_blocks_validation_and_start(host: Host) -> None:
    host.sequence()
    host.write("1a33 01")
    assert host.write("1a1a 00") == ERROR
    host.write("1a33 00")
    assert host.validate() == 0
    host.write("1a33 01")
    assert host.write("1a24 02") == ERROR


def test_entries_one_by_one_make_the_same_table(host: Host) -> None:
    host.sequence()
    host.write("1a33 02")
    for i, entry in enumerate(("087804", "047800", "007800")):
        assert host.write(f"1a32 {i:02x}") == OK
        assert host.write(f"1a34 {entry}") == OK
    host.write("1a33 00")
    assert host.validate() == 0
    host.write("1a24 02")
    assert host.greys(3) == [3, 2, 1]


# --- validation

VERDICTS = [
    ({}, 0),
    ({"exposure_us": 8333, "period_us": 8333}, 0),
    ({"exposure_us": 8332, "period_us": 8332}, 0b1),
    ({"exposure_us": 10_001}, 0b1),
    ({"entries": "007804 047808", "exposure_us": 16_665, "period_us": 16_665}, 0b1),
    ({"entries": "007804 047808", "exposure_us": 16_666, "period_us": 16_666}, 0),
    ({"entries": "0c7804"}, 0b10),
    ({"entries": "007004"}, 0b10),
    ({"entries": "007904"}, 0b10),
    ({"entries": "647104"}, 0b10),  # number 25 at depth 1
    ({"entries": "607104"}, 0),
    ({"images": "04"}, 0b10),
    ({"images": "0001"}, 0b10),
    ({"entries": "007804 047804"}, 0b10),
    ({"entries": "007806 047808", "exposure_us": 20_000, "period_us": 20_000}, 0b100),
    ({"entries": "007804 057800"}, 0b1000),
    ({"entries": "007806 057800"}, 0),
    ({"period_us": 10_229}, 0b10000),
    ({"period_us": 10_231}, 0),
]


@pytest.mark.parametrize(("changes", "verdict"), VERDICTS)
def test_verdicts(host: Host, changes: dict[str, Any], verdict: int) -> None:
    host.sequence(**changes)
    assert host.validate() == verdict


@pytest.mark.parametrize("depth", range(1, 9))
def test_the_least_exposure_of_each_depth(host: Host, depth: int) -> None:
    least = {1: 235, 2: 700, 3: 1570, 4: 1700, 5: 2000, 6: 2500, 7: 4500, 8: 8333}[depth]
    for exposure, verdict in ((least, 0), (least - 1, 1)):
        host.sequence(entries=f"007{depth}04", exposure_us=exposure, period_us=exposure)
        assert host.validate() == verdict


def test_exactly_230_us_is_a_policy() -> None:
    for accepts, verdict in ((True, 0), (False, 0b10000)):
        host = Host(Dlpc350Policy(accepts_a_gap_of_230_us=accepts))
        host.sequence(period_us=10_230)
        assert host.validate() == verdict


def test_fewer_entries_than_declared(host: Host) -> None:
    host.sequence()
    host.write("1a31 0301 0300")
    assert host.validate() == 0b10


def test_it_is_busy_for_a_while_and_says_nothing_else() -> None:
    """By time, not by how often it is asked: a client that only waits finds it done as well."""
    for busy_s in (0.0, 0.02):
        host = Host(Dlpc350Policy(validation_s=busy_s))
        host.sequence(exposure_us=1)
        host.write("1a1a 00")
        assert {host.read("1a1a")[0] for _ in range(4)} == {0x80 if busy_s else 1}
        host.clock.sleep(0.021)
        assert host.read("1a1a")[0] == 1


def test_a_start_during_the_validation_is_ignored() -> None:
    host = Host(Dlpc350Policy(validation_s=0.02))
    host.sequence()
    host.write("1a1a 00")
    host.write("1a24 02")
    assert not host.running
    host.clock.sleep(0.021)
    host.write("1a24 02")
    assert host.running


def test_a_client_that_orders_the_start_twice_and_never_polls_runs_its_sequence() -> None:
    for policy in (Dlpc350Policy(), STRICT):
        host = Host(policy)
        host.sequence()
        host.write("1a1a 00")
        host.clock.sleep(0.1)
        host.write("1a24 02")
        host.write("1a24 02")
        host.clock.sleep(policy.running_shown_late_s)
        assert host.running
        assert sorted(host.greys(3)) == [1, 2, 3]


def test_the_status_says_that_it_runs_a_while_after_it_does() -> None:
    host = Host(Dlpc350Policy(running_shown_late_s=0.1))
    host.run()
    assert sorted(host.greys(3)) == [1, 2, 3]  # which takes 0.03 s
    assert not host.running
    host.clock.sleep(0.1)
    assert host.running


# --- running


def test_patterns_follow_each_other_until_stopped(host: Host) -> None:
    host.run()
    assert host.running
    assert host.read("1a24") == b"\x02"
    assert host.greys(7) == [1, 2, 3, 1, 2, 3, 1]
    assert host.write("1a24 00") == OK
    assert not host.running
    assert host.read("1a24") == b"\x00"
    host.write("1a24 02")
    assert host.greys(1) == [1], "from the beginning"


def test_a_pause_keeps_its_place(host: Host) -> None:
    host.run()
    host.greys(2)
    host.write("1a24 00")
    host.write("1a24 02")
    assert host.greys(1) == [1]
    host.clock.sleep(0.005)
    host.write("1a24 01")
    assert host.read("1a24") == b"\x01"
    host.clock.sleep(1.0)
    assert host.grey() == 2
    host.write("1a24 02")
    assert host.greys(2) == [2, 3]


def test_once_means_as_often_as_patterns_are_counted(host: Host) -> None:
    for patterns, seen in ((3, [1, 2, 3]), (2, [1, 2]), (5, [1, 2, 3, 1, 2])):
        host.run(repeat=0, patterns=patterns)
        host.pulses.clear()
        assert host.greys(len(seen)) == seen
        host.clock.sleep(1.0)
        assert not host.running
        assert host.read("1a24") == b"\x00"
        assert [p.pattern for p in host.pulses if p.output == 1] == list(range(len(seen)))


def test_what_stays_after_the_end_is_a_policy() -> None:
    for keeps, after in ((True, 3), (False, -1)):
        host = Host(Dlpc350Policy(keeps_last_pattern=keeps))
        host.run(repeat=0)
        host.clock.sleep(1.0)
        assert host.grey() == after


def test_dark_between_exposures(host: Host) -> None:
    host.run(period_us=20_000)
    assert host.greys(4, 0.01) == [1, -1, 2, -1]


def test_a_table_of_two_images_is_read_from_its_end(host: Host) -> None:
    entries = "007804 007804"
    host.run(entries=entries, images="0201")
    assert host.greys(2) == [11, 21]
    host.write("1a24 00")
    host.run(entries=entries + "007804", images="010203", period_us=30_000)
    assert host.greys(3, 0.03) == [-1, -1, -1]  # seen in the dark halves of the periods


def test_images_in_their_order(host: Host) -> None:
    host.run(entries="007804 007804 007804", images="010203", exposure_us=30_000, period_us=30_000)
    assert host.greys(3, 0.03) == [11, 21, 31]
    assert host.read("1a0a") == b"\x01"


def test_an_image_that_is_not_loaded_leaves_the_old_one(host: Host) -> None:
    host.run(entries="007804 007804 007804", images="010203", exposure_us=19_000, period_us=19_000)
    assert host.greys(3, 0.019) == [11, 11, 11]
    assert host.read("1a0a") == b"\x09"


def test_load_times_are_told_for_several_images_together(host: Host) -> None:
    host.controller.load_s[:] = [0.001, 0.002, 0.004, 0.008]
    for first, count, ms in ((0, 1, 1), (1, 2, 6), (3, 1, 8)):
        assert host.write(f"1a3a {first:02x} {count:02x}") == OK
        assert int.from_bytes(host.read("1a3a"), "little") == ms * 18667
    assert host.write("1a3a 03 02") == ERROR
    assert host.write("1a3a 00 00") == ERROR


def test_a_shared_pulse_shares_its_exposure(host: Host) -> None:
    host.run(entries="007804 047808", exposure_us=20_000, period_us=20_000)
    host.pulses.clear()
    assert host.greys(4) == [1, 2, 1, 2]
    outputs = [p for p in host.pulses if p.output == 1]
    assert [p.fall_s - p.rise_s for p in outputs] == pytest.approx([0.02] * 2)


def test_variable_exposures(host: Host) -> None:
    host.sequence(mode="03")
    host.write("1a40 0100 0100 00 01")
    host.write("1a33 03")
    for i, (entry, us) in enumerate((("00780400", 10_000), ("04780000", 30_000))):
        host.write(f"1a3f {i:02x}00")
        times = us.to_bytes(4, "little").hex()
        assert host.write(f"1a3e {entry} {times} {times}") == OK
        assert host.read("1a3e") == bytes.fromhex(entry + times + times)
    host.write("1a3f 0000")
    host.write("1a33 01")
    host.write("1a34 00")
    host.write("1a33 00")
    assert host.validate() == 0
    host.write("1a24 02")
    assert host.greys(8) == [1, 2, 2, 2, 1, 2, 2, 2]


def test_pulses_and_their_delays(host: Host) -> None:
    host.write("1a1d 00 00 d5")
    host.write("1a1e 00 bc")
    host.run(patterns=2)
    begin = host.clock.now()
    host.clock.sleep(0.035)
    host.controller.advance()
    first = [p for p in host.pulses if p.output == 1]
    assert [p.rise_s - begin for p in first] == pytest.approx([k * 0.01 - 187 * 0.1072e-6 for k in range(4)])
    assert [p.fall_s - begin for p in first] == pytest.approx(
        [(k + 1) * 0.01 + 26 * 0.1072e-6 for k in range(4)]
    )
    second = [p for p in host.pulses if p.output == 2]
    assert [p.rise_s - begin for p in second] == pytest.approx([0.1072e-6, 0.02 + 0.1072e-6])


def test_waiting_for_an_edge(host: Host) -> None:
    host.write("1a35 64000000")  # 100 steps of 107.2 ns
    host.run(entries="017806 067802 057800", exposure_us=10_000, period_us=10_231)
    assert host.greys(3) == [-1, -1, -1]
    host.controller.trigger_in(1, rising=False)
    assert host.greys(1) == [-1], "the first one waits for a rising edge"
    host.controller.trigger_in(1, rising=True)
    begin = host.clock.now()
    assert host.greys(1) == [1]
    assert host.pulses[0].rise_s - begin == pytest.approx(100 * 0.1072e-6)
    host.controller.trigger_in(1, rising=False)
    assert host.greys(1) == [2]
    host.clock.sleep(0.01)
    host.controller.trigger_in(1, rising=True)
    host.clock.sleep(0.001)
    host.controller.trigger_in(1, rising=True)
    assert host.greys(2, 0.0102) == [2, -1], "an edge within a period is lost"


def test_alternating_pairs(host: Host) -> None:
    host.run(entries="007804 047800 087800 007800", mode="02")
    assert host.grey() == 1
    seen = []
    for number in (1, 1, 1, 2, 1, 2):
        host.controller.trigger_in(number, rising=True)
        seen.append(host.grey())
    assert seen == [2, 1, 2, 3, 1, 1]
