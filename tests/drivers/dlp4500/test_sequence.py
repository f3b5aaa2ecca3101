"""Planes, times and tables of pattern sequences."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dlp4500.packing import assign_slots
from drivers.dlp4500.protocol import COLOURS, ENTRY, PatternTrigger, Source, TriggerMode
from drivers.dlp4500.sequence import (
    MIN_EXPOSURE_US,
    Entry,
    Program,
    Slot,
    bit_planes,
    check_sequence,
    flash_program,
    shortest_period_us,
    still_program,
    video_program,
)
from fpplab.patterns.fringes import Pattern

EXPOSURE_US = 10_000
ROWS = {
    1: (24, 0, 1, 235),
    2: (12, 0, 2, 700),
    3: (8, 0, 3, 1570),
    4: (6, 0, 4, 1700),
    5: (4, 1, 6, 2000),
    6: (4, 0, 6, 2500),
    7: (3, 1, 8, 4500),
    8: (3, 0, 8, 8333),
}
"""By depth: how many pattern numbers, the first plane of number 0, planes between numbers, least µs."""


@pytest.mark.parametrize("depth", ROWS)
def test_planes_of_each_depth(depth: int) -> None:
    count, first, step, least_us = ROWS[depth]
    for number in range(count):
        start = first + step * number
        assert list(bit_planes(depth, number)) == list(range(start, start + depth))
    for number in (-1, 25, *([count] if depth > 1 else [])):
        with pytest.raises(ValueError, match=f"number is {number}: 0 to {count - 1} with {depth} bits"):
            bit_planes(depth, number)
    assert MIN_EXPOSURE_US[depth] == least_us


def test_solid_black_has_no_planes_and_depths_end_at_8() -> None:
    assert list(bit_planes(1, 24)) == []
    for depth in (0, 9):
        with pytest.raises(ValueError, match=f"depth is {depth}: 1 to 8"):
            bit_planes(depth, 0)


def slots(*images: int) -> list[Slot]:
    return [Slot(image, k % 3) for k, image in enumerate(images)]


LOADS = dict.fromkeys(range(256), 0)


def test_a_swap_at_the_first_pattern_and_wherever_the_image_changes() -> None:
    program = flash_program(slots(3, 3, 3, 5, 5, 3), EXPOSURE_US, load_us=LOADS)
    assert [entry.swap for entry in program.entries] == [True, False, False, True, False, True]
    assert program.images == (3, 5, 3)
    assert all(entry.trigger is PatternTrigger.INTERNAL for entry in program.entries)
    assert (program.source, program.trigger_mode) == (Source.FLASH, TriggerMode.INTERNAL)
    assert program.image_table() == bytes([3, 5, 3])
    assert len(program.pattern_table()) == 18
    assert program.pattern_table()[:3] == bytes.fromhex("007804")


def test_a_table_of_two_images_goes_out_reversed() -> None:
    assert flash_program(slots(3, 3, 5), EXPOSURE_US).image_table() == bytes([5, 3])
    assert flash_program(slots(3), EXPOSURE_US).image_table() == bytes([3])


def test_leds_are_those_that_were_chosen() -> None:
    table = flash_program(slots(0), EXPOSURE_US, ("green",)).pattern_table()
    assert {c: ENTRY.unpack(table)[c] for c in ("red", "green", "blue")} == {"red": 0, "green": 1, "blue": 0}


@given(st.integers(235, 10**6), st.integers(0, 10**6))
def test_a_period_is_the_exposure_or_longer_by_more_than_230(exposure: int, least: int) -> None:
    period = shortest_period_us(exposure, least)
    assert period == exposure or period - exposure > 230
    assert period >= least
    assert period <= max(exposure + 231, least)


@pytest.mark.parametrize(
    ("loads", "images", "period"),
    [
        ({0: 1, 1: 1, 2: 90_000}, (0, 0, 1, 1, 2), 45_000),
        ({0: 90_000, 1: 1, 2: 1}, (0, 0, 1, 1, 2), 10_000),  # the first one is there before the start
        ({0: 1, 1: 20_001, 2: 1}, (0, 0, 1, 1, 2), 10_231),  # by a hair, and then the gap of 231
        ({0: 90_000, 1: 90_000}, (0, 0, 1), 10_000),  # two images are both there
        ({0: 1, 1: 1, 2: 1}, (0, 1, 2), 10_000),
    ],
)
def test_periods_wait_for_images_to_load(loads: dict[int, int], images: tuple[int, ...], period: int) -> None:
    assert flash_program(slots(*images), EXPOSURE_US, load_us=loads).period_us == period


def test_repeated_sequences_load_their_first_image_again() -> None:
    loads = {0: 50_000, 1: 1, 2: 1}
    assert flash_program(slots(0, 1, 2), EXPOSURE_US, load_us=loads).period_us == EXPOSURE_US
    assert flash_program(slots(0, 1, 2), EXPOSURE_US, repeat=True, load_us=loads).period_us == 50_000


@pytest.mark.parametrize("depth", ROWS)
def test_the_least_exposure_is_of_the_deepest(depth: int) -> None:
    least = MIN_EXPOSURE_US[depth]
    mixed = [Slot(0, 0, 1), Slot(0, 1, depth)]
    assert flash_program(mixed, least).exposure_us == least
    with pytest.raises(ValueError, match=f"the exposure is {least - 1} µs: {least} to 200000000 µs"):
        flash_program(mixed, least - 1)


def test_the_longest_exposure() -> None:
    assert still_program(Slot(0, 0), 200_000_000).repeat
    with pytest.raises(ValueError, match="the exposure is 200000001 µs"):
        still_program(Slot(0, 0), 200_000_001)


def test_long_sequences_take_the_long_tables() -> None:
    assert not flash_program(slots(*[0] * 128), EXPOSURE_US).variable
    long = flash_program(slots(*[0] * 129), EXPOSURE_US)
    assert long.variable
    assert long.trigger_mode is TriggerMode.INTERNAL_VARIABLE
    assert not flash_program(slots(*range(64)), EXPOSURE_US, load_us=LOADS).variable
    assert flash_program(slots(*range(65)), EXPOSURE_US, load_us=LOADS).variable
    assert flash_program(slots(*range(256)), EXPOSURE_US, load_us=LOADS)
    with pytest.raises(ValueError, match="257 changes of image: at most 256"):
        flash_program(slots(*range(256), 0), EXPOSURE_US, load_us=LOADS)
    with pytest.raises(ValueError, match="1825 patterns: 1 to 1824"):
        flash_program(slots(*[0] * 1825), EXPOSURE_US)
    with pytest.raises(ValueError, match="0 patterns"):
        check_sequence(replace(long, entries=()))


def test_a_run_takes_its_patterns_times() -> None:
    assert flash_program(slots(0, 0, 0), EXPOSURE_US).duration_s == pytest.approx(0.03)


# --- what no sequence may be


def program(*entries: Entry, exposure: int = EXPOSURE_US, period: int = EXPOSURE_US) -> Program:
    return Program(Source.FLASH, entries, (0,), exposure, period, False)


FIRST = Entry(0, 8, swap=True)


@pytest.mark.parametrize("gap", [-1, 1, 230])
def test_gaps_that_no_period_has(gap: int) -> None:
    with pytest.raises(ValueError, match=f"the period is {EXPOSURE_US + gap} µs: 10000, the exposure, or at"):
        check_sequence(program(FIRST, period=EXPOSURE_US + gap))


def test_the_least_gap() -> None:
    check_sequence(program(FIRST, period=EXPOSURE_US + 231))


@pytest.mark.parametrize(
    "first",
    [replace(FIRST, swap=False), replace(FIRST, trigger=PatternTrigger.NONE)],
    ids=["swap", "trigger"],
)
def test_the_first_pattern_needs_a_trigger_and_an_image(first: Entry) -> None:
    with pytest.raises(ValueError, match="the first pattern needs"):
        check_sequence(program(first))


# --- the video port


def test_a_pattern_may_have_an_led_of_its_own() -> None:
    image = np.zeros((1140, 912), np.uint8)
    slots = assign_slots([Pattern("all", image), Pattern("red", image, led="red")], 24)
    used = "green", "blue"
    for program in (flash_program(slots, 9000, used), video_program(slots, 8333, 16_667, used)):
        lit = [[colour for colour in COLOURS if entry.values()[colour]] for entry in program.entries]
        assert lit == [["green", "blue"], ["red"]]


def test_frames_from_the_video_port() -> None:
    frames = [Slot(0, 0, 7), Slot(0, 1, 7), Slot(0, 2, 7), Slot(1, 0, 7)]
    shown = video_program(frames, 4500, 16_667)
    assert [entry.trigger for entry in shown.entries] == [1, 3, 3, 1]
    assert [entry.swap for entry in shown.entries] == [True, False, False, True]
    assert (shown.source, shown.trigger_mode, shown.images, shown.repeat) == (0, 0, (), False)
    assert video_program(frames, 4500, 16_667, repeat=True).repeat
    many = video_program([Slot(i, 0) for i in range(129)], 8333, 16_667)
    assert many.trigger_mode is TriggerMode.VSYNC_VARIABLE


@pytest.mark.parametrize(("count", "bits", "fits"), [(2, 8, True), (3, 7, True), (3, 8, False)])
def test_what_fits_into_a_frame_at_60_hz(count: int, bits: int, fits: bool) -> None:
    frame = [Slot(0, k, bits) for k in range(count)]
    if fits:
        assert video_program(frame, MIN_EXPOSURE_US[bits], 16_667)
    else:
        with pytest.raises(ValueError, match="3 exposures of 8333 µs in a frame: at most 16667 µs together"):
            video_program(frame, MIN_EXPOSURE_US[bits], 16_667)
