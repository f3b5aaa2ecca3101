"""The display of the video port: frames pixel by pixel through SDL, from a process that leaves nothing."""

import multiprocessing
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drivers.display import screen
from drivers.display import window as display_module
from drivers.display.window import SdlDisplay, VideoFrame, connected_displays
from drivers.dlp4500.sequence import SIZE
from fpplab.core.errors import DeviceError, DeviceTimeoutError, DisconnectedError
from tests.drivers.x_screen import x_server

DUMMY = (1024, 768)
"""The one size of SDL's dummy display."""


@pytest.fixture(autouse=True)
def _dummy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture
def opened() -> Iterator[SdlDisplay]:
    display = SdlDisplay("projector", 0, DUMMY)
    display.open()
    yield display
    display.close()


def noise(size: tuple[int, int]) -> VideoFrame:
    return np.random.default_rng(2).integers(0, 256, (size[1], size[0], 3), np.uint8)


def segments() -> set[str]:
    folder = Path("/dev/shm")
    return {path.name for path in folder.glob("psm_*")} if folder.exists() else set()


# --- what is on the wire


def test_every_pixel_of_a_frame_is_presented(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SDL's dummy display saves what is presented to it."""
    monkeypatch.setenv("SDL_VIDEO_DUMMY_SAVE_FRAMES", "1")
    monkeypatch.chdir(tmp_path)
    frame = noise(DUMMY)
    display = SdlDisplay("projector", 0, DUMMY)
    display.open()
    black = max(tmp_path.glob("*.bmp"))
    display.show(frame)
    shown = max(tmp_path.glob("*.bmp"))
    display.close()
    assert not np.any(np.asarray(Image.open(black).convert("RGB")))
    np.testing.assert_array_equal(np.asarray(Image.open(shown).convert("RGB")), frame)


def test_its_period_is_the_displays(opened: SdlDisplay) -> None:
    assert opened.vsync_s == pytest.approx(1 / 60)


def test_frames_of_another_kind_are_the_callers_fault(opened: SdlDisplay) -> None:
    for frame in (noise(SIZE), noise(DUMMY).astype(np.uint16)):
        with pytest.raises(ValueError, match=r"a frame is uint8 \(768, 1024, 3\)"):
            opened.show(frame)


# --- which display


@pytest.mark.parametrize(
    ("wanted", "size", "words"),
    [
        (1, DUMMY, "open: there is no display 1; there are 0 '0' (1024 x 768)"),
        ("DLP", DUMMY, "open: there is no display 'DLP'; there are 0 '0' (1024 x 768)"),
        ("0", SIZE, "open: display '0' is not set to 912 x 1140; set it so; there are 0 '0' (1024 x 768)"),
    ],
)
def test_a_display_that_is_not_there_or_not_right(
    wanted: int | str, size: tuple[int, int], words: str
) -> None:
    display = SdlDisplay("projector", wanted, size)
    with pytest.raises(DeviceError) as caught:
        display.open()
    assert str(caught.value) == f"projector: {words}"
    assert display.pid is None


def test_without_displays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "none")
    with pytest.raises(DeviceError, match=r"SDL finds no displays .*; start a graphical session"):
        SdlDisplay("projector", 0, DUMMY).open()


def test_frames_that_do_not_wait_for_the_display_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screen, "MIN_SHARE_OF_PERIOD", 100.0)
    found = r"frames come every .* ms on a display of 60 Hz"
    with pytest.raises(screen.ScreenError, match=found), screen.open_screen(0, DUMMY):
        pass


def test_pixels_that_are_drawn_otherwise_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    with screen.open_screen(0, DUMMY) as opened:
        opened.show(noise(DUMMY).tobytes())
        monkeypatch.setattr(opened, "_draw", lambda: None)
        with pytest.raises(screen.ScreenError, match="the drawn pixels differ from the frame"):
            opened.show(bytes(opened.frame_bytes))


@pytest.mark.parametrize(
    ("size", "remedy"), [((512, 384), "scaling to 100 %"), ((512, 512), "cable and settings")]
)
def test_a_window_that_the_desktop_scales_is_told_from_another_one(
    size: tuple[int, int], remedy: str
) -> None:
    with screen.open_screen(0, DUMMY) as opened:
        opened._size = size
        with pytest.raises(screen.ScreenError, match="its window has 1024 x 768 pixels") as refused:
            opened.process_events()
    assert remedy in refused.value.failure.remedy


def test_a_window_that_is_closed_is_noticed() -> None:
    import sdl2

    with screen.open_screen(0, DUMMY) as opened:
        opened.process_events()
        event = sdl2.SDL_Event()
        event.type = sdl2.SDL_QUIT
        sdl2.SDL_PushEvent(event)
        with pytest.raises(screen.ScreenError, match="its window was closed"):
            opened.process_events()


