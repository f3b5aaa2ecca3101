"""Validation and start of the LightCrafter's sequences: warnings, ignored orders, late status."""

from pathlib import Path

import numpy as np
import pytest

from drivers.dlp4500 import Dlp4500, protocol
from drivers.dlp4500.protocol import DisplayMode, Run
from drivers.dlp4500.sequence import Slot, flash_program, video_program
from drivers.emulators.dlpc350 import Dlpc350Policy, UsbFault, Video
from fpplab.core.errors import (
    DeviceTimeoutError,
    ProtocolError,
    StateError,
)
from tests.drivers.projector_bench import Bench, grey_of, greys

EXPOSURE_S = 0.02


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ({"exposure_invalid": 1}, "exposure or period is not valid"),
        ({"pattern_invalid": 1, "gap_too_short": 1}, "a pattern number or an image is not valid"),
    ],
)
def test_what_the_validation_finds_is_told_in_words(
    bench: Bench, projector: Dlp4500, found: dict[str, int], words: str
) -> None:
    """A controller that objects to what the driver thought good."""
    projector.load(bench.patterns)
    bench.controller._readers[0x1A1A] = lambda: (
        dict.fromkeys(("exposure_invalid", "pattern_invalid", "trigger_overlap", "black_missing", "busy"), 0)
        | {"gap_too_short": 0}
        | found
    )
    with pytest.raises(ProtocolError, match=f"validation: {words}"):
        projector.play(EXPOSURE_S)
    assert bench.is_dark()


def _with_warnings(bench: Bench) -> None:
    """The controller finds every warning there is, and no error."""
    warnings = dict.fromkeys(("trigger_overlap", "black_missing", "gap_too_short"), 1)
    validation = bench.controller._readers[0x1A1A]

    def found() -> dict[str, int]:
        told = validation()
        return told if told["busy"] else told | warnings

    bench.controller._readers[0x1A1A] = found


