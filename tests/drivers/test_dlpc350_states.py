"""The emulated controller, driven with raw bytes: refused commands, modes, light and USB faults."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dlp4500.sequence import bit_planes
from drivers.emulators.dlpc350 import Dlpc350Policy, EmulatedDisplay, UsbFault, Video
from drivers.emulators.dlpc350.light import grey_levels
from tests.drivers.dlpc350_host import ERROR, OK, Host, flat

FRAME = flat(1, 2, 3)
"""Red 1, green 2, blue 3."""
FRAME_S = 1 / 60


@pytest.fixture
def host() -> Host:
    return Host(Dlpc350Policy())


# --- what stops a start


def test_a_start_without_validation_is_a_policy() -> None:
    for needs, runs in ((True, False), (False, True)):
        host = Host(Dlpc350Policy(needs_validation=needs))
        host.sequence()
        assert host.write("1a24 02") == OK
        assert host.running is runs
        assert host.read("1a0a") == (b"\x01" if runs else b"\x41")


def test_a_change_after_validation_needs_another(host: Host) -> None:
    host.sequence()
    host.validate()
    host.write("1a29" + (20_000).to_bytes(4, "little").hex() * 2)
    host.write("1a24 02")
    assert not host.running
    host.validate()
    host.write("1a24 02")
    assert host.running
    assert host.read("1a0a") == b"\x01"


def test_a_start_while_validation_is_busy_is_ignored(host: Host) -> None:
    host.sequence()
    host.write("1a1a 00")
    host.write("1a24 02")
    assert not host.running
    assert host.read("1a0a") == b"\x01"


def test_an_invalid_sequence_does_not_start(host: Host) -> None:
    host.sequence(exposure_us=100, period_us=100)
    assert host.validate() == 1
    host.write("1a24 02")
    assert not host.running


def test_changes_while_running_are_a_policy() -> None:
    for refuses, flags in ((True, ERROR), (False, OK)):
        host = Host(Dlpc350Policy(refuses_changes_while_running=refuses))
        host.run()
        assert host.write("1a30 01") == flags
        host.write("1a24 01")
        assert host.write("1a30 01") == flags, "paused"
        host.write("1a24 00")
        assert host.write("1a30 01") == OK


def test_without_a_video_signal_vsync_sequences_do_not_run(host: Host) -> None:
    host.pattern_mode()
    host.write("1a22 00")
    host.sequence(entries="017804 077800", mode="00", exposure_us=8333, period_us=8333)
    assert host.validate() & 1, "no frame is long enough"
    host.controller.video = Video(FRAME)
    assert host.read("071c")[0] & 3 == 2
    assert host.validate() == 0
    host.write("1a24 02")
    assert not host.running, "the signal came after pattern mode"
    through_video_mode(host)
    assert host.validate() == 0
    host.write("1a24 02")
    assert host.running
    to_the_next_vsync(host)
    assert host.greys(4, 1 / 120) == [2, 1, 2, 1]
    host.controller.video.locked = False
    host.write("1a24 00")
    host.write("1a24 02")
    assert not host.running
    assert host.read("1a0a") == b"\x41"


def through_video_mode(host: Host) -> None:
    host.write("1a1b 00")
    host.clock.sleep(1.0)
    host.pattern_mode()


def to_the_next_vsync(host: Host) -> None:
    host.clock.sleep(FRAME_S - host.clock.now() % FRAME_S)


def run_from_video(host: Host, entries: str, exposure_us: int, repeat: int) -> None:
    """Set pattern mode from a port with a signal, and a sequence that begins at the next VSYNC."""
    host.pattern_mode()
    host.write("1a22 00")
    times = {"exposure_us": exposure_us, "period_us": exposure_us}
    host.run(entries=entries, mode="00", repeat=repeat, **times)
    to_the_next_vsync(host)


def test_without_the_policy_a_signal_may_come_later() -> None:
    host = Host(Dlpc350Policy(needs_lock_before_pattern_mode=False))
    host.pattern_mode()
    host.controller.video = Video(FRAME)
    host.write("1a22 00")
    host.run(entries="017804", mode="00", exposure_us=8333, period_us=8333)
    assert host.running


@pytest.mark.parametrize("names_the_input", [True, False])
@pytest.mark.parametrize(
    ("swap", "inputs", "outputs"),
    [
        ("00", [1, 2, 3], [1, 2, 3]),
        ("01", [3, 1, 2], [2, 3, 1]),
        ("02", [2, 3, 1], [3, 1, 2]),
        ("03", [1, 3, 2], [1, 3, 2]),
        ("04", [2, 1, 3], [2, 1, 3]),
        ("05", [3, 2, 1], [3, 2, 1]),
    ],
)
def test_a_channel_swap_permutes_the_patterns_of_a_frame(
    swap: str, inputs: list[int], outputs: list[int], names_the_input: bool
) -> None:
    """Grey levels of patterns 0, 1, 2; the board's setting 04 gives green, red, blue."""
    host = Host(Dlpc350Policy(swap_letter_is_input=names_the_input))
    host.controller.video = Video(FRAME, 3 * FRAME_S)
    host.write(f"1a37 {swap}")
    host.pattern_mode()
    host.write("1a22 00")
    host.run(entries="017804 077800 0b7800", mode="00", exposure_us=16_000, period_us=16_000)
    host.clock.sleep(3 * FRAME_S - host.clock.now() % (3 * FRAME_S))
    assert host.greys(3, 0.016) == (inputs if names_the_input else outputs)


