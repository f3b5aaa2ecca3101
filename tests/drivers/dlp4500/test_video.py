"""The LightCrafter's driver with patterns from the video port, on an emulated wire and display."""

import multiprocessing
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.dlp4500 import Dlp4500, protocol
from drivers.dlp4500.index import shown_image
from drivers.dlp4500.packing import assign_slots, pack_images
from drivers.dlp4500.protocol import Run
from drivers.dlp4500.sequence import MIN_EXPOSURE_US
from drivers.emulators.dlpc350 import STRICT, Dlpc350Policy, UsbFault
from drivers.emulators.dlpc350.light import grey_levels
from fpplab.core.errors import (
    CapabilityError,
    ConfigError,
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    ProtocolError,
    SettingError,
)
from fpplab.devices import State
from fpplab.patterns.fringes import Pattern
from tests.drivers.projector_bench import FRAME_S, HEIGHT, WIDTH, VideoBench, greys

FRAME_US = 16_666


@pytest.fixture
def bench(tmp_path: Path) -> VideoBench:
    return VideoBench(greys(7), tmp_path)


@pytest.fixture
def projector(bench: VideoBench) -> Iterator[Dlp4500]:
    with bench.projector() as opened:
        yield opened


def noise(*bits: int) -> list[Pattern]:
    random = np.random.default_rng(5)
    return [
        Pattern(f"noise-{i}", random.integers(0, 256, (HEIGHT, WIDTH), np.uint8), b)
        for i, b in enumerate(bits)
    ]


def played(bench: VideoBench, projector: Dlp4500, exposure_s: float) -> list[int]:
    """The grey at the beginning of each pulse of a whole run."""
    seen: list[int] = []

    def pulsed(pulse: Any) -> None:
        bench.pulses.append(pulse)
        light = bench.controller.light_at(pulse.rise_s)
        if pulse.output == 1:
            seen.append(-1 if light is None else int(light.grey[0, 0]))

    bench.controller.on_pulse = pulsed
    projector.play(exposure_s)
    return seen


# --- packing


@pytest.mark.whole_after(3)
@pytest.mark.parametrize("bits", range(1, 9))
def test_every_pattern_of_a_depth_comes_out_of_its_planes(bits: int) -> None:
    """Read by the emulated controller, which takes planes apart on its own."""
    patterns = noise(*[bits] * 25)
    slots = assign_slots(patterns, 24)
    assert [slot.number for slot in slots[:2]] == [0, 1]
    images = list(pack_images(patterns, slots))
    assert len(images) == slots[-1].image + 1
    for pattern, slot in zip(patterns, slots, strict=True):
        np.testing.assert_array_equal(
            grey_levels(images[slot.image], bits, slot.number, False), shown_image(pattern)
        )


def test_depths_do_not_share_a_frame() -> None:
    slots = assign_slots(noise(8, 8, 1, 1, 8), 24)
    assert [(slot.image, slot.number, slot.bits) for slot in slots] == [
        (0, 0, 8), (0, 1, 8), (1, 0, 1), (1, 1, 1), (2, 0, 8),
    ]  # fmt: skip


# --- opening


def test_it_opens_dark_and_follows_the_display(bench: VideoBench, projector: Dlp4500) -> None:
    assert bench.is_dark()
    assert bench.controller._registers[protocol.CHANNEL_SWAP.number] == {"swap": 4, "port": 0}
    assert projector.caps.bit_depths == {bits: us * 1e-6 for bits, us in MIN_EXPOSURE_US.items()}