def test_warnings_do_not_keep_a_sequence_from_running(bench: Bench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    _with_warnings(bench)
    projector.show(0)
    assert bench.controller.sequencer.running


def test_warnings_are_told_when_it_does_not_run(bench: Bench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    _with_warnings(bench)
    bench.controller._start = lambda now: None
    with pytest.raises(
        ProtocolError, match=r"does not run; trigger output 1 .*; no black before .*; the period"
    ):
        projector.show(0)
    assert bench.is_dark()


@pytest.mark.parametrize("ignored", [0, 1])
@pytest.mark.parametrize("late_s", [0.0, 0.02, 0.15])
def test_a_start_may_be_shown_late_or_have_to_be_ordered_twice(
    tmp_path: Path, ignored: int, late_s: float
) -> None:
    bench = Bench(greys(6), tmp_path, Dlpc350Policy(ignored_starts=ignored, running_shown_late_s=late_s))
    with bench.projector() as projector:
        projector.load(bench.patterns)
        projector.show(1)
        assert bench.controller.sequencer.running
        projector.play(0.1)
        assert bench.controller.sequencer.running


@pytest.mark.parametrize("ignored", [0, 1])
@pytest.mark.parametrize("late_s", [0.0, 0.02, 0.15])
def test_a_run_that_may_be_over_before_it_is_shown(tmp_path: Path, ignored: int, late_s: float) -> None:
    """It runs once, whether its first start is ignored or its status comes late."""
    bench = Bench(greys(6), tmp_path, Dlpc350Policy(ignored_starts=ignored, running_shown_late_s=late_s))
    with bench.projector() as projector:
        projector.load(bench.patterns)
        bench.pulses.clear()
        projector.play(0.01)
        bench.clock.sleep(1.0)
        bench.controller.advance()
        assert len([pulse for pulse in bench.pulses if pulse.output == 1]) == 6


@pytest.mark.parametrize("turnaround_s", [0.0, 0.002, 0.006, 0.02, 0.1])
def test_a_slow_second_order_does_not_start_a_run_that_has_ended_again(
    tmp_path: Path, turnaround_s: float
) -> None:
    bench = Bench(greys(1), tmp_path, Dlpc350Policy(turnaround_s=turnaround_s, running_shown_late_s=0.15))
    with bench.projector() as projector:
        projector.load(bench.patterns)
        projector.play(0.01)
        bench.clock.sleep(1.0)
        bench.controller.advance()
        assert len([pulse for pulse in bench.pulses if pulse.output == 1]) == 1


def test_a_fault_of_an_earlier_run_does_not_keep_a_sequence_from_running(tmp_path: Path) -> None:
    """The flags stand while the first start is ignored, and may stand for ever."""
    bench = Bench(greys(2), tmp_path)
    with bench.projector() as projector:
        bench.controller._aborted = bench.controller.sequencer.forced_swap = True
        projector.load(bench.patterns)
        projector.show(1)
        assert bench.grey() == 255


def test_a_start_that_is_always_ignored_is_an_error(tmp_path: Path) -> None:
    bench = Bench(greys(1), tmp_path, Dlpc350Policy(ignored_starts=2))
    with bench.projector() as projector:
        projector.load(bench.patterns)
        with pytest.raises(ProtocolError, match="start: the sequence does not run"):
            projector.show(0)
        assert bench.is_dark()


def test_a_validation_without_end(tmp_path: Path) -> None:
    bench = Bench(greys(1), tmp_path, Dlpc350Policy(validation_s=1e6))
    with bench.projector() as projector:
        projector.load(bench.patterns)
        with pytest.raises(DeviceTimeoutError, match="validation: does not end after 2 s"):
            projector.show(0)


def test_a_valid_sequence_that_does_not_run_is_an_error(bench: Bench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    bench.controller._start = lambda now: setattr(bench.controller, "_aborted", True)
    with pytest.raises(ProtocolError, match="does not run; the sequencer aborted on an error"):
        projector.show(0)
    assert bench.is_dark()


def test_patterns_from_the_video_port(bench: Bench, projector: Dlp4500) -> None:
    board = projector._board
    with pytest.raises(DeviceTimeoutError, match="no signal is locked on the video port"):
        board.select_video()
    green, red, blue = np.moveaxis(bench.controller.images[0], 2, 0)
    bench.controller.video = Video(np.stack([red, green, blue], 2))
    board.select_video()
    assert bench.controller._registers[protocol.INPUT_SOURCE.number] == {"source": 0, "width": 1}
    program = video_program([Slot(0, 0), Slot(0, 2)], 8333, 16_667, repeat=True)
    board.prepare(program)
    board.start_prepared(program)
    frame_s = bench.controller.video.vsync_s
    bench.clock.sleep(frame_s - bench.clock.now() % frame_s)
    assert bench.watched(4, frame_s / 2) == [grey_of(bench.patterns[i]) for i in (0, 2, 0, 2)]
    assert bench.controller.sequencer.state is Run.START
    with pytest.raises(StateError, match="may freeze on leaving that mode; unplug the HDMI cable"):
        board.set_display_mode(DisplayMode.VIDEO)
    bench.controller.video.locked = False
    board.set_display_mode(DisplayMode.VIDEO)
    assert bench.controller.sequencer.state is Run.STOP


def test_a_refused_table_leaves_the_mailbox_closed(bench: Bench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    board = projector._board
    program = flash_program([Slot(0, 0)], 10_000)
    writes = 0
    for n in range(60):
        bench.hid.faults = {bench.hid.requests + n: UsbFault.NACK}
        try:
            board.prepare(program)
        except ProtocolError:
            writes += 1
        assert bench.controller._open() == 0
    assert writes > 15


def test_the_result_of_the_validation_before_is_not_believed(bench: Bench, projector: Dlp4500) -> None:
    """On the emulated board it is read once after the next order."""
    projector.load(bench.patterns)
    board = projector._board
    with pytest.raises(ProtocolError, match="an image is not valid"):
        board.prepare(flash_program([Slot(200, 0)], 10_000))
    board.prepare(flash_program([Slot(0, 0)], 10_000))
    with pytest.raises(ProtocolError, match="an image is not valid"):
        board.prepare(flash_program([Slot(200, 0)], 10_000))


def test_a_load_time_of_0_is_read_again(bench: Bench, projector: Dlp4500) -> None:
    assert projector._board.image_load_us(0) == pytest.approx(20_000, abs=1)
    bench.controller.load_s = [0.0] * len(bench.controller.images)
    with pytest.raises(DeviceTimeoutError, match="the load time of image 0 still reads 0 after 1 s"):
        projector._board.image_load_us(0)