def test_a_frame_begins_with_the_next_vsync_and_a_running_sequence_takes_it(host: Host) -> None:
    display = EmulatedDisplay(host.controller, FRAME_S)
    display.open()
    run_from_video(host, "017804", 16_666, repeat=1)
    assert host.greys(2, FRAME_S) == [0, 0]
    display.show(flat(10, 20, 30))
    now = host.clock.now()
    assert now == pytest.approx(round(now / FRAME_S) * FRAME_S, abs=1e-8)
    assert host.greys(3, FRAME_S) == [20, 20, 20]
    display.close()
    assert host.greys(1, FRAME_S) == [128], "the desktop"


def test_a_sequence_that_has_ended_keeps_the_frame_that_it_took(host: Host) -> None:
    display = EmulatedDisplay(host.controller, FRAME_S)
    display.show(FRAME)
    run_from_video(host, "017804 077800", 8333, repeat=0)
    assert host.greys(2, 1 / 120) == [2, 1]
    display.show(flat(10, 20, 30))
    assert not host.running
    assert host.grey() == 1


# --- modes, power, light


def test_the_display_mode_takes_its_time(host: Host) -> None:
    host.write("1a1b 01")
    assert host.read("1a1b") == b"\x00"
    host.clock.sleep(0.19)
    assert host.read("1a1b") == b"\x00"
    host.clock.sleep(0.02)
    assert host.read("1a1b") == b"\x01"


def test_leaving_pattern_mode_stops_and_forgets_the_validation(host: Host) -> None:
    host.run()
    host.write("1a1b 00")
    assert not host.running
    host.clock.sleep(1.0)
    host.write("1a24 02")
    assert not host.running, "in video mode a start does nothing"
    assert host.read("1a0a") == b"\x01"
    host.pattern_mode()
    host.write("1a24 02")
    assert host.read("1a0a") == b"\x41"


def test_load_times_are_not_measured_while_patterns_are_shown_from_flash(host: Host) -> None:
    host.run()
    assert host.write("1a3a 00 01") == ERROR
    host.write("1a24 00")
    assert host.write("1a3a 00 01") == OK


def test_standby_from_pattern_mode_ends_what_runs() -> None:
    """Clients order it there; TI's GUI enters video mode first."""
    host = Host(Dlpc350Policy())
    host.run()
    assert host.grey() == 1
    assert host.write("0200 01") == OK
    assert (host.grey(), host.read("1a0c")) == (-1, b"\x01")
    pulses = len(host.pulses)
    host.clock.sleep(1.0)
    assert host.read("0200") == b"\x01"
    assert len(host.pulses) == pulses


def test_standby_refuses_all_but_questions_after_its_state() -> None:
    host = Host(Dlpc350Policy(sleeps_in_pattern_mode=False))
    host.pattern_mode()
    assert host.write("0200 01") == ERROR, "only from video mode"
    host.write("1a1b 00")
    host.clock.sleep(1.0)
    assert host.write("0200 01") == OK
    assert host.read("0200") == b"\x01"
    assert host.grey() == -1
    assert host.write("1a24 02") == ERROR
    assert host.read("1a0c") == b"\x01"
    assert host.write("0200 00") == OK
    assert host.read("0200") == b"\x01"
    assert host.write("1a24 00") == ERROR
    host.clock.sleep(2.0)
    assert host.read("0200") == b"\x00"
    assert host.write("1a24 00") == OK


def test_policies_of_standby() -> None:
    host = Host(Dlpc350Policy(loses_wake_acknowledgement=True, wake_s=0.5))
    host.pattern_mode()
    assert host.write("0200 01") == OK
    assert host.send("0200 00") == b""
    host.clock.sleep(0.5)
    assert host.read("0200") == b"\x00"