@pytest.mark.parametrize(
    ("reported_hz", "period_s"), [(60, 1 / 60), (59, 1 / 60), (50, 1 / 50), (119, 1 / 120)]
)
def test_a_rate_that_was_cut_is_the_next_one(reported_hz: int, period_s: float) -> None:
    assert screen.vsync_period_s(reported_hz) == pytest.approx(period_s)


# --- the process


def test_closing_leaves_nothing(opened: SdlDisplay) -> None:
    before = segments()
    second = SdlDisplay("projector", 0, DUMMY)
    second.open()
    assert len(segments()) == len(before) + (Path("/dev/shm").exists())
    children = multiprocessing.active_children()
    pid = second.pid
    assert pid in [child.pid for child in children]
    for _ in range(2):
        second.close()
        assert segments() == before
        assert pid not in [child.pid for child in multiprocessing.active_children()]
    with pytest.raises(DisconnectedError, match="its display is not open"):
        second.show(noise(DUMMY))


def test_its_death_is_a_device_error_and_it_can_be_opened_again(opened: SdlDisplay) -> None:
    assert opened.pid is not None
    os.kill(opened.pid, signal.SIGKILL)
    with pytest.raises(
        DisconnectedError, match=r"video: the process of its display has died \(exit code -9\)"
    ):
        opened.show(noise(DUMMY))
    assert opened.pid is None
    opened.open()
    opened.show(noise(DUMMY))


def test_one_that_hangs_is_ended(opened: SdlDisplay, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(display_module, "SHOW_S", 0.1)
    monkeypatch.setattr(display_module, "STOP_S", 0.1)
    assert opened.pid is not None
    os.kill(opened.pid, signal.SIGSTOP)
    with pytest.raises(DeviceTimeoutError, match=r"its display did not answer within 0\.1 s"):
        opened.show(noise(DUMMY))
    assert opened.pid is None


def test_an_interruption_of_the_operator_is_not_its_business(opened: SdlDisplay) -> None:
    assert opened.pid is not None
    os.kill(opened.pid, signal.SIGINT)
    opened.show(noise(DUMMY))


def test_any_size_will_do_where_none_is_stated() -> None:
    display = SdlDisplay("projector", 0, None)
    display.open()
    assert display.info is not None
    assert display.info.size == DUMMY
    display.show(noise(DUMMY))
    display.close()


def test_a_name_that_two_displays_have_is_refused() -> None:
    same_name = [screen.DisplayInfo(i, "HDMI", DUMMY, 60, i == 0) for i in range(2)]
    with pytest.raises(screen.ScreenError, match="several displays are called 'HDMI'"):
        screen._choose_display(same_name, "HDMI", None)
    assert screen._choose_display(same_name, 1, DUMMY).index == 1


def test_displays_are_listed_without_being_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    (only,) = connected_displays()
    assert (only.index, only.size, only.is_main) == (0, DUMMY, True)
    monkeypatch.setenv("SDL_VIDEODRIVER", "none")
    with pytest.raises(DeviceError, match="SDL finds no displays"):
        connected_displays()


# --- under an X server


@pytest.mark.parametrize("size", [SIZE, (1366, 768)])
def test_every_pixel_of_a_frame_is_on_an_x_servers_screen(
    size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    with x_server(size) as server:
        server.use(monkeypatch)
        frame = noise(size)
        display = SdlDisplay("projector", 0, None)
        display.open()
        assert not np.any(server.screen())
        display.show(frame)
        np.testing.assert_array_equal(server.screen(), frame)
        display.show(frame, 3)
        assert not np.any(server.screen())
        display.close()


@pytest.mark.parametrize("refreshes", [1, 3])
def test_a_frame_stays_for_its_refreshes_between_black_ones(
    refreshes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what is handed to SDL, without a display."""
    white, done = b"\xff\xff\xff", []
    shown = object.__new__(screen.Screen)
    stubs = {
        "_upload": lambda frame: done.append("white" if any(frame) else "black"),
        "_draw": lambda: None,
        "_read_back": lambda: white,
        "_present": lambda: done.append("refresh"),
        "process_events": lambda: None,
    }
    shown.frame_bytes = len(white)
    for name, stub in stubs.items():
        monkeypatch.setattr(shown, name, stub, raising=False)
    shown.show(white, refreshes)
    assert done[:4] == ["white", "black", "refresh", "white"]
    assert done[4 : 5 + refreshes] == [*["refresh"] * refreshes, "black"]
    assert set(done[5 + refreshes :]) == {"refresh"}