def test_a_display_of_the_computer_is_opened_through_sdl(
    bench: VideoBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    bench.display = None  # type: ignore[assignment]
    projector = bench.projector(video={"display": "DLP"})
    with pytest.raises(DeviceError, match="projector: open: there is no display 'DLP'; there are 0 '0'"):
        projector.open()
    assert projector.state is State.CLOSED
    assert multiprocessing.active_children() == []


def test_without_a_locked_signal_it_does_not_open(bench: VideoBench) -> None:
    assert bench.controller.video is not None
    bench.controller.video.locked = False
    with pytest.raises(DeviceTimeoutError, match="no signal is locked on the video port"):
        bench.projector().open()


def test_a_fast_display_has_no_time_for_the_deep_patterns(bench: VideoBench) -> None:
    bench.display.vsync_s = 1 / 121
    with bench.projector() as projector:
        assert set(projector.caps.bit_depths) == set(range(1, 8))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"flash": "patterns.yaml"}, "'flash' and 'video' are both given"),
        ({"video": None}, "'flash' or 'video' is missing"),
        ({"video": {}}, "'video.display' is missing"),
        ({"video": {"display": -1}}, "'video.display' is -1"),
        ({"video": {"display": 0, "scale": 2}}, "unknown key 'video.scale'"),
    ],
)
def test_patterns_are_in_one_place(bench: VideoBench, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        bench.projector(**options)


# --- showing


@pytest.mark.whole
@pytest.mark.parametrize("policy", [STRICT, Dlpc350Policy()], ids=["strict", "quick"])
def test_a_shown_pattern_stays_lit_in_every_frame(tmp_path: Path, policy: Dlpc350Policy) -> None:
    """Also on a board that has started before the next frame begins."""
    bench = VideoBench(greys(7), tmp_path, policy)
    with bench.projector() as projector:
        shown = projector.load(bench.patterns)
        for i in (4, 0, 5, 2, 6, 1, 3):
            projector.show(i)
            for _ in range(50):
                assert bench.grey() == shown[i].image[0, 0]
                bench.clock.sleep(FRAME_S / 7)


def test_pixels_are_those_of_the_pattern(bench: VideoBench, projector: Dlp4500) -> None:
    patterns = noise(8, 5, 1, 8, 7, 7, 7)
    for i, pattern in enumerate(projector.load(patterns)):
        projector.show(i)
        light = bench.controller.light()
        assert light is not None
        np.testing.assert_array_equal(light.grey, pattern.image)


def test_patterns_of_one_frame_need_it_once(bench: VideoBench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    before = bench.frames
    for i in (0, 1, 2, 1, 5, 4, 0):
        projector.show(i)
    assert bench.frames - before == 3


def test_another_load_is_another_frame(bench: VideoBench, projector: Dlp4500) -> None:
    for i in (1, 4):
        projector.load([bench.patterns[i]])
        projector.show(0)
        assert bench.grey() == bench.patterns[i].image[0, 0]


# --- playing


@pytest.mark.parametrize(("exposure_us", "frames"), [(8333, 4), (8334, 7), (FRAME_US, 7)])
def test_played_patterns_come_once_in_order_with_a_pulse_each(
    bench: VideoBench, projector: Dlp4500, exposure_us: int, frames: int
) -> None:
    """Two to a frame where their exposures fit into it, one where they do not."""
    projector.load(bench.patterns)
    before = bench.frames
    assert played(bench, projector, exposure_us * 1e-6) == [p.image[0, 0] for p in bench.patterns]
    assert bench.frames - before == frames
    assert all(
        b - a >= exposure_us * 1e-6 - 1e-9 for a, b in zip(bench.pulsed(), bench.pulsed()[1:], strict=False)
    )
    assert all(
        p.fall_s - p.rise_s == pytest.approx(exposure_us * 1e-6) for p in bench.pulses if p.output == 1
    )
    bench.clock.sleep(10.0)
    bench.controller.advance()
    assert len(bench.pulsed()) == 7, "once, and not again"
    projector.blank()
    assert bench.is_dark()


def test_flat_patterns_of_fewer_bits_share_frames(bench: VideoBench, projector: Dlp4500) -> None:
    bench.controller.policy = Dlpc350Policy()  # so short a run can be ordered only once
    dark_and_light = [replace(bench.patterns[i], bit_depth=1) for i in (0, 6, 6, 0, 6)]
    shown = projector.load(dark_and_light)
    before = bench.frames
    assert played(bench, projector, 300e-6) == [int(p.image[0, 0]) for p in shown] == [0, 255, 255, 0, 255]
    assert bench.frames - before == 1


@pytest.mark.parametrize("period_s", [0.0084, 0.05, 0.3])
def test_where_pulses_have_to_be_farther_apart_every_pattern_has_its_own_frame(
    bench: VideoBench, projector: Dlp4500, period_s: float
) -> None:
    projector.load(bench.patterns)
    before = bench.frames
    bench.pulses.clear()
    projector.play(0.008333, 0.0, period_s)
    rises = bench.pulsed()
    assert len(rises) == 7
    assert np.diff(rises).min() >= period_s
    assert bench.frames - before == 7


def test_patterns_share_frames_where_pulses_may_follow_at_once(bench: VideoBench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    before = bench.frames
    projector.play(0.008333, 0.0, 0.008333)
    assert bench.frames - before == 4


@pytest.mark.parametrize("ignored", [0, 1])
@pytest.mark.parametrize("late_s", [0.0, 0.02])
def test_frames_whose_start_is_ignored_once_or_shown_late(
    tmp_path: Path, ignored: int, late_s: float
) -> None:
    """A frame may be over before the controller shows that it runs; no pulse is lost or doubled."""
    policy = Dlpc350Policy(ignored_starts=ignored, running_shown_late_s=late_s)
    bench = VideoBench(greys(5), tmp_path, policy)
    with bench.projector() as projector:
        projector.load(bench.patterns)
        assert played(bench, projector, 0.01) == [p.image[0, 0] for p in bench.patterns]


def test_after_playing_a_pattern_can_be_shown(bench: VideoBench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    projector.show(0)
    projector.play(0.01)
    projector.blank()
    projector.show(0)
    assert bench.grey() == bench.patterns[0].image[0, 0]


def test_an_exposure_beyond_a_frame_is_refused_with_the_remedy(bench: VideoBench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    with pytest.raises(
        SettingError,
        match="play: the exposure is 20000 µs, and frames of the video port last 16666 µs; expose shorter",
    ):
        projector.play(0.02)
    assert projector.state is State.IDLE
    assert bench.pulsed() == []


def test_dark_between_patterns_is_refused(bench: VideoBench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    with pytest.raises(
        CapabilityError, match=r"no dark time between patterns.*use flash, or a rolling shutter"
    ):
        projector.play(0.01, 0.001)
    assert projector.state is State.IDLE
    assert bench.pulsed() == []


def test_darkness_between_patterns_is_refused(bench: VideoBench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    with pytest.raises(CapabilityError, match="no dark time between patterns"):
        projector.play(0.01, 0.001)
    assert bench.pulsed() == []


def test_preparing_is_done_once_for_frames_alike(bench: VideoBench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    bench.controller.executed.clear()
    projector.play(0.008333)
    tables = bench.controller.executed.count(protocol.MAILBOX_DATA.number)
    assert tables == 2, "for frames of two patterns, and for the last of one"


# --- failures


def test_a_display_that_fails_leaves_the_projector_dark(bench: VideoBench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    projector.show(0)

    def fail(frame: object) -> None:
        raise DisconnectedError("projector", "video", "the process of its display has died")

    bench.display.show = fail  # type: ignore[method-assign]
    for use in (lambda: projector.show(3), lambda: projector.play(0.01)):
        with pytest.raises(DisconnectedError, match="has died"):
            use()
        assert bench.is_dark()
        assert bench.controller.sequencer.state is Run.STOP
        assert projector.state is State.FAULT
        del bench.display.show
        projector.close()
        projector.open()
        projector.load(bench.patterns)
        bench.display.show = fail  # type: ignore[method-assign]
    del bench.display.show


def test_a_signal_lost_between_frames_is_noticed(bench: VideoBench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    assert bench.controller.video is not None
    bench.controller.video.locked = False
    with pytest.raises(ProtocolError, match="the sequence does not run"):
        projector.play(0.01)
    assert bench.is_dark()


@pytest.mark.whole
@pytest.mark.parametrize(
    "fault",
    [
        UsbFault.DROP,
        UsbFault.NACK,
        UsbFault.UNPLUG_BEFORE,
        pytest.param(UsbFault.LATE, marks=pytest.mark.nightly),
    ],
)
def test_a_fault_at_any_command_of_a_run_ends_it(tmp_path: Path, fault: UsbFault) -> None:
    """No frame later than where it happened, and dark where the cable is still there."""
    quiet = VideoBench(greys(3), tmp_path)
    with quiet.projector() as projector:
        projector.load(quiet.patterns)
        before = quiet.hid.requests
        projector.play(0.01)
        requests = quiet.hid.requests - before
    for n in range(0, requests, 7):
        bench = VideoBench(greys(3), tmp_path)
        projector = bench.projector()
        projector.open()
        projector.load(bench.patterns)
        bench.hid.faults = {bench.hid.requests + n: fault}
        try:
            projector.play(0.01)
        except DeviceError:
            assert fault is UsbFault.UNPLUG_BEFORE or bench.is_dark()
        else:
            assert len(bench.pulsed()) == 3
            assert n == 0, "an order to make dark is given twice"


def test_closing_gives_the_display_back_whatever_happens(bench: VideoBench) -> None:
    projector = bench.projector()
    projector.open()
    before = bench.frames
    bench.hid.unplug()
    with pytest.raises(DisconnectedError):
        projector.close()
    assert bench.frames - before == 1, "the desktop"