def test_the_leds_of_this_board_are_inverted(host: Host) -> None:
    host.run()
    host.write("0b01 00 ff cc")
    light = host.controller.light()
    assert light is not None
    assert light.levels == {"red": 1.0, "green": 0.0, "blue": pytest.approx(0.2)}
    assert light.brightness()[0, 0] == pytest.approx(1.2 / 3 / 255)
    host.write("1a05 01")
    light = host.controller.light()
    assert light is not None
    assert light.levels == {"red": 0.0, "green": 1.0, "blue": pytest.approx(0.8)}


def test_leds_by_hand_or_by_the_sequence(host: Host) -> None:
    host.run(entries="001804")
    for enable, lit in (("08", {"red"}), ("02", {"green"}), ("0a", {"red"})):
        host.write(f"1a07 {enable}")
        light = host.controller.light()
        assert light is not None
        assert set(light.levels) == lit
    host.write("1a07 00")
    assert host.controller.light() is None
    host.write("1a07 02")
    host.write("0b01 ff ff ff")
    assert host.controller.light() is None


def test_inverted_patterns(host: Host) -> None:
    host.run(entries="007805")
    assert host.grey() == 254
    host.write("1a24 00")
    host.write("1a30 01")
    assert host.grey() == 1
    host.run(entries="607104 607101")
    assert host.greys(2) == [255, 0], "solid black and white, with all data inverted"


def test_a_reset_takes_it_off_the_bus_and_all_back(host: Host) -> None:
    host.run()
    host.device.write(b"\0" + bytes.fromhex("00000200 0208").ljust(64, b"\0"))
    assert host.device.write(bytes(65)) == -1
    with pytest.raises(OSError, match="read error"):
        host.device.read(64, 1)
    assert host.hid.enumerate(0x0451, 0x6401) == []
    host.clock.sleep(2.0)
    host.open()
    assert host.read("1a1b") == b"\x00"
    assert not host.running


# --- planes


@given(st.integers(1, 8), st.integers(0, 23), st.integers(0, 2**24 - 1), st.booleans())
def test_planes_as_grey_levels(depth: int, number: int, word: int, inverted: bool) -> None:
    """Compared with a sum over single bit planes."""
    try:
        wanted = bit_planes(depth, number)
    except ValueError:
        return
    image = np.array([[[word & 0xFF, word >> 8 & 0xFF, word >> 16]]], np.uint8)
    value = sum((word >> plane & 1) << bit for bit, plane in enumerate(wanted))
    full = 2**depth - 1
    value = full - value if inverted else value
    assert grey_levels(image, depth, number, inverted)[0, 0] == round(value * 255 / full)


# --- the wire


def test_both_interfaces_are_listed_and_one_takes_commands(host: Host) -> None:
    assert [d["interface_number"] for d in host.hid.enumerate(0x0451, 0x6401)] == [1, 0]
    assert host.hid.enumerate(0x0451, 0x6402) == []
    with pytest.raises(OSError, match="open failed"):
        host.hid.device().open_path(b"emulated:1")


def test_time_outs_take_their_time(host: Host) -> None:
    begin = host.clock.now()
    assert host.device.read(64, 250) == []
    assert host.clock.now() - begin == pytest.approx(0.25)
    with pytest.raises(ValueError, match="without limit"):
        host.device.read(64)


def test_reports_of_another_size_are_not_sent(host: Host) -> None:
    for report in (bytes(64), bytes(66), b"\x01" + bytes(64)):
        assert host.device.write(report) == -1


def test_an_old_handle_stays_dead_after_plugging_in_again(host: Host) -> None:
    host.hid.unplug()
    host.hid.plug()
    assert host.device.write(bytes(65)) == -1
    host.open()
    assert host.read("1a0b") == b"\x01"


def test_faults_of_replies() -> None:
    faults = {0: UsbFault.DROP, 1: UsbFault.LATE, 2: UsbFault.DUPLICATE, 3: UsbFault.NACK, 4: UsbFault.SHORT}
    host = Host(Dlpc350Policy(), faults)
    assert host.send("1008 01") == b""
    assert host.send("1009 01", sequence=1) == b""
    host.clock.sleep(3.0)
    assert host.device.read(64, 1)[1] == 1
    assert host.send("100a 01", sequence=2)[1] == 2
    assert host.device.read(64, 1)[1] == 2
    assert host.write("1a05 01") == ERROR
    assert len(host.send("1a0e 80")) == 6
    assert [host.read(number) for number in ("1008", "1009", "100a", "1a0e")] == [
        b"\1",
        b"\1",
        b"\1",
        b"\x80",
    ]
    assert host.read("1a05") == b"\0", "refused and not done"
