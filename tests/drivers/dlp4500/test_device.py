"""The LightCrafter's driver on an emulated wire: what it shows, in what order it asks, what it refuses."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.dlp4500 import Dlp4500, protocol
from drivers.dlp4500.sequence import Slot
from drivers.emulators.dlpc350 import STRICT, Dlpc350Policy
from fpplab.core.errors import (
    CapabilityError,
    ConfigError,
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    SettingError,
    SyncError,
)
from fpplab.devices import State
from fpplab.patterns.fringes import Pattern
from tests.drivers.projector_bench import HEIGHT, WIDTH, Bench, flat, grey_of, greys

EXPOSURE_S = 0.02


PROMPT = pytest.mark.parametrize("bench", [Dlpc350Policy()], indirect=True)
"""A controller that starts at once, so that its times can be compared with when `play` returns."""


# --- opening


def test_it_opens_dark_awake_and_in_pattern_mode(bench: Bench, projector: Dlp4500) -> None:
    assert bench.is_dark()
    assert projector.caps.bit_depths == {8: pytest.approx(0.008333)}
    assert projector.caps.size == (WIDTH, HEIGHT)
    info = projector.info()
    assert (info.model, info.serial) == ("DLP LightCrafter 4500, firmware 4.4.0 LCr4500 emulator", "LCR3")


def test_it_wakes_a_sleeping_projector(tmp_path: Path) -> None:
    for policy in (Dlpc350Policy(), Dlpc350Policy(loses_wake_acknowledgement=True)):
        bench = Bench(greys(1), tmp_path, policy)
        bench.controller.asleep = True
        with bench.projector() as projector:
            assert projector.state is State.IDLE
            assert not bench.controller.is_asleep()


def test_one_that_does_not_wake_is_a_time_out(tmp_path: Path) -> None:
    bench = Bench(greys(1), tmp_path, Dlpc350Policy(wake_s=100.0))
    bench.controller.asleep = True
    with pytest.raises(DeviceTimeoutError, match="wake: is still in standby after 5 s"):
        bench.projector().open()


def test_a_sequence_left_running_by_somebody_is_ended(bench: Bench) -> None:
    first = bench.projector()
    first.open()
    first.load(bench.patterns)
    first.show(0)
    bench.hid.unplug()
    bench.hid.plug()
    assert bench.grey() == grey_of(bench.patterns[0]), "without its cable the projector goes on"
    with bench.projector():
        assert bench.is_dark()


def test_pictures_are_not_left_inverted_or_flipped(bench: Bench) -> None:
    for command in (protocol.INVERT, protocol.LONG_AXIS_FLIP, protocol.SHORT_AXIS_FLIP, protocol.FREEZE):
        bench.controller._registers[command.number] = {"on": 1}
    with bench.projector() as projector:
        projector.load(bench.patterns)
        projector.show(2)
        assert bench.grey() == grey_of(bench.patterns[2])
        assert all(
            bench.controller._registers[command.number] == {"on": 0}
            for command in (protocol.LONG_AXIS_FLIP, protocol.SHORT_AXIS_FLIP, protocol.FREEZE)
        )


def test_none_connected(bench: Bench) -> None:
    bench.hid.unplug()
    with pytest.raises(DisconnectedError, match="no LightCrafter 4500 is connected"):
        bench.projector().open()


@pytest.mark.parametrize(
    ("number", "bits", "words"),
    [
        (0x1A0A, {"initialised": 0}, "the controller did not initialise"),
        (0x1A0B, {"memory_test_passed": 0}, "the memory test failed"),
    ],
)
def test_an_unhealthy_one_is_not_opened(bench: Bench, number: int, bits: dict[str, int], words: str) -> None:
    healthy = bench.controller._readers[number]
    bench.controller._readers[number] = lambda: healthy() | bits
    with pytest.raises(DeviceError, match=words):
        bench.projector().open()


# --- showing


def test_a_shown_pattern_stays(bench: Bench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    for i in (3, 0, 5):
        projector.show(i)
        assert bench.watched(5, 1.0) == [grey_of(bench.patterns[i])] * 5


def test_pixels_are_those_of_the_pattern(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    images = random.integers(0, 256, (3, HEIGHT, WIDTH), np.uint8)
    patterns = [Pattern(f"noise-{bits}", image, bits) for bits, image in zip((8, 5, 1), images, strict=True)]
    bench = Bench(patterns, tmp_path)
    with bench.projector() as projector:
        shown = projector.load(patterns)
        for i, pattern in enumerate(shown):
            projector.show(i)
            light = bench.controller.light()
            assert light is not None
            np.testing.assert_array_equal(light.grey, pattern.image)
            assert len(np.unique(pattern.image)) == 1 << pattern.bit_depth


@PROMPT
def test_played_patterns_come_once_in_order_with_a_pulse_each(bench: Bench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    bench.pulses.clear()
    projector.play(EXPOSURE_S)
    begin = bench.clock.now()
    assert bench.watched(6, EXPOSURE_S) == [grey_of(pattern) for pattern in bench.patterns]
    pulses = [pulse for pulse in bench.pulses if pulse.output == 1]
    assert [pulse.pattern for pulse in pulses] == list(range(6))
    assert [pulse.rise_s - begin for pulse in pulses] == pytest.approx(
        [k * EXPOSURE_S for k in range(6)], abs=1e-9
    )
    assert all(pulse.fall_s - pulse.rise_s == pytest.approx(EXPOSURE_S) for pulse in pulses)
    assert [pulse.pattern for pulse in bench.pulses if pulse.output == 2] == [0]
    bench.clock.sleep(10.0)
    bench.controller.advance()
    assert len(bench.pulses) == 7, "once, and not again"
    projector.blank()
    assert bench.is_dark()


@PROMPT
@pytest.mark.parametrize(("dark_s", "found_s"), [(0.0301234, 0.030124), (1e-6, 231e-6)])
def test_darkness_follows_each_pattern(
    bench: Bench, projector: Dlp4500, dark_s: float, found_s: float
) -> None:
    """As long as asked for, or the least that the controller can."""
    projector.load(bench.patterns)
    bench.pulses.clear()
    projector.play(EXPOSURE_S, dark_s)
    for pattern in bench.patterns:
        bench.clock.sleep(EXPOSURE_S / 2)
        assert bench.grey() == grey_of(pattern)
        bench.clock.sleep(EXPOSURE_S / 2 + found_s / 2)
        assert bench.is_dark()
        bench.clock.sleep(found_s / 2)
    bench.controller.advance()
    pulses = [pulse for pulse in bench.pulses if pulse.output == 1]
    assert np.diff([pulse.rise_s for pulse in pulses]) == pytest.approx(EXPOSURE_S + found_s)
    assert [pulse.fall_s - pulse.rise_s for pulse in pulses] == pytest.approx([EXPOSURE_S] * 6)


def test_load_times_are_measured_in_the_dark(tmp_path: Path) -> None:
    """The controller refuses to measure them while patterns from flash are shown."""
    bench = Bench(greys(9), tmp_path)
    with bench.projector() as projector:
        projector.load(bench.patterns[:1])
        projector.show(0)
        projector.load(bench.patterns)
        assert bench.is_dark()


@pytest.mark.parametrize(("period_s", "found_s"), [(0.0001, 0.0), (1e-6, 231e-6), (0.03, 0.03)])
def test_pulses_are_as_far_apart_as_asked_for(
    bench: Bench, projector: Dlp4500, period_s: float, found_s: float
) -> None:
    """Beyond the exposure, or at the least distance that the controller can keep."""
    projector.load(bench.patterns)
    bench.pulses.clear()
    projector.play(EXPOSURE_S, 0.0, period_s if period_s == 0.0001 else EXPOSURE_S + period_s)
    bench.clock.sleep(1.0)
    bench.controller.advance()
    rises = [pulse.rise_s for pulse in bench.pulses if pulse.output == 1]
    assert np.diff(rises) == pytest.approx(EXPOSURE_S + found_s)


@PROMPT
@pytest.mark.parametrize("order", [(0, 5), (5, 0), (4, 1, 3), (2, 2, 2)])
def test_any_order_of_two_images(bench: Bench, projector: Dlp4500, order: tuple[int, ...]) -> None:
    """Among them a table of two images, which the controller reads from its end."""
    chosen = [bench.patterns[i] for i in order]
    projector.load(chosen)
    projector.play(EXPOSURE_S)
    assert bench.watched(len(order), EXPOSURE_S) == [grey_of(pattern) for pattern in chosen]


def test_many_images_are_shown_when_they_are_loaded(tmp_path: Path) -> None:
    bench = Bench(greys(12), tmp_path, Dlpc350Policy(image_load_s=0.09))
    with bench.projector() as projector:
        projector.load(bench.patterns)
        projector.play(EXPOSURE_S)
        assert bench.watched(12, 0.03) == [grey_of(p) for p in bench.patterns]
        assert [round(p.fall_s - p.rise_s, 6) for p in bench.pulses if p.output == 1] == [EXPOSURE_S] * 12
        projector.blank()


@pytest.mark.whole_after(2)
@pytest.mark.parametrize(("count", "loads"), [(3, (1, 0.0)), (6, (2, 0.0)), (12, (4, 0.03))])
def test_the_time_that_loads_need_is_told(tmp_path: Path, count: int, loads: tuple[int, float]) -> None:
    """Each image has three patterns, which last until the next image is loaded."""
    bench = Bench(greys(12), tmp_path, Dlpc350Policy(image_load_s=0.09))
    with bench.projector() as projector:
        projector.load(bench.patterns[:count])
        found = projector.loads
        assert (found.images, found.period_s) == (loads[0], pytest.approx(loads[1], abs=1e-6))


def test_an_image_that_came_too_late_is_told(tmp_path: Path) -> None:
    bench = Bench(greys(12), tmp_path)
    with bench.projector() as projector:
        projector.load(bench.patterns)
        bench.controller.load_s[:] = [1.0] * 4  # slower than when it was asked
        projector.play(EXPOSURE_S)
        bench.clock.sleep(1.0)
        with pytest.raises(SyncError, match="an image was not loaded in time"):
            projector.blank()
        assert bench.is_dark()


@pytest.mark.whole
def test_more_than_128_patterns_go_by_the_long_tables(tmp_path: Path) -> None:
    bench = Bench(greys(3), tmp_path, Dlpc350Policy())
    many = [bench.patterns[i % 3] for i in range(129)]
    with bench.projector() as projector:
        projector.load(many)
        projector.play(EXPOSURE_S)
        assert bench.watched(129, EXPOSURE_S) == [grey_of(pattern) for pattern in many]
        assert protocol.VARIABLE_CONFIG.number in bench.controller.executed


@pytest.mark.whole
def test_36_patterns_take_fewer_than_60_commands(tmp_path: Path) -> None:
    bench = Bench(greys(36), tmp_path, Dlpc350Policy())
    with bench.projector() as projector:
        before = bench.hid.requests
        projector.load(bench.patterns)
        projector.play(EXPOSURE_S)
        assert bench.hid.requests - before < 60
        assert bench.watched(36, EXPOSURE_S) == [grey_of(pattern) for pattern in bench.patterns]


@PROMPT
def test_the_order_of_commands(bench: Bench, projector: Dlp4500) -> None:
    """Stop before any change, validate before the start, the main status after it."""
    projector.load(bench.patterns)
    bench.controller.executed.clear()
    projector.play(EXPOSURE_S)
    done = bench.controller.executed
    settings = {0x1A22, 0x1A23, 0x1A29, 0x1A31, 0x1A34}
    first_change = min(i for i, number in enumerate(done) if number in settings)
    last_change = max(i for i, number in enumerate(done) if number in settings)
    starts = [i for i, number in enumerate(done) if number == protocol.SEQUENCE.number]
    validation = [i for i, number in enumerate(done) if number == protocol.VALIDATE.number]
    assert settings <= set(done)
    assert starts[0] < first_change
    assert last_change < min(validation) < max(validation) < starts[-1]
    assert done[starts[-1] + 1 :].count(protocol.MAIN_STATUS.number) == 1


# --- light


def test_leds_follow_the_users_scale(bench: Bench) -> None:
    with bench.projector(led_levels={"red": 255, "green": 0, "blue": 51}) as projector:
        projector.load(bench.patterns)
        projector.show(0)
        light = bench.controller.light()
        assert light is not None
        assert light.levels == {"red": 1.0, "green": 0.0, "blue": pytest.approx(0.2)}
        wire = bench.controller._registers[protocol.LED_CURRENT.number]
        assert wire == {"red": 0, "green": 255, "blue": 204}


def test_a_board_that_does_not_invert(tmp_path: Path) -> None:
    bench = Bench(greys(2), tmp_path, replace(STRICT, leds_active_low=False))
    with bench.projector(led_inverted=False, led_levels={"red": 255}) as projector:
        projector.load(bench.patterns)
        projector.show(0)
        light = bench.controller.light()
        assert light is not None
        assert light.levels["red"] == 1.0


def test_by_default_leds_are_the_boards_own_and_not_the_brightest(bench: Bench, projector: Dlp4500) -> None:
    wire = bench.controller._registers[protocol.LED_CURRENT.number]
    assert wire == {"red": 0x97, "green": 0x78, "blue": 0x7D}


def test_one_colour_alone(bench: Bench) -> None:
    with bench.projector(leds=["green"]) as projector:
        projector.load(bench.patterns)
        projector.show(0)
        light = bench.controller.light()
        assert light is not None
        assert set(light.levels) == {"green"}


@PROMPT
def test_trigger_delays_are_in_microseconds(bench: Bench) -> None:
    with bench.projector(
        trigger_out_1={"rising_us": -10.72, "falling_us": 1.072}, trigger_out_2={"inverted": True}
    ) as projector:
        first = bench.controller._registers[protocol.TRIGGER_OUT_1.number]
        assert first == {"inverted": 0, "rising": 187 - 100, "falling": 187 + 10}
        assert bench.controller._registers[protocol.TRIGGER_OUT_2.number] == {"inverted": 1, "rising": 187}
        projector.load(bench.patterns)
        projector.play(EXPOSURE_S)
        begin = bench.clock.now()
        bench.controller.advance()
        assert bench.pulses[-2].rise_s - begin == pytest.approx(-10.72e-6, abs=1e-9)
        assert bench.pulses[-2].fall_s - begin == pytest.approx(EXPOSURE_S + 1.072e-6, abs=1e-9)


@pytest.mark.parametrize("policy", [Dlpc350Policy(), Dlpc350Policy(keeps_last_pattern=False)])
def test_dark_after_blank_and_after_closing(tmp_path: Path, policy: Dlpc350Policy) -> None:
    bench = Bench(greys(2), tmp_path, policy)
    projector = bench.projector()
    for end in (projector.blank, projector.close):
        if projector.state is State.CLOSED:
            projector.open()
        projector.load(bench.patterns)
        projector.show(1)
        assert bench.grey() == 255
        end()
        assert bench.is_dark()
        projector.close()


# --- refusals


def test_what_is_not_in_flash_is_refused(bench: Bench, projector: Dlp4500) -> None:
    other = flat(bench.patterns[0].id, 77)
    for pattern in (other, replace(bench.patterns[0], image=bench.patterns[0].image ^ 1)):
        with pytest.raises(CapabilityError, match="the flash does not contain pattern grey-00, 8 bits"):
            projector.load([pattern])
    assert projector.state is State.IDLE


def test_equal_patterns_go_by_their_names(tmp_path: Path) -> None:
    bench = Bench([flat("a", 9), flat("b", 9), flat("c", 9)], tmp_path)
    with bench.projector() as projector:
        for i, name in enumerate("abc"):
            projector.load([flat(name, 9)])
            assert projector._storage._slots == [Slot(0, i)]
        projector.load([flat("other", 9)])
        assert projector._storage._slots == [Slot(0, 0)]


def test_an_index_beyond_the_flash(bench: Bench) -> None:
    del bench.controller.images[-1:]
    with pytest.raises(ConfigError, match=r"flash.yaml: 'image' is 1: the projector has images 0 to 0"):
        bench.projector().open()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"speed": 1}, "unknown key 'speed'"),
        ({"leds": []}, "'leds' is"),
        ({"leds": ["white"]}, r"'leds\[0\]' is 'white'"),
        ({"led_levels": {"red": 256}}, "'led_levels.red' is 256"),
        ({"trigger_out_1": {"rising_us": 2.8}}, "'trigger_out_1.rising_us' is 2.8"),
        ({"trigger_out_2": {"rising_us": -20.1}}, "'trigger_out_2.rising_us' is -20.1"),
        ({"trigger_out_2": {"falling_us": 1.0}}, "unknown key 'trigger_out_2.falling_us'"),
        ({"flash": "nowhere.yaml"}, "nowhere.yaml: there is no such file"),
    ],
)
def test_wrong_options(bench: Bench, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        bench.projector(**options)


def test_a_new_load_ends_what_was_on_show(bench: Bench, projector: Dlp4500) -> None:
    """Its pulses would reach a camera that is armed for what comes next."""
    projector.load(bench.patterns)
    projector.show(3)
    projector.load(bench.patterns[:2])
    assert bench.is_dark()
    bench.pulses.clear()
    bench.clock.sleep(1.0)
    bench.controller.advance()
    assert not bench.pulses


@pytest.mark.whole
def test_too_many_changes_of_image(bench: Bench, projector: Dlp4500) -> None:
    with pytest.raises(SettingError, match="258 changes of image: at most 256"):
        projector.load([bench.patterns[0], bench.patterns[5]] * 129)
    assert projector.state is State.IDLE


def test_an_exposure_beyond_the_longest(bench: Bench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    with pytest.raises(SettingError, match="the exposure is 201000000 µs"):
        projector.play(201.0)
    assert projector.state is State.IDLE
